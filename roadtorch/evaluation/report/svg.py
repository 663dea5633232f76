"""How every chart looks, and how a figure becomes SVG text inside a page.

Colours are those of Okabe and Ito, "Color Universal Design" (2008), and every detector has
a dash pattern too. In the text each colour is a variable (``var(--c1, #0072b2)``), so that
a page may darken or brighten it. The same figures give the same bytes: no dates, no files,
no scripts, no fonts.
"""

import io
import re
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from html import escape
from typing import Any

import matplotlib
from matplotlib.figure import Figure

from roadtorch.evaluation.result import Evaluation

MAX_SERIES = 8  # detectors in a chart, best first

MAX_BASELINES = 4

MAX_LETTERS = 34  # letters of a name in a chart

WIDTH = 460  # points, of one panel

COLOURS = (
    *("#0072b2", "#d55e00", "#009e73", "#cc79a7"),  # blue, vermillion, green, purple
    *("#e69f00", "#56b4e9", "#000000", "#f0e442"),  # orange, sky blue, black, yellow
)

BASELINE, GRID, BAND, INK, PAPER = "#7f7f7f", "#d9d9d9", "#efefef", "#1a1a1a", "#fefefe"

VARIABLES = {
    **{colour: f"var(--c{place}, {colour})" for place, colour in enumerate(COLOURS, 1)},
    BASELINE: f"var(--baseline, {BASELINE})",
    GRID: f"var(--grid, {GRID})",
    BAND: f"var(--band, {BAND})",
    INK: "currentColor",
    PAPER: f"var(--paper, {PAPER})",
}

DASHES = ((), (7, 2), (2, 1.5), (7, 2, 1.5, 2), (4, 2), (9, 2, 4, 2), (12, 3), (5, 1.5, 1, 1.5))

BASELINE_DASHES = ((3, 3), (1, 3), (6, 3, 1, 3), (9, 4))

STYLE: dict[str, Any] = {
    "font.family": "sans-serif",
    "font.sans-serif": "DejaVu Sans",
    "font.size": 11,
    "xtick.labelsize": 10,
    "axes.labelsize": 10,
    "text.parse_math": False,  # a $ in a name is a $
    "text.color": INK,
    "axes.labelcolor": INK,
    "axes.edgecolor": BASELINE,
    "axes.facecolor": "none",
    "axes.linewidth": 0.8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "axes.grid": True,
    "grid.color": GRID,
    "grid.linewidth": 0.7,
    "xtick.color": BASELINE,
    "ytick.color": BASELINE,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "figure.facecolor": "none",
    "legend.frameon": False,
    "lines.scale_dashes": False,
    "lines.dash_capstyle": "butt",
    "svg.fonttype": "none",
    "path.simplify_threshold": 0.15,
}

# --- what is drawn ----------------------------------------------------------------------


@dataclass(frozen=True)
class Series:
    """A detector as all charts show it."""

    name: str
    colour: str
    dash: tuple[float, ...]  # points, line and gap in turn; empty for a solid line
    is_baseline: bool = False

    def line(self, width: float) -> dict[str, Any]:
        """How Matplotlib draws it."""
        return {"color": self.colour, "linewidth": width, "dashes": self.dash or (None, None)}

    def variable(self) -> str:
        """The colour as a page names it."""
        return VARIABLES[self.colour]


def choose_series(evaluation: Evaluation) -> list[Series]:
    """The detectors that charts show, by rank: the eight best, and the four best baselines."""
    ranked, detectors = evaluation.ranked(), evaluation.detectors
    best = [name for name in ranked if not detectors[name].is_baseline][:MAX_SERIES]
    baselines = [name for name in ranked if detectors[name].is_baseline][:MAX_BASELINES]
    looks = dict(zip(best, zip(COLOURS, DASHES, strict=True), strict=False))
    series = [Series(name, *looks[name]) for name in best]
    series += [
        Series(name, BASELINE, dash, is_baseline=True)
        for name, dash in zip(baselines, BASELINE_DASHES, strict=False)
    ]
    return sorted(series, key=lambda detector: ranked.index(detector.name))


# --- to text ----------------------------------------------------------------------------


def short(name: Any) -> str:
    """A name that can stand in a chart: printable, and not too long."""
    text = "".join(letter if letter.isprintable() else "?" for letter in str(name))
    return text if len(text) <= MAX_LETTERS else f"{text[: MAX_LETTERS - 10]}…{text[-9:]}"


def to_svg(name: str, label: str, height: float, draw: Callable[[Figure], None]) -> str:
    """An SVG element of the panel's width and a height, in points, that ``draw`` fills."""
    file = io.StringIO()
    with matplotlib.rc_context(), warnings.catch_warnings():
        # Letters that the measuring font lacks: the reader's browser has its own fonts.
        warnings.filterwarnings("ignore", "Glyph .* missing from")
        matplotlib.rcdefaults()  # not what the user's matplotlibrc says
        settings: dict[Any, Any] = {**STYLE, "svg.hashsalt": name}
        matplotlib.rcParams.update(settings)
        figure = Figure(figsize=(WIDTH / 72, height / 72), layout="constrained")
        draw(figure)
        nothing = dict.fromkeys(("Date", "Creator", "Format", "Type"))
        figure.savefig(file, format="svg", metadata=nothing)
    return _inline(file.getvalue(), label, WIDTH, height)


def _inline(svg: str, label: str, width: float, height: float) -> str:
    """Matplotlib's file as an element: page-wide styles, names and long numbers taken out."""
    body = svg[svg.index("<svg") :].split(">", 1)[1]
    body = re.sub(r"<metadata>.*?</metadata>|<style.*?</style>|<!--.*?-->", "", body, flags=re.S)
    body = re.sub(r'<g id="[^"]*"', "<g", body)  # the same in every chart
    body = re.sub(
        r'(?<= )(?:d|x|y|transform)="[^"]*"', lambda m: re.sub(r"(\.\d\d)\d+", r"\1", m[0]), body
    )
    body = re.sub(r"(?<=: )#[0-9a-f]{6}", lambda m: VARIABLES.get(m[0], m[0]), body)
    body = re.sub(r"\n\s*", "\n", body)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink" '
        f'viewBox="0 0 {width:g} {height:g}" role="img" aria-label="{escape(label)}" '
        f'stroke-linejoin="round" stroke-linecap="butt">{body.strip()}'
    )
