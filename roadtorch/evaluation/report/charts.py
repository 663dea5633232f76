"""Charts of a run: scores, curves, and the single pictures, each as SVG text (`svg.to_svg`)."""

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from matplotlib.ticker import FuncFormatter

from roadtorch.evaluation.document import Curves, RunCurves
from roadtorch.evaluation.measure import Measure
from roadtorch.evaluation.measures import F_MASK, MAXF
from roadtorch.evaluation.report.svg import (
    BAND,
    BASELINE,
    GRID,
    INK,
    PAPER,
    Series,
    short,
    to_svg,
)
from roadtorch.evaluation.report.table import MINUS
from roadtorch.evaluation.result import (
    Comparison,
    DetectorFigures,
    Evaluation,
    Interval,
    PictureRow,
)

MARKERS = ("o", "^", "s", "D", "v", "P")  # groups

MAX_GROUPS = len(MARKERS)  # told apart in a chart

MAX_TICKS = 300  # pictures of one group and detector in a chart

# --- scores -----------------------------------------------------------------------------


def score_chart(series: Sequence[Series], evaluation: Evaluation, measure: Measure) -> str:
    """A measure of every detector with its 95 % interval, groups as small marks; empty without."""
    scores = {
        detector.name: measure.of(evaluation.detectors[detector.name].headline)
        for detector in series
    }
    shown = [detector for detector in series if not math.isnan(scores[detector.name])]
    groups = evaluation.groups
    baselines = [scores[detector.name] for detector in shown if detector.is_baseline]

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        _name_rows(axes, shown)
        if baselines:
            axes.axvline(max(baselines), color=BASELINE, linewidth=1, dashes=(4, 3))
            axes.annotate(f"best baseline {max(baselines):.3f}", (max(baselines), 1), (0, 3),
                          xycoords=("data", "axes fraction"), textcoords="offset points",
                          ha="center", va="bottom", color=BASELINE, fontsize=9)  # fmt: skip
        for row, detector in enumerate(shown):
            _score_row(axes, row, detector, evaluation.detectors[detector.name], measure, groups)
        axes.set_xlabel(f"{measure.line} (mean over groups)" if groups else measure.line)
        if 1 < len(groups) <= MAX_GROUPS:
            style = {"linestyle": "", "color": INK, "mfc": "none", "markersize": 4.5, "mew": 0.8}
            marks = [
                Line2D([], [], marker=MARKERS[i], label=short(name), **style)
                for i, name in enumerate(groups)
            ]
            figure.legend(handles=marks, loc="outside lower left", ncols=3, fontsize=9)

    label, height = f"{measure.line} with 95 % intervals", 78 + 24 * len(shown)
    return to_svg(measure.key, label, height, draw) if shown else ""


def _score_row(
    axes: Axes,
    row: int,
    detector: Series,
    figures: DetectorFigures,
    measure: Measure,
    groups: Sequence[str],
) -> None:
    value = measure.of(figures.headline)
    ends = figures.intervals.get(measure.key, Interval())
    _dot_with_interval(axes, row, detector, value, ends)
    for place, group in enumerate(groups):
        marker = MARKERS[place] if len(groups) <= MAX_GROUPS else "|"
        of_group = measure.of(figures.group(group))
        axes.plot(of_group, row, marker, color=INK, mfc="none", markersize=4.5, mew=0.8, alpha=0.7)
    axes.annotate(f"{value:.3f}", (1, row), (4, 0), xycoords=("axes fraction", "data"),
                  textcoords="offset points", va="center", annotation_clip=False)  # fmt: skip


def _dot_with_interval(
    axes: Axes, row: int, detector: Series, value: float, ends: Interval
) -> None:
    if ends.is_known:
        axes.plot(ends, [row, row], color=detector.colour, linewidth=2.6, alpha=0.65)
    face = PAPER if detector.is_baseline else detector.colour
    axes.plot(value, row, "o", color=detector.colour, mfc=face, markersize=7.5, mew=1.4, zorder=3)


