"""Charts of an evaluation: ROC, reliability, and F by group, each as an SVG image inside a page.

Colours are those of Okabe and Ito, "Color Universal Design" (2008), and every detector's line has
a dash pattern too. The same scores give the same bytes: no dates, no embedded fonts.
"""

import base64
import io
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib
import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from roadtorch.evaluation import curves
from roadtorch.evaluation.curves import Curve
from roadtorch.evaluation.measures import F_MASK
from roadtorch.evaluation.metrics import RoadCounts
from roadtorch.evaluation.report.table import shorten
from roadtorch.evaluation.result import Evaluation

MAX_SERIES = 8  # detectors in a chart, best first
MAX_BASELINES = 4
MAX_LABEL_LENGTH = 34  # letters of a name in a chart
PANEL_WIDTH = 460  # points, of one panel
CHART_FPR_STEPS = 200  # intervals of the false positive rate, in the mean over groups

COLOURS = (
    *("#0072b2", "#d55e00", "#009e73", "#cc79a7"),  # blue, vermillion, green, purple
    *("#e69f00", "#56b4e9", "#000000", "#f0e442"),  # orange, sky blue, black, yellow
)

GREY, GRID_COLOUR, INK = "#7f7f7f", "#d9d9d9", "#1a1a1a"

DASHES = ((), (7, 2), (2, 1.5), (7, 2, 1.5, 2), (4, 2), (9, 2, 4, 2), (12, 3), (5, 1.5, 1, 1.5))
BASELINE_DASHES = ((3, 3), (1, 3), (6, 3, 1, 3), (9, 4))

STYLE: dict[Any, Any] = {
    "font.family": "sans-serif",
    "font.sans-serif": "DejaVu Sans",
    "font.size": 11,
    "xtick.labelsize": 10,
    "axes.labelsize": 10,
    "legend.fontsize": 9,
    "text.parse_math": False,  # a $ in a name is a $
    "text.color": INK,
    "axes.labelcolor": INK,
    "axes.edgecolor": GREY,
    "axes.linewidth": 0.8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "axes.grid": True,
    "grid.color": GRID_COLOUR,
    "grid.linewidth": 0.7,
    "xtick.color": GREY,
    "ytick.color": GREY,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "legend.frameon": False,
    "lines.scale_dashes": False,
    "lines.dash_capstyle": "butt",
    "svg.fonttype": "none",
    "svg.hashsalt": "roadtorch",
}

# --- charts -----------------------------------------------------------------------------


@dataclass(frozen=True)
class Series:
    """A detector's name and line style, the same in all charts."""

    name: str
    colour: str
    dash: tuple[float, ...]  # points, line and gap in turn; empty for a solid line
    is_baseline: bool = False

    def line(self, width: float) -> dict[str, Any]:
        """Return the line style as Matplotlib's keywords."""
        return {"color": self.colour, "linewidth": width, "dashes": self.dash or (None, None)}


def choose_series(evaluation: Evaluation) -> list[Series]:
    """Return the detectors in charts, by rank: the eight best, the four best baselines."""
    ranked, detectors = evaluation.ranking(), evaluation.detectors
    best = [name for name in ranked if not detectors[name].is_baseline][:MAX_SERIES]
    baselines = [name for name in ranked if detectors[name].is_baseline][:MAX_BASELINES]
    series = [Series(*style) for style in zip(best, COLOURS, DASHES, strict=False)]
    series += [
        Series(name, GREY, dash, is_baseline=True)
        for name, dash in zip(baselines, BASELINE_DASHES, strict=False)
    ]
    return sorted(series, key=lambda detector: ranked.index(detector.name))


def build_charts(evaluation: Evaluation) -> Mapping[str, str]:
    """Return the charts of an evaluation by title, as ``svg_uri`` gives them."""
    series = choose_series(evaluation)
    charts = {
        "ROC": svg_uri(2 * PANEL_WIDTH, 420, lambda figure: draw_roc(figure, series, evaluation)),
        "Reliability": svg_uri(
            PANEL_WIDTH, 420, lambda figure: draw_reliability(figure, series, evaluation)
        ),
    }
    if groups := evaluation.groups:
        height = 120 + 18 * len(groups)
        charts["F by group"] = svg_uri(
            PANEL_WIDTH, height, lambda figure: draw_groups(figure, series, evaluation)
        )
    return charts


def group_counts(evaluation: Evaluation, name: str) -> list[RoadCounts]:
    """Return the pixels by level of each group that counts, of one detector."""
    roads = evaluation.tallies[name].road
    return [roads[group] for group in evaluation.detectors[name].counted_groups]


def mean_roc(groups: Sequence[RoadCounts]) -> Curve:
    """Return the vertical average of the groups' pooled curves: each group weighs the same."""
    rates = torch.stack([curves.vertical_sample(counts, CHART_FPR_STEPS) for counts in groups])
    return curves.vertical_average(rates.nanmean(0))


