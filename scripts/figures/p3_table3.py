"""P3, Table III and Figs. 8 and 9: areas under ROC curves and the curves, cell by cell.

`roadtorch evaluate --detector 'oneclass:*:*'` makes them of whole sets, with intervals. Here every
k-th picture of CamVid is enough to see the figures in minutes.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import fmean
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from roadtorch.data.dataset import Dataset, every_kth
from roadtorch.detector import Detector
from roadtorch.detectors.catalogue import list_detectors, load_detector
from roadtorch.evaluation.curves import vertical_average, vertical_sample
from roadtorch.evaluation.metrics import auc, count_levels
from roadtorch.io.atomic import csv_text, write_text
from roadtorch.oneclass import CLASSIFIERS
from roadtorch.report.roc_families import KEY, ROW, draw_families
from roadtorch.report.svg import WIDTH
from roadtorch.report.table3 import FAMILY, HALVES, Percents, printed_table, table_lines
from roadtorch.runtime.image_cache import image_cache
from roadtorch.runtime.progress import Progress
from scripts.figures.chart import chart, open_sets

PICTURES = 24
DOTS = 80  # per inch: the file stays small
HISTOGRAMS = tuple(name for name in CLASSIFIERS if name.startswith("hist"))
REPRESENTATIVE = {
    "a": ("nn", "gaussian", "robust_gaussian", "mog2"),
    "b": ("svdd", "pca", "kmeans"),
}
"""Of the other thirteen, by picture; P3, too, shows representative ones, and names none."""


class Cell(NamedTuple):
    """Of one detector on the pictures of one drive: AUC (n,) and TPR at equal FPR (n,steps+1)."""

    areas: Tensor
    rates: Tensor


Drives = Mapping[str, Cell]
"""By drive."""


def measured(dataset: Dataset, detectors: Mapping[str, Detector]) -> dict[str, Drives]:
    """AUC and ROC curves by detector and drive, of the pictures that have road and background."""
    seen: dict[str, dict[str, list[tuple[Tensor, Tensor]]]] = {name: {} for name in detectors}
    for item in Progress(dataset.items, unit="image"):
        image, truth = dataset.read(item)
        if not (truth.road & truth.valid).any() or not (~truth.road & truth.valid).any():
            continue
        with image_cache():
            for name, detector in detectors.items():
                likelihood = detector.detect(image).likelihood
                counts = count_levels(likelihood, truth.road, truth.valid)
                found = auc(counts), vertical_sample(counts)
                seen[name].setdefault(item.group or dataset.name, []).append(found)
    return {
        name: {
            drive: Cell(*(torch.stack(part) for part in zip(*found, strict=True)))
            for drive, found in drives.items()
        }
        for name, drives in seen.items()
    }


def percents(cells: Mapping[str, Drives]) -> Percents:
    """Mean AUC of a drive's pictures, of that the mean over drives, in percent."""
    found = {}
    for name, drives in cells.items():
        _, classifier, planes, *_ = name.split(":")
        found[classifier, planes] = 100 * fmean(float(one.areas.mean()) for one in drives.values())
    return found


def mean_lines(cells: Mapping[str, Drives]) -> dict[tuple[str, str], np.ndarray]:
    """P3's average ROC curve, mean over drives: FPR and TPR (2,points) of each cell."""
    found = {}
    for name, drives in cells.items():
        _, classifier, planes, *_ = name.split(":")
        rates = torch.stack([one.rates.mean(0) for one in drives.values()]).mean(0)
        line = vertical_average(rates)
        found[classifier, planes] = torch.stack([line.x, line.y]).numpy()
    return found


def cells_of(dataset: Dataset, classifiers: Sequence[str]) -> dict[str, Drives]:
    """All cells of the classifiers."""
    names = [name for one in classifiers for name in list_detectors(f"{FAMILY}{one}:*")]
    return measured(dataset, {name: load_detector(name) for name in names})


def rows_csv(tables: Mapping[str, Percents]) -> str:
    """One row a cell, beside P3's value: classifier, representation, auc, paper."""
    paper = printed_table()
    rows = (
        {
            "classifier": key[0] + name,
            "representation": key[1],
            "auc": f"{value:.2f}",
            "paper": paper.get(key, ""),
        }
        for name, table in tables.items()
        for key, value in table.items()
    )
    return csv_text(("classifier", "representation", "auc", "paper"), rows)


def print_table(table: Percents) -> None:
    """Both halves of Table III, ours/P3's."""
    for half, columns in HALVES.items():
        print("\n".join([f"{half}: ours/P3, * best of the column",
                         *table_lines(table, printed_table(), columns), ""]))  # fmt: skip


# --- the figures ------------------------------------------------------------------------


def _families(data: Path, parts: Mapping[Path, Sequence[str]]) -> None:
    """Print the cells of the classifiers, and draw the curves of each part to its file."""
    (camvid,) = open_sets(data, "camvid")
    cells = cells_of(every_kth(camvid, PICTURES), [one for part in parts.values() for one in part])
    print_table(percents(cells))
    lines = mean_lines(cells)
    for path, classifiers in parts.items():
        with chart(path, WIDTH / 72, (KEY + ROW * len(classifiers)) / 72, DOTS) as figure:
            draw_families(figure, lines, classifiers, HALVES)


def fig8(data: Path, out: Path) -> None:
    """P3, Fig. 8: ROC curves of the four histograms, in planes and in combinations."""
    _families(data, {out / "p3-fig8.png": HISTOGRAMS})


def fig9(data: Path, out: Path) -> None:
    """P3, Fig. 9: ROC curves of representative classifiers, in planes and in combinations."""
    _families(data, {out / f"p3-fig9{name}.png": part for name, part in REPRESENTATIVE.items()})


def table3(data: Path, out: Path) -> None:
    """P3, Table III: AUC of 17 classifiers in 19 representations, ours and P3's to the letter."""
    (camvid,) = open_sets(data, "camvid")
    few = every_kth(camvid, PICTURES)
    ours = percents(cells_of(few, tuple(CLASSIFIERS)))
    letter = list_detectors(f"{FAMILY}*:paper")
    paper = percents(measured(few, {name: load_detector(name) for name in letter}))
    print_table(ours)
    print("To the letter, where above the defaults are ours:")
    print_table(paper)
    write_text(out / "p3-table3.csv", rows_csv({"": ours, ":paper": paper}))