def difference_chart(series: Sequence[Series], comparison: Comparison) -> str:
    """Differences in MaxF to the detector ``against`` with 95 % intervals."""
    changes = {
        name: of_name[MAXF.key]
        for name, of_name in comparison.differences.items()
        if MAXF.key in of_name and not math.isnan(of_name[MAXF.key].value)
    }
    shown = [detector for detector in series if detector.name in changes]

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        _name_rows(axes, shown)
        axes.axvline(0, color=INK, linewidth=1)
        for row, detector in enumerate(shown):
            change = changes[detector.name]
            _dot_with_interval(axes, row, detector, change.value, change.interval)
        # What rounding leaves of zero has no sign.
        axes.xaxis.set_major_formatter(
            FuncFormatter(
                lambda x, _: f"{round(x, 9):+g}".replace("-", MINUS) if abs(x) > 5e-10 else "0"
            )
        )
        axes.set_xlabel(f"MaxF minus that of {short(comparison.against)}")
        axes.margins(x=0.08)

    label = "Paired differences in MaxF with 95 % intervals"
    return to_svg("paired", label, 62 + 24 * len(shown), draw) if shown else ""


def _name_rows(axes: Axes, shown: Sequence[Series]) -> None:
    """One row a detector, first on top, baselines on a band."""
    axes.set_yticks(range(len(shown)), [short(detector.name) for detector in shown])
    axes.tick_params(axis="y", length=0)
    axes.grid(visible=False, axis="y")
    axes.set_ylim(len(shown) - 0.5, -0.5)
    for row, (detector, text) in enumerate(zip(shown, axes.get_yticklabels(), strict=True)):
        if detector.is_baseline:
            axes.axhspan(row - 0.5, row + 0.5, color=BAND, linewidth=0, zorder=0)
            text.set_color(BASELINE)


# --- curves -----------------------------------------------------------------------------

Known = Sequence[tuple[Series, np.ndarray]]
"""Detectors with the coordinates of their mean curve, float64 (coordinates,points)."""


def _known(series: Sequence[Series], curves: RunCurves, kind: str) -> Known:
    """The detectors that have a mean curve of one kind, the best first."""
    means = [
        (detector, _points(curves[detector.name]["mean"], kind))
        for detector in series
        if detector.name in curves
    ]
    return [(detector, points) for detector, points in means if points.size]


def _points(curves: Curves, kind: str) -> np.ndarray:
    """The coordinates of one curve where they are known, float64 (coordinates,points)."""
    lists = curves.get(kind)
    points = np.array(lists if lists and all(lists) else [[], []], dtype=np.float64)
    return points[:, np.isfinite(points[:2]).all(0)]


def roc_chart(series: Sequence[Series], curves: RunCurves) -> str:
    """ROC curves, and their corner at few false positives once more, larger."""
    known = _known(series, curves, "roc")

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        axes.plot([0, 1], [0, 1], color=GRID, linewidth=1)
        inset = axes.inset_axes((0.42, 0.1, 0.55, 0.55), xlim=(0, 0.2), ylim=(0.8, 1))
        for part in (axes, inset):
            _draw_curves(part, known, curves, "roc")
        _finish_inset(axes, inset)
        axes.set(xlabel="false positive rate", ylabel="true positive rate (recall)")

    return to_svg("roc", "ROC curves", 440, draw) if known else ""


def precision_chart(series: Sequence[Series], curves: RunCurves) -> str:
    """Precision over recall, lines of equal F, and the corner near (1,1) once more, larger."""
    known = _known(series, curves, "pr")

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        inset = axes.inset_axes((0.1, 0.1, 0.5, 0.5), xlim=(0.7, 1), ylim=(0.7, 1))
        for part, levels in ((axes, (0.3, 0.5, 0.7, 0.8, 0.9)), (inset, (0.85, 0.9, 0.95))):
            _draw_equal_f(part, levels)
            _draw_curves(part, known, curves, "pr")
        _finish_inset(axes, inset)
        axes.set(xlabel="recall", ylabel="precision")

    return to_svg("pr", "Precision and recall", 440, draw) if known else ""


