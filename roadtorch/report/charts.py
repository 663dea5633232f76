"""Charts of a run: scores, curves, and the single pictures, each as SVG text (`svg.to_svg`)."""

import math
from collections.abc import Iterator, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from matplotlib.ticker import FuncFormatter

from roadtorch.evaluation.document import Curves, DetectorCurves, RunCurves
from roadtorch.evaluation.measure import Measure
from roadtorch.evaluation.measures import F_MASK, MAXF
from roadtorch.evaluation.result import (
    Comparison,
    DetectorFigures,
    Evaluation,
    Interval,
    PictureRow,
)
from roadtorch.report.svg import (
    BAND,
    BASELINE,
    GRID,
    INK,
    PAPER,
    Series,
    short,
    to_svg,
)
from roadtorch.report.table import MINUS

MARKERS = ("o", "^", "s", "D", "v", "P")  # groups

MAX_GROUPS = len(MARKERS)  # told apart in a chart

MAX_TICKS = 300  # pictures of one group and detector in a chart

# --- scores -----------------------------------------------------------------------------


def score_chart(series: Sequence[Series], evaluation: Evaluation, measure: Measure) -> str:
    """A measure of every detector with its 95 % interval, groups as small marks; empty without."""
    scores = {one.name: measure.of(evaluation.detectors[one.name].headline) for one in series}
    shown = [one for one in series if not math.isnan(scores[one.name])]
    groups = evaluation.groups
    baselines = [scores[one.name] for one in shown if one.is_baseline]

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        _name_rows(axes, shown)
        if baselines:
            axes.axvline(max(baselines), color=BASELINE, linewidth=1, dashes=(4, 3))
            axes.annotate(f"best baseline {max(baselines):.3f}", (max(baselines), 1), (0, 3),
                          xycoords=("data", "axes fraction"), textcoords="offset points",
                          ha="center", va="bottom", color=BASELINE, fontsize=9)  # fmt: skip
        for row, one in enumerate(shown):
            _score_row(axes, row, one, evaluation.detectors[one.name], measure, groups)
        axes.set_xlabel(f"{measure.line} (mean over groups)" if groups else measure.line)
        if 1 < len(groups) <= MAX_GROUPS:
            look = {"linestyle": "", "color": INK, "mfc": "none", "markersize": 4.5, "mew": 0.8}
            marks = [
                Line2D([], [], marker=MARKERS[i], label=short(name), **look)
                for i, name in enumerate(groups)
            ]
            figure.legend(handles=marks, loc="outside lower left", ncols=3, fontsize=9)

    label, height = f"{measure.line} with 95 % intervals", 78 + 24 * len(shown)
    return to_svg(measure.key, label, height, draw) if shown else ""


def _score_row(
    axes: Axes,
    row: int,
    one: Series,
    figures: DetectorFigures,
    measure: Measure,
    groups: Sequence[str],
) -> None:
    value = measure.of(figures.headline)
    ends = figures.intervals.get(measure.key, Interval())
    _dot_with_interval(axes, row, one, value, ends)
    for place, group in enumerate(groups):
        marker = MARKERS[place] if len(groups) <= MAX_GROUPS else "|"
        of_group = measure.of(figures.group(group))
        axes.plot(of_group, row, marker, color=INK, mfc="none", markersize=4.5, mew=0.8, alpha=0.7)
    axes.annotate(f"{value:.3f}", (1, row), (4, 0), xycoords=("axes fraction", "data"),
                  textcoords="offset points", va="center", annotation_clip=False)  # fmt: skip


def _dot_with_interval(axes: Axes, row: int, one: Series, value: float, ends: Interval) -> None:
    if ends.is_known:
        axes.plot(ends, [row, row], color=one.colour, linewidth=2.6, alpha=0.65)
    face = PAPER if one.is_baseline else one.colour
    axes.plot(value, row, "o", color=one.colour, mfc=face, markersize=7.5, mew=1.4, zorder=3)


