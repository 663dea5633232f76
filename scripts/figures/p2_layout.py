"""P2, Figs. 1, 2, 4b, 4c and 5: the layout of CNN-7 and of its teacher."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from roadtorch.base.image import to_pixels
from roadtorch.base.settings import read_settings_file
from roadtorch.data.catalogue import open_dataset
from roadtorch.data.dataset import Dataset
from roadtorch.detectors.catalogue import load_detector
from roadtorch.evaluation import metrics
from roadtorch.evaluation.methods import Contender, contender_from_name
from roadtorch.evaluation.report.montage import apply_colormap
from roadtorch.evaluation.tally import PooledCounts, Tally
from roadtorch.imaging.resize import resize_to_work
from roadtorch.layout.classes import HORIZONTAL, SKY, VERTICAL, colour_layout
from roadtorch.layout.labeller import label_layout
from roadtorch.layout.patch_network import PatchNetwork, normalise
from roadtorch.layout.weights import load_network, weights_path
from roadtorch.train.config import PatchTraining, build_training
from scripts.figures.chart import chart, show_table
from scripts.figures.counting import count_images, observe, replicate, with_interval
from scripts.figures.sheets import RENDERED, read_labelled, read_streets, write_sheet

STUDENT, TEACHER = "layout:paper", "labeller"
CONFIG = Path(__file__).resolve().parents[2] / "configs" / "cnn7-paper.toml"

PRINTED_ORDER = {"vertical": VERTICAL, "horizontal": HORIZONTAL, "sky": SKY}
"""Classes as P2 prints them."""

PRINTED = {
    "p2-fig4b": ((0.870, 0.112, 0.016), (0.041, 0.958, 0.000), (0.084, 0.000, 0.915)),
    "p2-fig4c": ((0.983, 0.014, 0.002), (0.098, 0.902, 0.000), (0.344, 0.000, 0.655)),
}
"""P2, Fig. 4b and 4c, on CamVid's test split: rows truth, columns decision."""


def open_camvid(data: Path) -> Dataset:
    """Open CamVid's test split, which P2's figures show, where it is there; else its dev drives."""
    root = data / "camvid"
    split = "test" if (root / "test").is_dir() else "dev"
    dataset = open_dataset("camvid", root, split)
    print(f"CamVid {split}, {len(dataset.items)} images", end="\n\n")
    return dataset


# --- confusions -------------------------------------------------------------------------


def fig4b(data: Path, out: Path) -> None:
    """Write P2's Fig. 4b: the confusion of CNN-7, beside P2's."""
    show_confusions("p2-fig4b", [contender_from_name(STUDENT, {})], open_camvid(data), out)


def fig4c(data: Path, out: Path) -> None:
    """Write P2's Fig. 4c: the confusion of the teacher; P2's is Hoiem et al."""
    teachers = [contender_from_name(name, {}) for name in (TEACHER, f"{TEACHER}:untuned")]
    show_confusions("p2-fig4c", teachers, open_camvid(data), out)


def show_confusions(
    figure: str, contenders: Sequence[Contender], dataset: Dataset, out: Path
) -> None:
    """Write the confusion of classes of each contender, a panel each, beside P2's.

    A contender is a teacher, or weights of a network: ``contender_from_name("layout:cnn-7",
    {"weights": {"file": PATH}})``. Void counts as vertical, as in P2's sentence.
    """
    tallies = count_images(dataset, contenders)
    matrices = {
        name: printed_ratios(confusion_of(observe(tally).pooled)) for name, tally in tallies.items()
    }
    matrices["P2"] = np.array(PRINTED[figure])
    means = {name: mean_recalls(tally) for name, tally in tallies.items()}
    means["P2"] = {PRINTED_MEAN: f"{np.diagonal(matrices['P2']).mean():.3f}"}
    rows = [
        {"detector": name, "truth": truth}
        | dict(zip(PRINTED_ORDER, ratios, strict=True))
        | means[name]
        for name, matrix in matrices.items()
        for truth, ratios in zip(PRINTED_ORDER, matrix.tolist(), strict=True)
    ]
    show_table(out / f"{figure}.csv", rows)
    draw_confusions(matrices, out / f"{figure}.png")


PRINTED_MEAN = "mean of the diagonal"


def mean_recalls(tally: Tally) -> dict[str, str]:
    """Return the mean recall of the classes, pooled and by drives, with 95 % intervals."""

    def recall(counts: PooledCounts) -> Tensor:
        return metrics.mean_class_recall(metrics.void_as_vertical(confusion_of(counts)))

    counts, replicates = observe(tally), replicate(tally)
    by_drives = with_interval(counts.mean(recall), replicates.mean(recall))
    pooled = with_interval(recall(counts.pooled), recall(replicates.pooled))
    return {PRINTED_MEAN: pooled, f"{PRINTED_MEAN}, by drives": by_drives}


def confusion_of(counts: PooledCounts) -> Tensor:
    """Return the confusion (…, 4, 4) of the layout."""
    assert counts.layout is not None
    return counts.layout