def _draw_curves(axes: Axes, known: Known, curves: RunCurves, kind: str) -> None:
    """The means of all, best on top; thin lines for the groups of the best detector."""
    best = next((detector for detector, _ in known if not detector.is_baseline), None)
    for depth, (detector, (x, y, *_)) in enumerate(known):
        axes.plot(x, y, **detector.line(1.2 if detector.is_baseline else 2), zorder=4 - depth / 100)
        for group in curves[detector.name]["groups"].values() if detector is best else ():
            x, y, *_ = _points(group, kind)
            axes.plot(x, y, color=detector.colour, linewidth=0.7, alpha=0.75, zorder=3)


def _draw_equal_f(axes: Axes, levels: Sequence[float]) -> None:
    """F is 2PR/(P+R): where it is constant, P = F·R/(2R-F), which is 1 at R = F/(2-F)."""
    for level in levels:
        recall = np.linspace(level / (2 - level), 1, 60)
        axes.plot(recall, level * recall / (2 * recall - level), color=GRID, linewidth=0.8)
        axes.annotate(f"F {level:g}", (recall[0], 1), (0, 3), xycoords=("data", "axes fraction"),
                      textcoords="offset points", ha="center", fontsize=8, color=BASELINE,
                      annotation_clip=False)  # fmt: skip


def _finish_inset(axes: Axes, inset: Axes) -> None:
    axes.set(xlim=(0, 1), ylim=(0, 1))
    axes.grid(visible=False)
    inset.grid(visible=False)
    inset.patch.set_facecolor(PAPER)
    inset.tick_params(labelsize=8)
    inset.locator_params(nbins=4)
    for spine in inset.spines.values():
        spine.set_visible(True)
    (left, right), (bottom, top) = inset.get_xlim(), inset.get_ylim()
    frame = Rectangle((left, bottom), right - left, top - bottom, fill=False, edgecolor=BASELINE)
    axes.add_patch(frame)


def reliability_chart(series: Sequence[Series], curves: RunCurves) -> str:
    """The share of road among pixels of each likelihood; below, how many pixels have it."""
    known = _known(series, curves, "reliability")

    def draw(figure: Figure) -> None:
        upper, lower = figure.subplots(2, sharex=True, height_ratios=(3, 1))
        upper.plot([0, 1], [0, 1], color=BASELINE, linewidth=1)
        for depth, (detector, (predicted, observed, *shares)) in enumerate(known):
            style = {
                **detector.line(1.1 if detector.is_baseline else 1.8),
                "zorder": 4 - depth / 100,
            }
            upper.plot(predicted, observed, marker="" if detector.is_baseline else ".", **style)
            for share in shares:
                lower.plot(predicted, np.where(share > 0, share, np.nan), **style)
        upper.set(xlim=(-0.01, 1.01), ylim=(0, 1.01), ylabel="share of road")
        lower.set(yscale="log", xlabel="likelihood", ylabel="pixels")
        lower.yaxis.set_major_formatter(FuncFormatter(lambda y, _: f"{100 * y:g} %"))
        lower.yaxis.set_minor_formatter(FuncFormatter(lambda *_: ""))

    return to_svg("reliability", "Reliability of the likelihoods", 440, draw) if known else ""


