"""P3, Figs. 5 and 6: how much of a picture is road, and groups by it."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from statistics import fmean, median
from typing import NamedTuple

import torch

from roadtorch.data.dataset import Dataset, Item, every_kth
from roadtorch.detectors.catalogue import load_detector
from scripts.figures.chart import chart, open_sets, tell
from scripts.figures.p3_table3 import measured

GROUPS = {"at most 30 %": 0.30, "30 to 45 %": 0.45, "45 to 55 %": 0.55, "more than 55 %": 1.0}
"""P3's groups of Fig. 6 by their upper bound, which belongs to the group."""

STEP = 5  # per cent of a histogram's bar
PICTURES = 60  # of a set, where detectors look at them
CELLS = (
    *("gaussian:RGB", "gaussian:HS", "robust_gaussian:RGB:paper"),
    *("mog2:HSV:paper", "nn:HSV"),
)
"""The cells whose AUC is told by group, as P3 has them."""


class Share(NamedTuple):
    """A picture and the share of it that is road."""

    item: Item
    road: float


# --- Fig. 5 -----------------------------------------------------------------------------


def road_share_of(dataset: Dataset) -> list[Share]:
    """The share of road among all pixels of each picture of a set, void ones too."""
    return [Share(item, float(dataset.truth(item).road.double().mean())) for item in dataset.items]


def group_of(share: float) -> str:
    """P3's group for a share of road."""
    return next(name for name, most in GROUPS.items() if share <= most)


def share_row(name: str, shares: Sequence[float]) -> dict[str, object]:
    """How many pictures a set has, what of them is road, and how many are in each group."""
    counts = {group: sum(group_of(one) == group for one in shares) for group in GROUPS}
    centre = {"mean": 100 * fmean(shares), "median": 100 * median(shares)}
    return {"set": name, "pictures": len(shares), **centre, **counts}


def fig5(data: Path, out: Path) -> None:
    """P3, Fig. 5: how many pictures have how much road, set by set."""
    sets = open_sets(data, "camvid", "idd-lite", "folder")
    found = {one.name: [share.road for share in road_share_of(one)] for one in sets}
    with chart(out / "p3-fig5.png", 6.4, 1.9) as figure:
        for panel, (name, shares) in zip(
            figure.subplots(1, len(found), sharex=True), found.items(), strict=True
        ):
            edges = range(0, 105, STEP)
            panel.hist([100 * one for one in shares], bins=list(edges), color="#0072b2")
            panel.axvline(100 * fmean(shares), color="#d55e00", linewidth=1)
            panel.set(title=f"{name}, {len(shares)} pictures", xlabel="% of the picture is road")
    rows = [share_row(name, shares) for name, shares in found.items()]
    tell(out / "p3-fig5.csv", tuple(rows[0]), rows)


# --- Fig. 6 -----------------------------------------------------------------------------


def by_group(shares: Sequence[Share]) -> dict[str, list[Item]]:
    """The items of P3's groups; groups without any are left out."""
    found: dict[str, list[Item]] = {}
    for share in sorted(shares, key=lambda one: one.road):
        found.setdefault(group_of(share.road), []).append(share.item)
    return found


def group_rows(
    dataset: Dataset, groups: Mapping[str, Sequence[Item]]
) -> Iterator[dict[str, object]]:
    """By group, the mean AUC of its pictures in percent for each of ``CELLS``."""
    detectors = {name: load_detector(f"oneclass:{name}") for name in CELLS}
    for name, items in groups.items():
        few = every_kth(replace(dataset, items=tuple(items)), PICTURES // len(groups))
        cells = measured(few, detectors)
        areas = {
            key: 100 * float(torch.cat([one.areas for one in drives.values()]).mean())
            for key, drives in cells.items()
        }
        sizes = {"pictures": len(items), "seen": len(few.items)}
        yield {"set": dataset.name, "group": name, **sizes, **areas}


def fig6(data: Path, out: Path) -> None:
    """P3, Fig. 6: AUC group by group, in P3's groups by the share of road."""
    rows: list[dict[str, object]] = []
    for dataset in open_sets(data, "camvid", "idd-lite"):
        groups = by_group(road_share_of(dataset))
        rows += group_rows(dataset, groups)
    tell(out / "p3-fig6.csv", tuple(rows[0]), rows)
