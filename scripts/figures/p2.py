"""P2, Figs. 4b and 4c (layout of CNN-7 and of its teacher), 6a and 6b (road)."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from statistics import fmean
from typing import Any

import numpy as np
import torch
from torch import Tensor

from roadtorch.data.catalogue import open_dataset
from roadtorch.data.dataset import Dataset, LabelledItem, subsample_dataset
from roadtorch.detectors.detector import Detection
from roadtorch.evaluation import metrics
from roadtorch.evaluation.curves import Curve, area, roc
from roadtorch.evaluation.evaluate import evaluate
from roadtorch.evaluation.methods import Contender, Predictor, contender_from_name
from roadtorch.evaluation.result import pool_groups
from roadtorch.evaluation.tally import PooledCounts, Tally
from roadtorch.layout.classes import HORIZONTAL, SKY, VERTICAL
from roadtorch.road.seed_area import seed_rectangle
from scripts.figures.chart import chart, show_table

EVERY = 16
"""Step between CamVid's images; Fig. 6a takes twice as many."""

IDD_IMAGES = 50


def streets(data: Path, every: int = EVERY) -> Dataset:
    """Open CamVid's test split, which P2's figures show, where it is there; else its dev drives."""
    root = data / "camvid"
    split = "test" if (root / "test").is_dir() else "dev"
    dataset = open_dataset("camvid", root, split)
    chosen = subsample_dataset(dataset, -(-len(dataset.items) // every))
    print(f"CamVid {split}, {len(chosen.items)} of {len(dataset.items)} images", end="\n\n")
    return chosen


def tally_of(dataset: Dataset, contenders: Sequence[str | Contender]) -> Mapping[str, Tally]:
    """Count the detectors' results by name; RuntimeError for an image that fails."""
    run = evaluate(dataset, contenders, with_baselines=False, measures=(), quiet=False)
    for failure in run.failures:
        raise RuntimeError(f"{failure.image}: {failure.reason}")
    return run.tallies


def pooled(tally: Tally) -> PooledCounts:
    """Pool the pixels of all drives, as P2 does."""
    return pool_groups(tally, dict.fromkeys(tally.road, 0.5))


# --- layout ------------------------------------------------------------------------------

PRINTED_ORDER = {"vertical": VERTICAL, "horizontal": HORIZONTAL, "sky": SKY}
"""Classes as P2 prints them."""

PRINTED = {
    "p2-fig4b": ((0.870, 0.112, 0.016), (0.041, 0.958, 0.000), (0.084, 0.000, 0.915)),
    "p2-fig4c": ((0.983, 0.014, 0.002), (0.098, 0.902, 0.000), (0.344, 0.000, 0.655)),
}
"""P2, Fig. 4b and 4c, on CamVid's test split: rows truth, columns decision."""


def fig4b(data: Path, out: Path) -> None:
    """Write P2's Fig. 4b: the confusion of CNN-7, beside P2's."""
    show_confusion("p2-fig4b", "layout:paper", streets(data), out)


def fig4c(data: Path, out: Path) -> None:
    """Write P2's Fig. 4c: the confusion of the teacher; ours is `labeller`, P2's is Hoiem et al."""
    show_confusion("p2-fig4c", "labeller", streets(data), out)


def show_confusion(figure: str, name: str, dataset: Dataset, out: Path) -> None:
    """Show a detector's confusion of classes beside P2's."""
    counts = pooled(tally_of(dataset, [name])[name]).layout
    assert counts is not None
    void_as_vertical = printed_ratios(metrics.void_as_vertical(counts))
    ratios = {
        "void ignored": printed_ratios(counts),
        "void vertical": void_as_vertical,
        "P2": np.array(PRINTED[figure]),
    }
    rows = [
        {"truth": truth}
        | {
            f"{decided}, {title}": float(matrix[row, column])
            for column, decided in enumerate(PRINTED_ORDER)
            for title, matrix in ratios.items()
        }
        for row, truth in enumerate(PRINTED_ORDER)
    ]
    show_table(out / f"{figure}.csv", rows)
    for title, matrix in ratios.items():
        print(f"{name}, {title}: global average accuracy {np.diagonal(matrix).mean():.3f}")
    with chart(out / f"{figure}.png", 4.2, 4) as page:
        axes = page.subplots()
        axes.grid(visible=False)
        axes.imshow(void_as_vertical, cmap="Blues", vmin=0, vmax=1)
        for (row, column), value in np.ndenumerate(void_as_vertical):
            colour = "white" if value > 0.5 else "black"
            axes.text(column, row, f"{value:.3f}", ha="center", va="center", color=colour)
        axes.set_xticks(range(3), list(PRINTED_ORDER))
        axes.set_yticks(range(3), list(PRINTED_ORDER))
        axes.set(xlabel="decision", ylabel="truth", title=f"{name}, void vertical")


def printed_ratios(counts: Tensor) -> np.ndarray:
    """Normalise a confusion (4, 4) as P2 prints it: rows sum to 1, in ``PRINTED_ORDER``."""
    order = list(PRINTED_ORDER.values())
    return metrics.normalised_confusion(counts)[order][:, order].numpy()


# --- road --------------------------------------------------------------------------------

BASELINE, TEXTURE, COMBINED = "LBP (baseline)", "CPF", "CNN-7 × CPF"

LINES: Mapping[str, tuple[str, Mapping[str, Any]]] = {
    BASELINE: ("lbp", {}),
    "U of grey": ("grey-uniformity", {}),
    TEXTURE: ("cpf", {}),
    "CPFv2": ("cpf:v2", {}),
    "CNN-7": ("layout:paper", {}),
    "CNN-7, trained as we do": ("layout:cnn-7", {}),
    COMBINED: ("fusion:paper", {}),
    "CNN-7 × CPFv2": ("fusion:paper", {"descriptor": "cpf:v2"}),
    "CNN-7, trained as we do, × CPF": ("fusion:paper", {"weights": {"file": "cnn-7"}}),
    "row / height (baseline)": ("prior:rows", {}),
}
"""What Fig. 6a compares; the baseline and the grey one (Fig. 7) are ours to add."""

GAINS = {TEXTURE: "8 %", COMBINED: "24 %"}
"""P2, section 6.2: by how much these are better than the baseline. (The areas themselves are
printed in the figure alone.)"""

WHOLE = " (isolated areas kept)"
"""Suffix of lines whose likelihood is used unchanged."""


def fig6a(data: Path, out: Path) -> None:
    """Write P2's Fig. 6a: ROC curves and AUC without isolated areas, on CamVid and IDD."""
    sets = {"camvid": streets(data, EVERY // 2)}
    if (data / "idd_lite").is_dir():
        sets["idd"] = subsample_dataset(open_dataset("idd-lite", data / "idd_lite"), IDD_IMAGES)
    contenders, rows = [], []
    for title, (name, settings) in LINES.items():
        contender = contender_from_name(name, settings)
        joined = partial(_prepare_discarding, contender.prepare)
        contenders.append(replace(contender, name=title, prepare=joined))
        contenders.append(replace(contender, name=title + WHOLE))
    for name, dataset in sets.items():
        tallies = tally_of(dataset, contenders)
        rows += [{"set": name, **row} for row in area_rows(tallies)]
        curves = {title: roc(pooled(tallies[title]).road) for title in LINES}
        draw_roc(curves, out / f"p2-fig6a-{name}.png")
    show_table(out / "p2-fig6a.csv", rows)


def _prepare_discarding(prepare: Callable[[Dataset], Predictor], dataset: Dataset) -> Predictor:
    """Discard every area that does not touch the seed area, at every threshold."""
    detect = prepare(dataset)

    def look(image: Tensor, item: LabelledItem) -> Detection:
        detection = detect(image, item)
        return replace(detection, likelihood=reach_of_seed(detection.likelihood))

    return look


def reach_of_seed(likelihood: Tensor) -> Tensor:
    """Return the highest threshold at which each pixel of a map (H, W) is joined to the seed area.

    Thresholded, it is what is left of the map, thresholded, when isolated areas are discarded
    (P2, section 6.2): the greyscale reconstruction of the map from its seed area (Vincent 1993).
    """
    from skimage.morphology import reconstruction

    values = likelihood.numpy()
    marker = np.where(seed_rectangle(likelihood.shape).numpy(), values, 0)
    cross = np.array([[0, 1, 0], [1, 1, 1], [0, 1, 0]])
    return torch.from_numpy(reconstruction(marker, values, footprint=cross).astype(np.float32))


def area_rows(tallies: Mapping[str, Tally]) -> list[dict[str, str]]:
    """Return AUC of each line pooled and by drives, the gains over the baseline, and P2's."""
    areas = {
        title: {
            "AUC, pooled": float(metrics.auc(pooled(tally).road)),
            "mean of drives": fmean(map(float, map(metrics.auc, tally.road.values()))),
        }
        for title, tally in tallies.items()
    }
    rows = []
    for title in (title for title in tallies if not title.endswith(WHOLE)):
        row = {"method": title}
        for kind in ("", WHOLE):
            for average, value in areas[title + kind].items():
                gain = 100 * (value / areas[BASELINE + kind][average] - 1)
                row |= {
                    f"{average}{kind}": f"{value:.3f}",
                    f"over LBP, {average}{kind}": f"{gain:+.0f} %",
                }
        rows.append(row | {"P2's gain": GAINS.get(title, "")})
    return rows


def draw_roc(curves: Mapping[str, Curve], path: Path) -> None:
    """Draw ROC curves in one chart."""
    with chart(path, 6, 5.5) as figure:
        axes = figure.subplots()
        for title, curve in curves.items():
            style = ":" if "baseline" in title else "-"
            axes.plot(curve.x, curve.y, style, label=f"{title}: {float(area(curve)):.3f}")
        axes.set(xlabel="false positive rate", ylabel="true positive rate")
        axes.set(xlim=(0, 1), ylim=(0, 1))
        axes.legend(loc="lower right")


ACCURACY = ("fusion:paper", "fusion:untrained", "fusion", "prior:rows")


def fig6b(data: Path, out: Path) -> None:
    """Write P2's Fig. 6b: road accuracy (recall), beside FPR, precision and F."""
    tallies = tally_of(streets(data), ACCURACY)
    rows = []
    for name in ACCURACY:
        row = {"detector": name, "threshold": f"{contender_from_name(name, {}).threshold:g}"}
        rows.append(row | accuracy_row(pooled(tallies[name])))
    show_table(out / "p2-fig6b.csv", rows)


def accuracy_row(counts: PooledCounts) -> dict[str, float]:
    """Return recall, FPR, precision and F of the detector's masks; the FPR at a recall of 0.95."""
    curve = roc(counts.road)
    at = int(torch.searchsorted(curve.y.contiguous(), 0.95))
    return {
        "road accuracy (recall)": float(metrics.recall(counts.mask)),
        "FPR": float(metrics.false_positive_rate(counts.mask)),
        "precision": float(metrics.precision(counts.mask)),
        "F": float(metrics.f_measure(counts.mask)),
        "FPR where recall is .95": float(curve.x[at]),
    }