def risk_chart(series: Sequence[Series], curves: RunCurves) -> str:
    """The mean 1 - F of the most trusted pictures over how many are kept; dotted: the ideal."""
    known = _known(series, curves, "risk")

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        for depth, (detector, (x, y)) in enumerate(known):
            axes.plot(x, y, **detector.line(2), zorder=4 - depth / 100)
            axes.plot([0, 1], [y[-1], y[-1]], color=detector.colour, linewidth=0.7, alpha=0.75)
            ideal = _points(curves[detector.name]["mean"], "risk_ideal")
            axes.plot(*ideal, color=detector.colour, linewidth=1.1, linestyle=":")
        axes.set(xlim=(0, 1), xlabel="pictures kept, the most trusted first", ylabel="mean 1 - F")
        axes.set_ylim(bottom=0)

    return to_svg("risk", "Risk over coverage", 320, draw) if known else ""


# --- pictures ---------------------------------------------------------------------------


def distribution_chart(series: Sequence[Series], rows: Sequence[PictureRow]) -> str:
    """F of the single pictures by detector and group: a tick each, quartiles and deciles."""
    names = {detector.name for detector in series}
    values: dict[str, dict[str, list[float]]] = {}
    groups = sorted({row.group for row in rows})
    for row in rows:
        if row.detector in names and not math.isnan(row.f):
            group = row.group if len(groups) <= MAX_GROUPS else ""
            values.setdefault(row.detector, {}).setdefault(group, []).append(row.f)
    shown = [detector for detector in series if detector.name in values]
    lanes = groups if 1 < len(groups) <= MAX_GROUPS else [""]

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        _name_rows(axes, shown)
        for row, detector in enumerate(shown):
            for place, group in enumerate(sorted(values[detector.name])):
                middle = row + (place + 0.5) / max(len(values[detector.name]), 1) * 0.84 - 0.42
                _draw_lane(axes, middle, 0.3 / len(lanes), detector, values[detector.name][group])
                if len(lanes) > 1:
                    axes.annotate(short(group), (1, middle), (4, 0), fontsize=8, va="center",
                                  xycoords=("axes fraction", "data"), color=BASELINE,
                                  textcoords="offset points", annotation_clip=False)  # fmt: skip
        axes.set_xlim(right=1)
        axes.set_xlabel("F of a picture, at its group's threshold")

    height = 46 + len(shown) * max(26, 13 * len(lanes))
    return to_svg("pictures", "F of the single pictures", height, draw) if shown else ""


def _draw_lane(
    axes: Axes, middle: float, half: float, detector: Series, values: Sequence[float]
) -> None:
    """Ticks for pictures, a line from the first to the last decile, a bar between quartiles."""
    every = np.sort(np.array(values))
    kept = every[np.unique(np.linspace(0, len(every) - 1, MAX_TICKS).round().astype(int))]
    x = np.repeat(kept, 3)
    y = np.tile([middle - half, middle + half, np.nan], len(kept))
    axes.plot(x, y, color=detector.colour, linewidth=0.6, alpha=0.55, zorder=2)
    low, first, median, third, high = np.quantile(every, (0.1, 0.25, 0.5, 0.75, 0.9))
    axes.plot([low, high], [middle, middle], color=INK, linewidth=0.9, zorder=3)
    axes.plot([first, third], [middle, middle], color=INK, linewidth=3.2, zorder=3)
    axes.plot(median, middle, "o", color=INK, mfc=PAPER, markersize=4, mew=1, zorder=4)


def all_charts(
    evaluation: Evaluation,
    series: Sequence[Series],
    curves: RunCurves,
    rows: Sequence[PictureRow],
) -> dict[str, str]:
    """SVG by name; empty where there is nothing to draw."""
    return {
        "f_mask": score_chart(series, evaluation, F_MASK),
        "maxf": score_chart(series, evaluation, MAXF),
        "paired": difference_chart(series, evaluation.comparison),
        "roc": roc_chart(series, curves),
        "pr": precision_chart(series, curves),
        "reliability": reliability_chart(series, curves),
        "risk": risk_chart(series, curves),
        "pictures": distribution_chart(
            series, [row for row in rows if row.group not in evaluation.left_out]
        ),
    }
