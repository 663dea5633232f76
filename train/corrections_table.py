"""The tables and the figure of ``study_corrections.py``."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from torch import Tensor

from roadtorch.evaluation import metrics
from roadtorch.evaluation.metrics import Decisions
from roadtorch.report.page.svg import COLOURS, PAPER, to_svg

REPLICATES = 2000

Runs = Sequence[dict[str, Any]]

RANDOM = "random"


def pooled_f(counts: Tensor) -> Tensor:
    """F (b,) of pictures' true and false positives and false negatives (b,n,3) together."""
    hit, false, missed = counts.sum(1).unbind(-1)
    return metrics.f_measure(Decisions(hit, false, missed, torch.zeros_like(hit)))


def cells_of(runs: Runs) -> dict[tuple[str, str, int], list[dict[str, Any]]]:
    """The runs by curve (with its label), rule and number; rule "" for none corrected."""
    cells: dict[tuple[str, str, int], list[dict[str, Any]]] = defaultdict(list)
    for one in runs:
        about = " ".join(filter(None, (one["curve"], one["label"])))
        cells[about, one["rule"] if one["n"] else "", one["n"]].append(one)
    return dict(sorted(cells.items(), key=lambda cell: (cell[0][0], cell[0][2], cell[0][1])))


def table(runs: Runs) -> str:
    """A row for every curve, rule and number: means over draws, gains in F and what rules add.

    The intervals (95 %) draw draws and test pictures anew, the same pictures on both sides.
    """
    cells = cells_of(runs)
    lines = ["| pictures | rule | n | draws | MaxF | road head | F | gain in F | against random |"]
    lines.append("|---|---|---|---|---|---|---|---|---|")
    for (about, rule, count), own in cells.items():
        shown = " | ".join(
            f"{np.mean([one[name] for one in own]):.3f}" for name in ("maxf", "head", "f")
        )
        before, chance = cells.get((about, "", 0)), cells.get((about, RANDOM, count))
        gain = told_gain(before, own) if before and count else ""
        against = told_gain(chance, own) if chance and rule not in ("", RANDOM) else ""
        lines.append(f"| {about} | {rule} | {count} | {len(own)} | {shown} | {gain} | {against} |")
    return "\n".join(lines)


def told_gain(before: Runs, after: Runs) -> str:
    """What F gains from some runs to others, with its interval."""
    value = np.mean([one["f"] for one in after]) - np.mean([one["f"] for one in before])
    low, high = gain_interval(before, after)
    return f"{value:+.3f} ({low:+.3f} to {high:+.3f})"


def gain_interval(before: Runs, after: Runs) -> tuple[float, float]:
    """Between which the gain in mean F lies (95 %): a nested bootstrap, draws in pictures.

    With one draw on a side, what the draw adds there is not in it.
    """
    generator = torch.Generator().manual_seed(0)
    pictures = len(before[0]["counts"])
    drawn = torch.randint(pictures, (REPLICATES, pictures), generator=generator)
    means = []
    for side in (before, after):
        counts = torch.tensor([one["counts"] for one in side], dtype=torch.float64)
        which = torch.randint(len(counts), (REPLICATES, len(counts)), generator=generator)
        f = torch.stack([pooled_f(run[drawn]) for run in counts], 1)
        means.append(f.gather(1, which).mean(1))
    bounds = torch.tensor([0.025, 0.975], dtype=torch.float64)
    low, high = (means[1] - means[0]).quantile(bounds).tolist()
    return low, high


# --- the figure -------------------------------------------------------------------------


def draw_curves(runs: Runs) -> str:
    """SVG: F over the number of random corrected pictures, a line a curve, a dot a draw."""
    lines: dict[str, dict[int, list[float]]] = defaultdict(dict)
    for (about, rule, count), own in cells_of(runs).items():
        if rule in ("", RANDOM):
            lines[about][count] = [one["f"] for one in own]

    def draw(figure: Figure) -> None:
        figure.set_facecolor(PAPER)  # it stands by itself
        axes = figure.subplots()
        for place, (about, line) in enumerate(lines.items()):
            _draw_line(axes, about, line, COLOURS[place % len(COLOURS)])
        counts = sorted({count for line in lines.values() for count in line})
        axes.set_xticks([np.sqrt(count) for count in counts], [str(count) for count in counts])
        axes.set(xlabel="corrected pictures, chosen at random", ylabel="F at 0.5")
        axes.legend(fontsize=9, ncols=2)

    return to_svg("corrections", "F over the number of corrected pictures", 300, draw)


def _draw_line(axes: Axes, about: str, line: Mapping[int, Sequence[float]], colour: str) -> None:
    """Means joined, draws as dots; the number on a scale of square roots."""
    counts = sorted(line)
    at = [np.sqrt(count) for count in counts]
    axes.plot(at, [np.mean(line[count]) for count in counts], color=colour, label=about)
    for place, count in zip(at, counts, strict=True):
        axes.plot([place] * len(line[count]), line[count], ".", color=colour, markersize=5)