def difference_chart(series: Sequence[Series], comparison: Comparison) -> str:
    """Differences in MaxF to the detector ``against`` with 95 % intervals."""
    changes = {
        name: of_name[MAXF.key]
        for name, of_name in comparison.differences.items()
        if MAXF.key in of_name and not math.isnan(of_name[MAXF.key].value)
    }
    shown = [one for one in series if one.name in changes]

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        _name_rows(axes, shown)
        axes.axvline(0, color=INK, linewidth=1)
        for row, one in enumerate(shown):
            change = changes[one.name]
            _dot_with_interval(axes, row, one, change.value, change.interval)
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
    axes.set_yticks(range(len(shown)), [short(one.name) for one in shown])
    axes.tick_params(axis="y", length=0)
    axes.grid(visible=False, axis="y")
    axes.set_ylim(len(shown) - 0.5, -0.5)
    for row, (one, text) in enumerate(zip(shown, axes.get_yticklabels(), strict=True)):
        if one.is_baseline:
            axes.axhspan(row - 0.5, row + 0.5, color=BAND, linewidth=0, zorder=0)
            text.set_color(BASELINE)


# --- curves -----------------------------------------------------------------------------


def roc_chart(series: Sequence[Series], curves: RunCurves) -> str:
    """ROC curves, and their corner at few false positives once more, larger."""

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        axes.plot([0, 1], [0, 1], color=GRID, linewidth=1)
        inset = axes.inset_axes((0.42, 0.1, 0.55, 0.55), xlim=(0, 0.2), ylim=(0.8, 1))
        for one in (axes, inset):
            _draw_curves(one, series, curves, "roc")
        _finish_inset(axes, inset)
        axes.set(xlabel="false positive rate", ylabel="true positive rate (recall)")

    return to_svg("roc", "ROC curves", 440, draw) if _has(series, curves, "roc") else ""


def precision_chart(series: Sequence[Series], curves: RunCurves) -> str:
    """Precision over recall, lines of equal F, and the corner near (1,1) once more, larger."""

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        inset = axes.inset_axes((0.1, 0.1, 0.5, 0.5), xlim=(0.7, 1), ylim=(0.7, 1))
        for one, levels in ((axes, (0.3, 0.5, 0.7, 0.8, 0.9)), (inset, (0.85, 0.9, 0.95))):
            _draw_equal_f(one, levels)
            _draw_curves(one, series, curves, "pr")
        _finish_inset(axes, inset)
        axes.set(xlabel="recall", ylabel="precision")

    return to_svg("pr", "Precision and recall", 440, draw) if _has(series, curves, "pr") else ""


def _has(series: Sequence[Series], curves: RunCurves, kind: str) -> bool:
    return any(list(_lines(_of(curves, one)["mean"], kind)) for one in series)


def _of(curves: RunCurves, one: Series) -> DetectorCurves:
    return curves.get(one.name, {"mean": {}, "groups": {}})


def _lines(curves: Curves, kind: str) -> Iterator[np.ndarray]:
    """The coordinates of one curve, float64 (coordinates,points), where they are known."""
    lists = curves.get(kind)
    if lists and all(lists):
        points = np.array(lists, dtype=np.float64)
        points = points[:, np.isfinite(points[:2]).all(0)]
        if points.shape[1]:
            yield points


