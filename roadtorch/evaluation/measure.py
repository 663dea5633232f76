"""What a measure is: a formula with a name, words, a direction, and the tables it stands in."""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Literal

from torch import Tensor

from roadtorch.evaluation.parts import Part

Figures = Mapping[str, float]
"""Numbers by the key of their measure: NaN where undefined, without those that are not there."""

Formula = Callable[[Part], Tensor | float | None]
"""A part's figure, or (draws,) of one that is many draws; None where it has no such figure."""

Place = Literal[
    "headline",
    "screen",
    "screen pairs",
    "screen layout",
    "scores",
    "further",
    "pairs",
    "parts",
    "trust",
    "layout",
]
"""First in every table; on the screen; on the page: its first table, its second one,
differences; drives and conditions of one detector, trust (both on the screen as well); layout.

``pairs`` are in metrics.json, too."""


@dataclass(frozen=True)
class Measure:
    """A number that says how good a detector is.

    key: its name in metrics.json, with "/" between levels. name: at the head of a column, where
    line breaks are allowed. meaning: a sentence for who has to read it.
    better: which of two values is; None where neither is. digits: decimals that are shown.
    over_drives: what stands above the figures of the drives: their mean, the figure of all
    pictures together, or nothing.
    interval: whether it is taken of pictures drawn anew, too; then the formula needs no field
    of the part that draws do not have. shown: the tables that have it as a column.
    """

    key: str
    name: str
    meaning: str
    formula: Formula
    better: Literal["higher", "lower"] | None = "higher"
    digits: int = 3
    over_drives: Literal["mean", "whole", "nothing"] = "mean"
    interval: bool = False
    shown: tuple[Place, ...] = ()

    @property
    def line(self) -> str:
        """The name on one line."""
        return self.name.replace("\n/", "/").replace("\n", " ")

    @property
    def flat_key(self) -> str:
        """The key where metrics.json has no levels: among intervals and differences."""
        return self.key.replace("/", "_")

    def of(self, figures: Figures) -> float:
        """The number among a part's figures; NaN where it is undefined or not there."""
        return figures.get(self.key, math.nan)

    def best(self, values: Iterable[float]) -> float | None:
        """The best of several values; None without any, and where none is better."""
        known = [value for value in values if not math.isnan(value)]
        if not known or self.better is None:
            return None
        return max(known) if self.better == "higher" else min(known)

    def text(self, value: float, nothing: str) -> str:
        """A value as it is shown."""
        return nothing if math.isnan(value) else f"{value:.{self.digits}f}"
