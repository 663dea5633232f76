"""P3, Table III and Figs. 8 and 9: areas under ROC curves and the curves, cell by cell.

A cell is the mean AUC of single images in percent, and of that the mean over CamVid's drives; P3
does not say which average it took. Every k-th image is enough to see the figures in minutes:
`roadtorch evaluate --detector 'oneclass:*:*'` has the cells of whole sets (`auc_mean`).
"""

import csv
from collections.abc import Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import torch
from matplotlib.figure import Figure
from scipy.stats import spearmanr

from roadtorch.data.catalogue import open_dataset
from roadtorch.data.dataset import subsample_dataset
from roadtorch.detectors.catalogue import list_detectors
from roadtorch.evaluation.curves import vertical_average, vertical_sample
from roadtorch.evaluation.evaluate import evaluate
from roadtorch.evaluation.measures import AUC_MEAN
from roadtorch.evaluation.report.charts import (
    COLOURS,
    DASHES,
    GRID_COLOUR,
    INK,
    PANEL_WIDTH,
    Series,
)
from roadtorch.evaluation.result import Evaluation
from roadtorch.imaging.color import REPRESENTATIONS
from roadtorch.oneclass import CLASSIFIERS
from scripts.figures.chart import chart, show_table

IMAGES = 24
DOTS = 80  # per inch: the file stays small
ROW, KEY = 190, 60  # points, of the panels of one classifier and of the names of the lines
PRINTED = Path(__file__).resolve().parents[2] / "docs" / "research" / "oneclass_table3.csv"
SINGLE = tuple(name for name, planes in REPRESENTATIONS.items() if len(planes) == 1)
HALVES = {
    "single planes": SINGLE,
    "combinations": tuple(name for name in REPRESENTATIONS if name not in SINGLE),
}
"""Of the table and of the figures: by title, the representations."""

HISTOGRAMS = tuple(name for name in CLASSIFIERS if name.startswith("hist"))
REPRESENTATIVE = {
    "a": ("nn", "gaussian", "robust_gaussian", "mog2"),
    "b": ("svdd", "pca", "kmeans"),
}
"""Of the other thirteen, by image; P3, too, shows representative ones, and names none."""

Key = tuple[str, str]
"""Classifier, with ":paper" for P3's exact variant, and representation."""


def printed_table() -> Mapping[Key, float]:
    """Read P3's own 307 values: Table III of arXiv 1412.3506, both halves side by side."""
    with PRINTED.open(encoding="utf-8", newline="") as file:
        return {
            (row["classifier"], row["representation"]): float(row["p3"])
            for row in csv.DictReader(file)
            if row["classifier"] in CLASSIFIERS and row["p3"]
        }


def evaluate_few(data: Path, patterns: Sequence[str]) -> Evaluation:
    """Measure the AUC of detectors on some images of CamVid."""
    few = subsample_dataset(open_dataset("camvid", data / "camvid"), IMAGES)
    return evaluate(few, patterns, with_baselines=False, measures=(AUC_MEAN,), quiet=False)


def cells(evaluation: Evaluation) -> Mapping[Key, str]:
    """Return the one-class detectors of a run by classifier and representation."""
    parts = {name: name.split(":")[1:] for name in evaluation.detectors}
    return {
        (":".join([kind, *paper]), planes): name for name, (kind, planes, *paper) in parts.items()
    }


def percents(evaluation: Evaluation) -> Mapping[Key, float]:
    """Return AUC in percent."""
    figures = evaluation.headlines
    return {key: 100 * AUC_MEAN.get(figures[name]) for key, name in cells(evaluation).items()}


def mean_lines(evaluation: Evaluation) -> Mapping[Key, np.ndarray]:
    """Return P3's average ROC curve, mean over drives: FPR and TPR (2, points) of each cell."""
    lines = {}
    for key, name in cells(evaluation).items():
        tally, groups = evaluation.tallies[name], evaluation.detectors[name].counted_groups
        rates = [vertical_sample(tally.table([group]).road).nanmean(0) for group in groups]
        line = vertical_average(torch.stack(rates).nanmean(0))
        lines[key] = torch.stack([line.x, line.y]).numpy()
    return lines