def _draw_curves(axes: Axes, series: Sequence[Series], curves: RunCurves, kind: str) -> None:
    """The means of all, best on top; thin lines for the groups of the best detector."""
    best = next((one for one in series if not one.is_baseline), None)
    for depth, one in enumerate(series):
        own = _of(curves, one)
        for x, y, *_ in _lines(own["mean"], kind):
            width = 1.2 if one.is_baseline else 2
            axes.plot(x, y, **one.line(width), zorder=4 - depth / 100)
        for group in own["groups"].values() if one is best else ():
            for x, y, *_ in _lines(group, kind):
                axes.plot(x, y, color=one.colour, linewidth=0.7, alpha=0.75, zorder=3)


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

    def draw(figure: Figure) -> None:
        upper, lower = figure.subplots(2, sharex=True, height_ratios=(3, 1))
        upper.plot([0, 1], [0, 1], color=BASELINE, linewidth=1)
        for depth, one in enumerate(series):
            for bins in _lines(_of(curves, one)["mean"], "reliability"):
                look = {**one.line(1.1 if one.is_baseline else 1.8), "zorder": 4 - depth / 100}
                upper.plot(bins[0], bins[1], marker="" if one.is_baseline else ".", **look)
                if len(bins) > 2:
                    lower.plot(bins[0], np.where(bins[2] > 0, bins[2], np.nan), **look)
        upper.set(xlim=(-0.01, 1.01), ylim=(0, 1.01), ylabel="share of road")
        lower.set(yscale="log", xlabel="likelihood", ylabel="pixels")
        lower.yaxis.set_major_formatter(FuncFormatter(lambda y, _: f"{100 * y:g} %"))
        lower.yaxis.set_minor_formatter(FuncFormatter(lambda *_: ""))

    known = _has(series, curves, "reliability")
    return to_svg("reliability", "Reliability of the likelihoods", 440, draw) if known else ""


def risk_chart(series: Sequence[Series], curves: RunCurves) -> str:
    """The mean 1 - F of the most trusted pictures over how many are kept; dotted: the ideal."""

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        for depth, one in enumerate(series):
            mean = _of(curves, one)["mean"]
            for x, y, *_ in _lines(mean, "risk"):
                axes.plot(x, y, **one.line(2), zorder=4 - depth / 100)
                axes.plot([0, 1], [y[-1], y[-1]], color=one.colour, linewidth=0.7, alpha=0.75)
            for x, y, *_ in _lines(mean, "risk_ideal"):
                axes.plot(x, y, color=one.colour, linewidth=1.1, linestyle=":")
        axes.set(xlim=(0, 1), xlabel="pictures kept, the most trusted first", ylabel="mean 1 - F")
        axes.set_ylim(bottom=0)

    label = "Risk over coverage"
    return to_svg("risk", label, 320, draw) if _has(series, curves, "risk") else ""


# --- pictures ---------------------------------------------------------------------------


def distribution_chart(series: Sequence[Series], rows: Sequence[PictureRow]) -> str:
    """F of the single pictures by detector and group: a tick each, quartiles and deciles."""
    names = {one.name for one in series}
    values: dict[str, dict[str, list[float]]] = {}
    groups = sorted({row.group for row in rows})
    for row in rows:
        if row.detector in names and not math.isnan(row.f):
            group = row.group if len(groups) <= MAX_GROUPS else ""
            values.setdefault(row.detector, {}).setdefault(group, []).append(row.f)
    shown = [one for one in series if one.name in values]
    lanes = groups if 1 < len(groups) <= MAX_GROUPS else [""]

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        _name_rows(axes, shown)
        for row, one in enumerate(shown):
            for place, group in enumerate(sorted(values[one.name])):
                middle = row + (place + 0.5) / max(len(values[one.name]), 1) * 0.84 - 0.42
                _draw_lane(axes, middle, 0.3 / len(lanes), one, values[one.name][group])
                if len(lanes) > 1:
                    axes.annotate(short(group), (1, middle), (4, 0), fontsize=8, va="center",
                                  xycoords=("axes fraction", "data"), color=BASELINE,
                                  textcoords="offset points", annotation_clip=False)  # fmt: skip
        axes.set_xlim(right=1)
        axes.set_xlabel("F of a picture, at its group's threshold")

    height = 46 + len(shown) * max(26, 13 * len(lanes))
    return to_svg("pictures", "F of the single pictures", height, draw) if shown else ""


def _draw_lane(
    axes: Axes, middle: float, half: float, one: Series, values: Sequence[float]
) -> None:
    """Ticks for pictures, a line from the first to the last decile, a bar between quartiles."""
    every = np.sort(np.array(values))
    kept = every[np.unique(np.linspace(0, len(every) - 1, MAX_TICKS).round().astype(int))]
    x = np.repeat(kept, 3)
    y = np.tile([middle - half, middle + half, np.nan], len(kept))
    axes.plot(x, y, color=one.colour, linewidth=0.6, alpha=0.55, zorder=2)
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
