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

from roadtorch.base.atomic import atomic
from roadtorch.data.catalogue import open_dataset
from roadtorch.data.dataset import Dataset, LabelledItem, every_kth
from roadtorch.detectors.detector import Detection
from roadtorch.evaluation import metrics
from roadtorch.evaluation.curves import Curve, area, roc
from roadtorch.evaluation.evaluate import evaluated
from roadtorch.evaluation.methods import Contender, Look, named_detector
from roadtorch.evaluation.metrics import auc
from roadtorch.evaluation.tally import Part, Tally, of_groups
from roadtorch.layout.classes import HORIZONTAL, SKY, VERTICAL
from roadtorch.road.seed_area import seed_rectangle
from scripts.figures.chart import tell

EVERY = 16
"""Figures look at every so-manieth picture of CamVid; Fig. 6a at twice as many."""

IDD_PICTURES = 50


def streets(data: Path, every: int = EVERY) -> Dataset:
    """CamVid's test split, which P2's figures show, where ``data`` has it; else its dev drives."""
    root = data / "camvid"
    split = "test" if (root / "test").is_dir() else "dev"
    dataset = open_dataset("camvid", root, split)
    chosen = every_kth(dataset, -(-len(dataset.items) // every))
    print(f"CamVid {split}, {len(chosen.items)} of {len(dataset.items)} pictures", end="\n\n")
    return chosen


def scored(
    dataset: Dataset,
    detectors: Mapping[str, tuple[str, Mapping[str, Any]]],
    changed: Callable[[Contender], Contender] = lambda contender: contender,
) -> Mapping[str, Tally]:
    """What is counted of detectors; by title, their names and settings. changed: of each one.

    RuntimeError for a picture that fails.
    """
    entries = [
        replace(changed(named_detector(name, settings)), name=title)
        for title, (name, settings) in detectors.items()
    ]
    run = evaluated(dataset, entries, measures=(), quiet=False)
    for failure in run.failures:
        raise RuntimeError(f"{failure.image}: {failure.reason}")
    return run.tallies


def pooled(tally: Tally) -> Part:
    """The pixels of all drives together, as P2 has them."""
    return of_groups(tally, dict.fromkeys(tally.road, 0.5))


# --- layout ------------------------------------------------------------------------------

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
    _confusion("p2-fig4b", "layout:paper", streets(data), out)


def confusion_of_labeller(data: Path, out: Path) -> None:
    """Fig. 4c: the confusion of the teacher; ours is `labeller`, P2's is Hoiem et al."""
    _confusion("p2-fig4c", "labeller", streets(data), out)


def _confusion(figure: str, name: str, dataset: Dataset, out: Path) -> None:
    counts = pooled(scored(dataset, {name: (name, {})})[name]).layout
    assert counts is not None
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
    tell(out / f"{figure}.csv", list(rows[0]), rows)
    for text, each in (*shares.items(), ("P2", PRINTED[figure])):
        print(f"{name}, {text}: global average accuracy {np.diagonal(each).mean():.3f}")
    draw_confusion(shares["void vertical"], name, out / f"{figure}.png")


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
    for (row, column), value in np.ndenumerate(shares):
        colour = "white" if value > 0.5 else "black"
        axes.text(column, row, f"{value:.3f}", ha="center", va="center", color=colour)
    axes.set_xticks(range(3), list(PRINTED_ORDER))
    axes.set_yticks(range(3), list(PRINTED_ORDER))
    axes.set(xlabel="decision", ylabel="truth")
    axes.set_title(f"{title}: mean of the diagonal {np.diagonal(shares).mean():.3f}", fontsize=10)
    with atomic(path) as temporary:
        figure.savefig(temporary, format="png", dpi=120)
    print(path)


# --- road --------------------------------------------------------------------------------

BASELINE, TEXTURE, COMBINED = "LBP (baseline)", "CPF", "CNN-7 × CPF"

LINES = {
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
"""Behind the titles of lines whose likelihood is taken as it is."""


def roc_curves(data: Path, out: Path) -> None:
    """Fig. 6a: ROC curves and their areas, isolated areas discarded, on CamVid and IDD."""
    sets = {"camvid": streets(data, EVERY // 2)}
    if (data / "idd_lite").is_dir():
        sets["idd"] = every_kth(open_dataset("idd-lite", data / "idd_lite"), IDD_PICTURES)
    rows = []
    for name, dataset in sets.items():
        whole = {title + WHOLE: line for title, line in LINES.items()}
        tallies = {**scored(dataset, LINES, discarding), **scored(dataset, whole)}
        rows += [{"set": name, **row} for row in area_rows(tallies)]
        lines = {title: roc(pooled(tallies[title]).road) for title in LINES}
        draw_roc(lines, out / f"p2-fig6a-{name}.png")
    tell(out / "p2-fig6a.csv", list(rows[0]), rows)


def discarding(contender: Contender) -> Contender:
    """The same with every area discarded that does not touch the seed area, at every threshold."""
    return replace(contender, prepare=partial(_discarding, contender.prepare))


def _discarding(prepare: Callable[[Dataset], Look], dataset: Dataset) -> Look:
    detect = prepare(dataset)

    def look(image: Tensor, item: LabelledItem) -> Detection:
        detection = detect(image, item)
        return replace(detection, likelihood=reaching_seed(detection.likelihood))

    return look


def reaching_seed(likelihood: Tensor) -> Tensor:
    """The highest threshold at which each pixel of a map (H,W) is joined to the seed area.

    Thresholded, it is what is left of the map, thresholded, when isolated areas are discarded
    (P2, section 6.2): the greyscale reconstruction of the map from its seed area (Vincent 1993).
    """
    from skimage.morphology import reconstruction

    values = likelihood.numpy()
    marker = np.where(seed_rectangle(likelihood.shape).numpy(), values, 0)
    cross = np.array([[0, 1, 0], [1, 1, 1], [0, 1, 0]])
    return torch.from_numpy(reconstruction(marker, values, footprint=cross).astype(np.float32))


def area_rows(tallies: Mapping[str, Tally]) -> list[dict[str, str]]:
    """AUC of each line pooled and by drives, the gains over the baseline, and P2's."""

    def areas(title: str) -> tuple[float, float]:
        road = tallies[title].road
        return float(auc(pooled(tallies[title]).road)), fmean(map(float, map(auc, road.values())))

    rows, bases = [], {kind: areas(BASELINE + kind) for kind in ("", WHOLE)}
    for title in (title for title in tallies if not title.endswith(WHOLE)):
        row = {"method": title}
        for kind, base in bases.items():
            names = ("AUC, pooled", "over LBP", "mean of drives", "over LBP by drives")
            values = [
                text
                for area, of_base in zip(areas(title + kind), base, strict=True)
                for text in (f"{area:.3f}", f"{100 * (area / of_base - 1):+.0f} %")
            ]
            row |= {name + kind: value for name, value in zip(names, values, strict=True)}
        rows.append(row | {"P2's gain": GAINS.get(title, "")})
    return rows


def draw_roc(curves: Mapping[str, Curve], path: Path) -> None:
    """ROC curves in one picture."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6, 5.5), layout="constrained")
    axes = figure.subplots()
    for text, curve in curves.items():
        style = ":" if "baseline" in text else "-"
        axes.plot(curve.x, curve.y, style, label=f"{text}: {float(area(curve)):.3f}")
    axes.set(xlabel="false positive rate", ylabel="true positive rate", xlim=(0, 1), ylim=(0, 1))
    axes.grid(alpha=0.3)
    axes.legend(loc="lower right")
    with atomic(path) as temporary:
        figure.savefig(temporary, format="png", dpi=120)
    print(path)


ACCURACY = ("fusion:paper", "fusion:untrained", "fusion", "prior:rows")


def road_accuracy(data: Path, out: Path) -> None:
    """Fig. 6b: road accuracy, the share of road that is found; what it costs stands beside."""
    rows = []
    for name, tally in scored(streets(data), {name: (name, {}) for name in ACCURACY}).items():
        own = {"detector": name, "threshold": f"{named_detector(name, {}).threshold:g}"}
        rows.append(own | accuracy_row(pooled(tally)))
    tell(out / "p2-fig6b.csv", list(rows[0]), rows)


def accuracy_row(counts: Part) -> dict[str, str]:
    """Recall, FPR, precision and F of the detector's own masks; the FPR at a recall of 0.95."""
    figures = {
        "road accuracy (recall)": metrics.recall,
        "FPR": metrics.false_positive_rate,
        "precision": metrics.precision,
        "F": metrics.f_measure,
    }
    own = {text: f"{float(figure(counts.mask)):.3f}" for text, figure in figures.items()}
    curve = roc(counts.road)
    at = int(torch.searchsorted(curve.y.contiguous(), 0.95))
    return own | {"FPR where recall is .95": f"{float(curve.x[at]):.3f}"}
