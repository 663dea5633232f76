"""ROC curves of a grid of detectors as a file of its own: a row of panels for each classifier."""

import re
from collections.abc import Mapping, Sequence
from functools import partial
from itertools import chain, product

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from roadtorch.evaluation.document import DetectorCurves, RunCurves
from roadtorch.report.svg import COLOURS, DASHES, GRID, INK, Series, to_svg

ROW = 190  # points, of the panels of one classifier

KEY = 60  # points, for the names of the lines

Halves = Mapping[str, Sequence[str]]
"""What is on the left and on the right: by title, the planes that have a line there."""

Lines = Mapping[tuple[str, str], np.ndarray]
"""FPR and TPR (2,points) by classifier and representation."""


def roc_families(curves: RunCurves, family: str, classifiers: Sequence[str], halves: Halves) -> str:
    """One row a classifier, one column a half, one line a representation; "" without curves.

    An SVG file for any viewer, its colours as they are, on white.
    Drawn are P3's averages over the pictures (``roc_vertical``), and of them the mean over
    groups. Names are ``family`` + ``classifier:planes``, with ``:paper`` where that ran.
    """
    lines = {}
    for name, planes in product(classifiers, chain.from_iterable(halves.values())):
        cell = f"{family}{name}:{planes}"
        line = mean_line(curves.get(f"{cell}:paper") or curves.get(cell))
        if line is not None:
            lines[name, planes] = line
    shown = [name for name in classifiers if any(key[0] == name for key in lines)]
    label = f"ROC curves of {', '.join(shown)}"
    height = KEY + ROW * len(shown)
    draw = partial(draw_families, lines=lines, classifiers=shown, halves=halves)
    if not shown:
        return ""
    plain = re.sub(r"var\(--\w+, (#[0-9a-f]{6})\)", r"\1", to_svg(label, label, height, draw))
    return plain.replace("<svg ", '<svg style="background:#fff" ', 1)


def draw_families(figure: Figure, lines: Lines, classifiers: Sequence[str], halves: Halves) -> None:
    """Draw the rows of panels and, below them, the names of the lines."""
    panels = figure.subplots(len(classifiers), len(halves), sharex=True, sharey=True, squeeze=False)
    for row, name in zip(panels, classifiers, strict=True):
        for axes, (title, planes) in zip(row, halves.items(), strict=True):
            own = [(one, lines.get((name, one.name))) for one in looks(planes)]
            _panel(axes, f"{name}, {title}", own)
    for axes, planes in zip(panels[-1], halves.values(), strict=True):
        axes.set_xlabel("false positive rate")
        handles = [axes.plot([], [], label=one.name, **one.line(1.4))[0] for one in looks(planes)]
        axes.legend(handles=handles, loc="upper center", bbox_to_anchor=(0.5, -0.28),
                    ncols=4, fontsize=8, handlelength=2.2, columnspacing=1)  # fmt: skip


def mean_line(own: DetectorCurves | None) -> np.ndarray | None:
    """FPR and TPR (2,points), averaged over groups at equal FPR; None where they are not known."""
    parts = [own["mean"], *own["groups"].values()] if own else []
    lines = [np.array(line) for part in parts if (line := part.get("roc_vertical"))]
    return np.mean(lines, axis=0) if lines else None


def looks(names: Sequence[str]) -> list[Series]:
    """A colour and a dash for each of up to 64 names; with eight or fewer each its own colour."""
    count = len(COLOURS)
    return [
        Series(name, COLOURS[place % count], DASHES[place // count])
        for place, name in enumerate(names)
    ]


def _panel(axes: Axes, title: str, lines: Sequence[tuple[Series, np.ndarray | None]]) -> None:
    axes.set_title(title, fontsize=9, color=INK)
    axes.plot([0, 1], [0, 1], color=GRID, linewidth=1)
    for one, line in lines:
        if line is not None:
            axes.plot(*line, **one.line(1.2))
    axes.set(xlim=(0, 1), ylim=(0, 1))
    axes.label_outer()
