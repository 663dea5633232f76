"""What a measure is: a formula over counts, with a name, words, a direction, and its tables."""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Literal

from torch import Tensor

from roadtorch.evaluation.tally import Part

Figures = Mapping[str, float]
"""Numbers by the key of their measure: NaN where undefined, without those that are not there."""

Formula = Callable[[Part], Tensor | float | None]
"""A part's figure, or (draws,) of one that is many draws; None where it has no such figure."""

Place = Literal["headline", "scores", "parts", "trust", "layout", "pairs", "compared"]
"""Tables: the first columns of the scores and the others, groups and conditions of one detector,
trust, layout, differences between detectors. ``compared``: the difference is in metrics.json."""


@dataclass(frozen=True)
class Measure:
    """A number that says how good a detector is.

    key: its name in metrics.json, with "/" between levels. name: at the head of a column.
    meaning: a sentence for who has to read it.
    better: which of two values is; None where neither is. digits: decimals that are shown.
    over_groups: what stands above the figures of the groups: their mean, the figure of all
    images together, or nothing.
    interval: whether it is taken of images drawn anew, too; then the formula needs no field
    of the part that draws do not have. shown: the tables that have it as a column.
    """

    key: str
    name: str
    meaning: str
    formula: Formula
    better: Literal["higher", "lower"] | None = "higher"
    digits: int = 3
    over_groups: Literal["mean", "whole", "nothing"] = "mean"
    interval: bool = False
    shown: tuple[Place, ...] = ()

    def of(self, figures: Figures) -> float:
        """The number among a part's figures; NaN where it is undefined or not there."""
        return figures.get(self.key, math.nan)

    def known(self, parts: Mapping[str, Figures]) -> dict[str, float]:
        """The numbers by part, of the parts in which it is defined."""
        values = {name: self.of(figures) for name, figures in parts.items()}
        return {name: value for name, value in values.items() if not math.isnan(value)}

    def best(self, values: Iterable[float]) -> float | None:
        """Return the best of several values; None without any, and where none is better."""
        known = [value for value in values if not math.isnan(value)]
        if not known or self.better is None:
            return None
        return max(known) if self.better == "higher" else min(known)

    def text(self, value: float, nothing: str) -> str:
        """A value as it is shown."""
        return nothing if math.isnan(value) else f"{value:.{self.digits}f}"
