"""The page at the end of an adaptation: before and after, on one page."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from markupsafe import Markup
from matplotlib.figure import Figure

from roadtorch.data.dataset import Dataset
from roadtorch.evaluation.disagreement import Disagreement, MeanChange, Taught
from roadtorch.evaluation.measure import Measure
from roadtorch.evaluation.methods import Method
from roadtorch.evaluation.result import Evaluation, Failure, Interval
from roadtorch.io.atomic import write_text
from roadtorch.report.disagreement import both_sheets
from roadtorch.report.page.svg import BASELINE, COLOURS, DASHES, to_svg
from roadtorch.report.page.tables import NONE, share, signed
from roadtorch.report.templates import template
from roadtorch.version import __version__


@dataclass(frozen=True)
class Adaptation:
    """What a run changed.

    methods: the detectors before and after; files: their weights. means, pictures: of those
    that were compared; shown: those on the page. taught: None for networks without a teacher's
    maps. rows: round, epoch and error of each epoch. labelled: None without labels.
    """

    dataset: Dataset
    methods: tuple[Method, Method]
    files: tuple[Path, Path]
    means: MeanChange
    pictures: Sequence[Disagreement]
    shown: Sequence[Disagreement]
    failures: Sequence[Failure]
    taught: Taught | None
    rows: Sequence[Mapping[str, Any]]
    labelled: Evaluation | None


class Line(NamedTuple):
    """A row of a table as text: what it is, before, after, the change, and notes below them."""

    what: str
    before: str
    after: str
    change: str
    notes: tuple[str, str, str] = ("", "", "")


def write_adaptation(path: Path, adaptation: Adaptation, command: str = "") -> None:
    """Write the page: one file that asks for no other."""
    items = [one.item for one in adaptation.shown]
    caption = "only before blue, only after orange"
    sheets = both_sheets(adaptation.dataset, adaptation.methods, items, caption)
    page = template("adaptation.html").render(
        one=adaptation,
        shown=list(zip(adaptation.shown, sheets, strict=True)),
        half=len(items) - len(items) // 2 if len(items) < len(adaptation.pictures) else len(items),
        summary=summary_lines(adaptation),
        scores=list(score_lines(adaptation.labelled)) if adaptation.labelled else [],
        charts=[Markup(svg) for svg in (error_chart(adaptation.rows), trust_chart(adaptation))],
        percent=_percent,
        share=share,
        version=__version__,
        command=command,
    )
    # A file name may hold bytes that are no text.
    write_text(path, page.encode("utf-8", "backslashreplace").decode())


def summary_lines(one: Adaptation) -> list[Line]:
    """What can be said without a label: road, trust and agreement before and after."""
    means = one.means
    lines = [_line("share of road", means.road_before, means.road_after)]
    if not math.isnan(means.trust_before):
        counts = ("", "", f"rose on {means.grown}, fell on {means.shrunk} pictures")
        before, after = means.trust_before, means.trust_after
        line = Line("trust", share(before), share(after), signed(after - before), counts)
        lines.append(line)
    if one.taught is not None:
        before, after = one.taught.before, one.taught.after
        lines.append(_line("agrees with the teacher on road", before.road, after.road))
        lines.append(_line("agrees with the teacher on layout", before.layout, after.layout))
    return lines


def _line(what: str, before: float, after: float) -> Line:
    change = NONE if math.isnan(before + after) else f"{100 * (after - before):+.1f} points"
    return Line(what, _percent(before), _percent(after), change.replace("-", "\N{MINUS SIGN}"))


def _percent(value: float) -> str:
    return NONE if math.isnan(value) else f"{100 * value:.1f} %"


def score_lines(evaluation: Evaluation) -> Iterator[Line]:
    """Measures of both on labels, with intervals, and the difference on the same pictures."""
    names = list(evaluation.detectors)
    differences = evaluation.comparison.differences[names[1]]
    for measure in evaluation.shown_in("pairs"):
        if measure.key not in differences:
            continue
        before, after = (_scored(evaluation, name, measure) for name in names)
        difference = differences[measure.key]
        note = _interval(difference.interval, signed)
        under = measure.key.rpartition("/")[0].replace("/", ", ")
        what = f"{under}, {measure.line}" if under else measure.line
        yield Line(what, before[0], after[0], signed(difference.value), (before[1], after[1], note))


def _scored(evaluation: Evaluation, name: str, measure: Measure) -> tuple[str, str]:
    figures = evaluation.detectors[name]
    interval = figures.intervals.get(measure.key, Interval())
    return share(measure.of(figures.headline)), _interval(interval, share)


def _interval(ends: Interval, text: Any) -> str:
    return f"{text(ends.low)} to {text(ends.high)}" if ends.is_known else ""


# --- charts ------------------------------------------------------------------------------


def error_chart(rows: Sequence[Mapping[str, Any]]) -> str:
    """The mean error of the epochs, one line a round, as SVG text."""

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        rounds = sorted({row["round"] for row in rows})
        for place, number in enumerate(rounds):
            own = [row for row in rows if row["round"] == number]
            look = place % len(COLOURS)
            axes.plot(
                [row["epoch"] for row in own],
                [row["loss"] for row in own],
                color=COLOURS[look],
                dashes=DASHES[look] or (None, None),
                marker=".",
                label=f"round {number}",
            )
        axes.set(xlabel="epoch", ylabel="mean error")
        if len(rounds) > 1:
            axes.legend()

    return to_svg("loss", "Mean loss of the epochs", 260, draw)


def trust_chart(one: Adaptation) -> str:
    """Trust after over trust before, a mark a picture, as SVG text; empty without trust."""
    pairs = [(each.first_trust, each.second_trust) for each in one.pictures if each.has_trust]
    if not pairs:
        return ""

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        axes.plot([0, 1], [0, 1], color=BASELINE, linewidth=1)
        before, after = zip(*pairs, strict=True)
        axes.plot(before, after, "o", color=COLOURS[0], mfc="none", markersize=5)
        low = max(0.0, min(*before, *after) - 0.05)
        axes.set(xlabel="trust before", ylabel="trust after", xlim=(low, 1), ylim=(low, 1))

    return to_svg("trust", "Trust of each picture before and after", 260, draw)
