"""P2, section 6.1: Figs. 4b, 4c and 5, the layout of CNN-7 beside that of its teacher."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from torch import Tensor
from tqdm import tqdm

from roadtorch.data.dataset import Dataset
from roadtorch.detector import Detection
from roadtorch.detectors.catalogue import load_detector
from roadtorch.evaluation import metrics
from roadtorch.io.atomic import atomic
from roadtorch.io.image import to_pixels
from roadtorch.layout.classes import HORIZONTAL, LAYOUT_COLOURS, SKY, VERTICAL, layout_colours
from scripts.figures_p2_streets import shown_items, streets, tell, write_sheet

PRINTED_ORDER = {"vertical": VERTICAL, "horizontal": HORIZONTAL, "sky": SKY}
"""Classes as P2 prints them."""

PRINTED = {
    "p2-fig4b": ((0.870, 0.112, 0.016), (0.041, 0.958, 0.000), (0.084, 0.000, 0.915)),
    "p2-fig4c": ((0.983, 0.014, 0.002), (0.098, 0.902, 0.000), (0.344, 0.000, 0.655)),
}
"""P2, Fig. 4b and 4c, on CamVid's test split: rows truth, columns decision."""

Shares = Sequence[Sequence[float]]


def confusion_of_cnn7(data: Path, out: Path) -> None:
    """Fig. 4b: the confusion of CNN-7, beside P2's."""
    _confusion("p2-fig4b", "layout:cnn-7", streets(data), out)


def confusion_of_labeller(data: Path, out: Path) -> None:
    """Fig. 4c: the confusion of the teacher; ours is `labeller`, P2's is Hoiem et al."""
    _confusion("p2-fig4c", "labeller", streets(data), out)


def _confusion(figure: str, name: str, dataset: Dataset, out: Path) -> None:
    counts = layout_counts(name, dataset)
    readings = {"void ignored": counts, "void vertical": metrics.void_as_vertical(counts)}
    shares = {text: printed_shares(each) for text, each in readings.items()}
    rows = []
    for number, truth in enumerate(PRINTED_ORDER):
        line = {"truth": truth}
        for column, decided in enumerate(PRINTED_ORDER):
            own = (f"{each[number][column]:.3f}" for each in shares.values())
            keys = (f"{decided}, {text}" for text in shares)
            line |= dict(zip(keys, own, strict=True))
            line[f"{decided}, P2"] = f"{PRINTED[figure][number][column]:.3f}"
        rows.append(line)
    tell(rows, out / f"{figure}.csv")
    for text, each in (*shares.items(), ("P2", PRINTED[figure])):
        print(f"{name}, {text}: global average accuracy {np.diagonal(each).mean():.3f}")
    draw_confusion(shares["void vertical"], name, out / f"{figure}.png")


def layout_counts(name: str, dataset: Dataset) -> Tensor:
    """The confusion int64 (4,4) of a detector's most likely class, over all pictures."""
    detector = load_detector(name)
    counts = torch.zeros(4, 4, dtype=torch.int64)
    for item in tqdm(dataset.items, unit="image", disable=None):
        image, truth = dataset.read(item)
        assert truth.layout is not None
        found = detector.detect(image).cues["layout"].argmax(0)
        counts += metrics.count_layout(found, truth.layout)
    return counts


def printed_shares(counts: Tensor) -> Shares:
    """A confusion (4,4) as P2 prints it: rows sum to 1, in the order of ``PRINTED_ORDER``."""
    order = list(PRINTED_ORDER.values())
    return metrics.normalised_confusion(counts)[order][:, order].tolist()


def draw_confusion(shares: Shares, title: str, path: Path) -> None:
    """A confusion as squares, the darker the larger."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(4.2, 4), layout="constrained")
    axes = figure.subplots()
    axes.imshow(shares, cmap="Blues", vmin=0, vmax=1)
    for row, line in enumerate(shares):
        for column, value in enumerate(line):
            colour = "white" if value > 0.5 else "black"
            axes.text(column, row, f"{value:.3f}", ha="center", va="center", color=colour)
    axes.set_xticks(range(3), list(PRINTED_ORDER))
    axes.set_yticks(range(3), list(PRINTED_ORDER))
    axes.set(xlabel="decision", ylabel="truth")
    axes.set_title(f"{title}: mean of the diagonal {np.diagonal(shares).mean():.3f}", fontsize=10)
    with atomic(path) as temporary:
        figure.savefig(temporary, format="png", dpi=120)
    print(path)


def layout_sheet(data: Path, out: Path) -> None:
    """Fig. 5: picture, truth, the teacher's layout, the potentials of CNN-7, its layout."""
    dataset = streets(data)
    teacher, network = load_detector("labeller"), load_detector("layout:cnn-7")
    columns = []
    for item in shown_items(dataset):
        image, truth = dataset.read(item)
        assert truth.layout is not None
        learned = network.detect(image).cues["layout"]
        columns.append(
            {
                item.name: to_pixels(image),
                "truth": to_pixels(layout_colours(truth.layout)),
                "labeller": to_pixels(layout_colours(_decided(teacher.detect(image)))),
                "CNN-7: potentials": to_pixels(potential_colours(learned)),
                "CNN-7: decision": to_pixels(layout_colours(learned.argmax(0))),
            }
        )
    write_sheet(columns, out / "p2-fig5.png")


def _decided(detection: Detection) -> Tensor:
    return detection.cues["layout"].argmax(0)


def potential_colours(potentials: Tensor) -> Tensor:
    """Potentials (3,H,W) as an image: the classes' colours, each as strong as its potential."""
    table = torch.tensor(LAYOUT_COLOURS) / 255
    return torch.einsum("khw,kc->chw", potentials, table).clamp(0, 1)