def table_rows(evaluation: Evaluation) -> list[Mapping[str, object]]:
    """Return a row a cell: AUC in percent, its 95 % interval, P3's value."""
    paper, names = printed_table(), cells(evaluation)
    rows = []
    for (name, planes), value in percents(evaluation).items():
        low, high = evaluation.detectors[names[name, planes]].intervals[AUC_MEAN.key]
        figures = {"auc": value, "low": 100 * low, "high": 100 * high}
        row = {"classifier": name, "representation": planes}
        row |= {key: f"{figure:.2f}" for key, figure in figures.items()}
        rows.append(row | {"paper": paper.get((name.removesuffix(":paper"), planes), "")})
    return rows


def rank_correlation(values: Mapping[Key, float], columns: Sequence[str]) -> float:
    """Return Spearman's coefficient with P3's table, over cells of some columns that both have."""
    paper = printed_table()
    shared = [key for key in values if key in paper and key[1] in columns]
    ranked: Any = spearmanr([values[key] for key in shared], [paper[key] for key in shared])
    return float(ranked.statistic)


# --- the curves -------------------------------------------------------------------------


def draw_families(
    figure: Figure, lines: Mapping[Key, np.ndarray], classifiers: Sequence[str]
) -> None:
    """Draw a row of panels for each classifier and, below them, the names of the lines."""
    panels = figure.subplots(len(classifiers), len(HALVES), sharex=True, sharey=True, squeeze=False)
    for row, name in zip(panels, classifiers, strict=True):
        for axes, (half, planes) in zip(row, HALVES.items(), strict=True):
            axes.set_title(f"{name}, {half}", fontsize=9, color=INK)
            axes.plot([0, 1], [0, 1], color=GRID_COLOUR, linewidth=1)
            for number, representation in enumerate(planes):
                line = lines.get((name, representation), ([], []))
                dash = DASHES[number // len(COLOURS)]
                series = Series(representation, COLOURS[number % len(COLOURS)], dash)
                axes.plot(*line, label=representation, **series.line(1.2))
            axes.set(xlim=(0, 1), ylim=(0, 1))
            axes.label_outer()
    below = {"loc": "upper center", "bbox_to_anchor": (0.5, -0.28), "ncols": 4, "fontsize": 8}
    for axes in panels[-1]:
        axes.set_xlabel("false positive rate")
        axes.legend(**below, handlelength=2.2, columnspacing=1)


def draw_curves(data: Path, parts: Mapping[Path, Sequence[str]]) -> None:
    """Draw the curves of each part's classifiers to its file."""
    run = evaluate_few(data, [f"oneclass:{name}:*" for name in chain(*parts.values())])
    lines = mean_lines(run)
    for path, classifiers in parts.items():
        with chart(path, PANEL_WIDTH / 72, (KEY + ROW * len(classifiers)) / 72, DOTS) as figure:
            draw_families(figure, lines, classifiers)


def fig8(data: Path, out: Path) -> None:
    """Write P3's Fig. 8: ROC curves of the four histograms, in planes and in combinations."""
    draw_curves(data, {out / "p3-fig8.png": HISTOGRAMS})


def fig9(data: Path, out: Path) -> None:
    """Write P3's Fig. 9: ROC curves of some classifiers, in planes and in combinations."""
    draw_curves(data, {out / f"p3-fig9{name}.png": part for name, part in REPRESENTATIVE.items()})


def table3(data: Path, out: Path) -> None:
    """Write P3's Table III: AUC of 17 classifiers in 19 representations, ours and P3's."""
    patterns = ["oneclass:*:*", *list_detectors("oneclass:*:paper")]
    run = evaluate_few(data, patterns)
    show_table(out / "p3-table3.csv", table_rows(run))
    values = percents(run)
    for half, planes in HALVES.items():
        correlation = rank_correlation(values, planes)
        print(f"Spearman's rank correlation with P3, {half}: {correlation:+.2f}")
