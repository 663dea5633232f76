"""The table and the picture of ``sweep_topologies.py``."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import torch
from torch import Tensor

from roadtorch.evaluation import metrics
from roadtorch.io.atomic import atomic, csv_text, write_text
from roadtorch.layout.patch_network import PATCHES, Topology
from roadtorch.report.screen import align

SIZES = ((720, 960), (240, 320))
"""Height and width of P2's "1/1" and "1/3" resolution."""

LABELLER = "labeller"

P2_SECONDS = {
    "CNN-2": (4.83, 0.48),
    "CNN-7": (1.96, 0.21),
    "CNN-9": (3.56, 0.36),
    "CNN-11": (0.58, 0.06),
    "CNN-13": (22.2, 2.08),
    "CNN-14": (1.68, 0.17),
    LABELLER: (47.6, 6.49),
}
"""P2, Fig. 4a, seconds a picture at ``SIZES``; the labeller stands beside Hoiem et al. But for
CNN-7 its networks are not known, and ours of the same number are others."""


class Studied(NamedTuple):
    """One network: patches it saw, its mean error, confusions (4,4) by drive, seconds (2,)."""

    name: str
    topology: Topology
    patches: int
    error: float
    confusions: Mapping[str, Tensor]
    seconds: Tensor


class Accuracy(NamedTuple):
    """Mean class recall: pooled with void as vertical (P2's), with void ignored, mean of drives."""

    paper: float
    pooled: float
    drives: float


def accuracy(confusions: Mapping[str, Tensor]) -> Accuracy:
    """The accuracies of confusions (4,4) by drive."""
    each = torch.stack(list(confusions.values()))
    pooled = each.sum(0)
    return Accuracy(
        float(metrics.mean_class_recall(metrics.void_as_vertical(pooled))),
        float(metrics.mean_class_recall(pooled)),
        float(metrics.mean_class_recall(each).mean()),
    )


def described(topology: Topology) -> str:
    """Kernels, their sides, stages and connections in a few characters."""
    sides = f"{topology.size1}/{topology.size2}/{topology.size3}"
    seen = f", {topology.connections} of {topology.k1}" if topology.connections else ""
    return f"{topology.k1}+{topology.k2}, {sides}, ×{topology.subsamplings}{seen}"


def table(rows: Mapping[str, Studied], teacher: tuple[Mapping[str, Tensor], Tensor]) -> list[dict]:
    """A line for each topology, grey beside colour, and one for the labeller."""
    lines = []
    for name in sorted((n for n in rows if not n.endswith(" grey")), key=_number):
        one, other = rows[name], rows[f"{name} grey"]
        lines.append(
            {
                "name": name,
                "patch": one.topology.patch,
                "network": described(one.topology),
                "patches": one.patches,
                "error": f"{one.error:.4f}",
                **_figures(accuracy(one.confusions), one.seconds),
                "grey accuracy": f"{accuracy(other.confusions).paper:.3f}",
                "grey s at 320x240": f"{other.seconds[1]:.3f}",
                **_printed(name),
            }
        )
    blank = dict.fromkeys(lines[0], "") if lines else {}
    own = _figures(accuracy(teacher[0]), teacher[1])
    return [*lines, blank | {"name": LABELLER, **own, **_printed(LABELLER)}]


def _figures(found: Accuracy, seconds: Tensor) -> dict[str, str]:
    return {
        "accuracy": f"{found.paper:.3f}",
        "void ignored": f"{found.pooled:.3f}",
        "mean of drives": f"{found.drives:.3f}",
        "s at 960x720": f"{seconds[0]:.3f}",
        "s at 320x240": f"{seconds[1]:.3f}",
    }


def _printed(name: str) -> dict[str, str]:
    seconds = P2_SECONDS.get(name)
    return {"P2, s": f"{seconds[0]:g} / {seconds[1]:g}" if seconds else ""}


def _number(name: str) -> int:
    return int(name.removeprefix("CNN-"))


def markdown(lines: Sequence[Mapping[str, object]]) -> str:
    """Lines as a Markdown table."""
    rows = [list(lines[0]), *([str(cell) for cell in line.values()] for line in lines)]
    text = [f"| {' | '.join(row)} |" for row in rows]
    return "\n".join([text[0], "|---" * len(rows[0]) + "|", *text[1:]]) + "\n"


def write_table(
    rows: Mapping[str, Studied], teacher: tuple[Mapping[str, Tensor], Tensor], out: Path
) -> None:
    """Write topologies.csv, topologies.md and topologies.png, and print the table."""
    lines = table(rows, teacher)
    write_text(out / "topologies.csv", csv_text(list(lines[0]), lines))
    write_text(out / "topologies.md", markdown(lines))
    draw(list(rows.values()), accuracy(teacher[0]).paper, out / "topologies.png")
    print(align([list(lines[0]), *([str(cell) for cell in line.values()] for line in lines)]))


def best_of_patches(rows: Sequence[Studied]) -> Iterator[Studied]:
    """The most accurate colour network of each patch size."""
    for patch in PATCHES:
        own = [one for one in rows if one.topology.patch == patch and _in_colour(one)]
        if own:
            yield max(own, key=lambda one: accuracy(one.confusions).paper)


def _in_colour(one: Studied) -> bool:
    return one.topology.input == "colour"


def draw(rows: Sequence[Studied], labeller: float, path: Path) -> None:
    """P2, Fig. 3, as accuracy over time: a panel for each patch size, and the best of each."""
    from matplotlib.figure import Figure
    from matplotlib.ticker import NullFormatter

    figure = Figure(figsize=(11, 7.5), layout="constrained")
    grid = figure.subplots(2, 2, sharex=True, sharey=True)
    panels = {f"{n}×{n}": [one for one in rows if one.topology.patch == n] for n in PATCHES}
    panels["the best of each size, in colour"] = list(best_of_patches(rows))
    for axes, (title, own) in zip(grid.flat, panels.items(), strict=True):
        axes.axhline(labeller, color="grey", linestyle=":", label=LABELLER)
        for colour in (True, False):
            some = [one for one in own if _in_colour(one) == colour]
            places = [float(one.seconds[1]) for one in some]
            values = [accuracy(one.confusions).paper for one in some]
            style = {"color": "#d55e00"} if colour else {"color": "#444444", "mfc": "none"}
            axes.plot(places, values, "o", label="colour" if colour else "grey", **style)
        for one in filter(_in_colour, own):
            at = (float(one.seconds[1]), accuracy(one.confusions).paper)
            axes.annotate(one.name, at, (4, 4), textcoords="offset points", fontsize=8)
        axes.set(title=title, xscale="log")
        axes.xaxis.set_major_formatter("{x:g}")
        axes.xaxis.set_minor_formatter(NullFormatter())
        axes.grid(alpha=0.3)
    figure.supxlabel("seconds a picture of 320×240, one core")
    figure.supylabel("global average accuracy on CamVid's training split")
    grid[0, 0].legend()
    with atomic(path) as temporary:
        figure.savefig(temporary, format="png", dpi=120)