def printed_ratios(confusion: Tensor) -> np.ndarray:
    """Normalise a confusion (4, 4) as P2 prints it: (3, 3), rows sum to 1, in ``PRINTED_ORDER``."""
    order = list(PRINTED_ORDER.values())
    ratios = metrics.normalised_confusion(metrics.void_as_vertical(confusion))
    return ratios[order][:, order].numpy()


def draw_confusions(ratios: Mapping[str, np.ndarray], path: Path) -> None:
    """Draw confusions side by side."""
    with chart(path, 2.6 * len(ratios), 2.6) as page:
        for axes, (name, matrix) in zip(
            np.atleast_1d(page.subplots(1, len(ratios))), ratios.items(), strict=True
        ):
            axes.grid(visible=False)
            axes.imshow(matrix, cmap="Blues", vmin=0, vmax=1)
            for (row, column), value in np.ndenumerate(matrix):
                colour = "white" if value > 0.5 else "black"
                axes.text(column, row, f"{value:.3f}", ha="center", va="center", color=colour)
            axes.set_xticks(range(3), list(PRINTED_ORDER))
            axes.set_yticks(range(3), list(PRINTED_ORDER))
            axes.set(xlabel="decision", ylabel="truth", title=name)


# --- images -----------------------------------------------------------------------------

MAP_WIDTH = 8  # tiles in a row of Fig. 2


def fig1(data: Path, out: Path) -> None:
    """Write P2's Fig. 1: labels of the teacher as the student learns them, and the student's."""
    training, student = build_training(read_settings_file(CONFIG)), load_detector(STUDENT)
    assert isinstance(training, PatchTraining)
    rows: dict[str, list[np.ndarray]] = {"image": [], "labels of the teacher": [], "CNN-7": []}
    for image, _ in read_streets(data)[1::2]:
        taught = label_layout(image, training.labeller, superpixels=training.superpixels).labels
        learned = student.detect(image).cues["layout"].argmax(0)
        tiles = (image, colour_layout(taught), colour_layout(learned))
        for row, tile in zip(rows.values(), tiles, strict=True):
            row.append(to_pixels(tile))
    write_sheet(out / "p2-fig1.jpg", rows)


def fig2(data: Path, out: Path) -> None:
    """Write P2's Fig. 2, the stages of a network, as the maps of CNN-7 on one image."""
    network = load_network(weights_path("cnn-7-paper"))
    assert isinstance(network, PatchNetwork)
    image = read_labelled(data, "simulated", RENDERED)[0][0]
    small = resize_to_work(image, network.settings.working)
    rows = {"image": [to_pixels(small)]}
    for title, maps in stage_maps(network, small).items():
        tiles = [apply_colormap(values) for values in maps]
        for start in range(0, len(tiles), MAP_WIDTH):
            rows[f"{title}{' (continued)' * (start > 0)}"] = tiles[start:][:MAP_WIDTH]
    write_sheet(out / "p2-fig2.jpg", rows, (100, 75))


@torch.no_grad()
def stage_maps(network: PatchNetwork, image: Tensor) -> dict[str, Tensor]:
    """Return the maps (n, h, w) in [0, 1] of each stage of a network on an image (3, H, W).

    Each stage moves the patch by the 2×2 pixels of its subsampling, as P2 draws it.
    """
    pixels = normalise(image, network.settings.normalisation)
    first = network.first(pixels).tanh()
    pooled = functional.avg_pool2d(first, 2)
    second = functional.conv2d(pooled, network.second.weight, network.second.bias).tanh()
    potentials = network.last(second).sigmoid()
    return {
        "C1, tanh": (first + 1) / 2,
        "S1": (pooled + 1) / 2,
        "C2, tanh": (second + 1) / 2,
        "C3, sigmoid: sky, vertical, horizontal": potentials,
    }


def fig5(data: Path, out: Path) -> None:
    """Write P2's Fig. 5: layout of the teacher, potentials and decision of CNN-7."""
    student, teacher = load_detector(STUDENT), load_detector(TEACHER)
    rows: dict[str, list[np.ndarray | None]] = {
        caption: []
        for caption in (
            "image",
            "truth, where a renderer knows it",
            "teacher",
            "CNN-7, potentials",
            "CNN-7, the strongest",
        )
    }
    for image, truth in read_streets(data):
        layout = None if truth is None else truth.layout
        potentials = student.detect(image).cues["layout"]
        tiles = (
            image,
            None if layout is None else colour_layout(layout),
            colour_layout(teacher.detect(image).cues["layout"].argmax(0)),
            mix_colours(potentials),
            colour_layout(potentials.argmax(0)),
        )
        for row, tile in zip(rows.values(), tiles, strict=True):
            row.append(None if tile is None else to_pixels(tile))
    write_sheet(out / "p2-fig5.jpg", rows)


def mix_colours(potentials: Tensor) -> Tensor:
    """Colour potentials (3, H, W) by the sum of the classes' colours, as an image (3, H, W)."""
    colours = colour_layout(torch.arange(3)[None])[:, 0]
    return torch.einsum("ck,khw->chw", colours, potentials).clamp(0, 1)