def draw_roc(figure: Figure, series: Sequence[Series], evaluation: Evaluation) -> None:
    """Draw mean ROC curves, thin ones of the best detector's groups, and their low-FPR corner."""
    best = next((detector for detector in series if not detector.is_baseline), None)
    whole, corner = figure.subplots(1, 2)
    for axes in (whole, corner):
        axes.plot([0, 1], [0, 1], color=GRID_COLOUR, linewidth=1)
        for depth, detector in enumerate(series):
            counts = group_counts(evaluation, detector.name)
            _draw_curve(axes, mean_roc(counts), detector, depth)
            for group in counts if detector is best and len(counts) > 1 else ():
                curve = mean_roc([group])
                axes.plot(curve.x, curve.y, color=detector.colour, linewidth=0.7, alpha=0.75)
        axes.set(xlabel="false positive rate", ylabel="true positive rate (recall)")
    whole.set(xlim=(0, 1), ylim=(0, 1))
    corner.set(xlim=(0, 0.2), ylim=(0.8, 1))
    figure.legend(*whole.get_legend_handles_labels(), loc="outside lower center", ncols=4)


def draw_reliability(figure: Figure, series: Sequence[Series], evaluation: Evaluation) -> None:
    """Draw the fraction of road by likelihood; below, the fraction of pixels."""
    upper, lower = figure.subplots(2, sharex=True, height_ratios=(3, 1))
    upper.plot([0, 1], [0, 1], color=GRID_COLOUR, linewidth=1)
    for depth, detector in enumerate(series):
        groups = [curves.reliability(part) for part in group_counts(evaluation, detector.name)]
        predicted, observed, fraction = (
            torch.stack([getattr(group, key) for group in groups]).nanmean(0)
            for key in ("predicted", "observed", "fraction")
        )
        _draw_curve(upper, Curve(predicted, observed), detector, depth)
        _draw_curve(lower, Curve(predicted, fraction), detector, depth)
    upper.set(xlim=(-0.01, 1.01), ylim=(0, 1.01), ylabel="fraction of road")
    lower.set(yscale="log", xlabel="likelihood", ylabel="pixels")
    lower.yaxis.set_major_formatter(FuncFormatter(lambda y, _: f"{100 * y:g} %"))
    lower.yaxis.set_minor_formatter(FuncFormatter(lambda *_: ""))


def draw_groups(figure: Figure, series: Sequence[Series], evaluation: Evaluation) -> None:
    """Draw F of the mask of every group, the lowest of the best detector on top."""
    detectors, axes = evaluation.detectors, figure.subplots()
    first = F_MASK.get_defined(detectors[series[0].name].groups)
    groups = sorted(evaluation.groups, key=lambda group: first.get(group, 1.0))
    for depth, detector in enumerate(series):
        values = [F_MASK.get(detectors[detector.name].group(group)) for group in groups]
        face = "none" if detector.is_baseline else detector.colour
        axes.plot(values, range(len(groups)), "o", color=detector.colour, mfc=face,
                  label=_label(detector.name), zorder=4 - depth / 100)  # fmt: skip
    axes.set_yticks(range(len(groups)), [_label(group) for group in groups])
    axes.set_ylim(len(groups) - 0.5, -0.5)
    axes.set_xlabel("F of the mask at the default threshold")
    figure.legend(loc="outside lower center", ncols=2)


def _draw_curve(axes: Axes, curve: Curve, detector: Series, depth: int) -> None:
    """Draw a curve; better detectors are drawn over others."""
    style = detector.line(1.2 if detector.is_baseline else 2)
    axes.plot(curve.x, curve.y, **style, label=_label(detector.name), zorder=4 - depth / 100)


# --- as an image inside a page ----------------------------------------------------------


def _label(name: str) -> str:
    return shorten(name, MAX_LABEL_LENGTH)


def svg_uri(width: float, height: float, draw: Callable[[Figure], None]) -> str:
    """Return a figure of width × height points, drawn by ``draw``, as the data URI of an SVG."""
    file = io.StringIO()
    with matplotlib.rc_context(), warnings.catch_warnings():
        # Letters that the measuring font lacks: the reader's browser has its own fonts.
        warnings.filterwarnings("ignore", "Glyph .* missing from")
        matplotlib.rcdefaults()  # ignore the user's matplotlibrc
        matplotlib.rcParams.update(STYLE)
        figure = Figure(figsize=(width / 72, height / 72), layout="constrained")
        draw(figure)
        nothing = dict.fromkeys(("Date", "Creator", "Format", "Type"))
        figure.savefig(file, format="svg", metadata=nothing)
    return f"data:image/svg+xml;base64,{base64.b64encode(file.getvalue().encode()).decode()}"
