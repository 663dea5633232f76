"""A measure: a formula over counts, with its key, name, meaning, direction and tables."""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Literal

from torch import Tensor

from roadtorch.evaluation.tally import PooledCounts

UNDEFINED = "–"  # text of an undefined value, such as recall without road

Scores = Mapping[str, float]
"""Values by the key of their measure: NaN where undefined, missing where it does not apply."""

Formula = Callable[[PooledCounts], Tensor | float | None]
"""Counts → their value, or (replicates,) of a bootstrap; None where it does not apply."""

TableName = Literal["headline", "scores", "parts", "trust", "layout", "pairs", "compared"]
"""Tables with a column for a measure: first columns of the score table, its other columns, groups
and conditions, trust, layout, differences. ``compared``: the difference is in metrics.json."""


@dataclass(frozen=True)
class Measure:
    """A measure of how good a detector is.

    Attributes:
        key: name in metrics.json, with "/" between levels.
        name: header of the column.
        meaning: one sentence for the reader of a report.
        formula: counts → value.
        better: which of two values is better; None where neither is.
        digits: decimals in tables.
        aggregate: the value for all groups: mean of the groups, value of the whole set, or nothing.
        interval: whether bootstrap replicates are computed; the formula may then use only the
            counts that replicates have.
        tables: tables with a column of the measure.
    """

    key: str
    name: str
    meaning: str
    formula: Formula
    better: Literal["higher", "lower"] | None = "higher"
    digits: int = 3
    aggregate: Literal["mean", "whole", "nothing"] = "mean"
    interval: bool = False
    tables: tuple[TableName, ...] = ()

    def get(self, scores: Scores) -> float:
        """Return this measure's value among scores; NaN where it is undefined or missing."""
        return scores.get(self.key, math.nan)

    def get_defined(self, scores_by_name: Mapping[str, Scores]) -> dict[str, float]:
        """Return the defined values by name."""
        values = {name: self.get(scores) for name, scores in scores_by_name.items()}
        return {name: value for name, value in values.items() if not math.isnan(value)}

    def best(self, values: Iterable[float]) -> float | None:
        """Return the best of several values; None without any, and where neither is better."""
        defined = [value for value in values if not math.isnan(value)]
        if not defined or self.better is None:
            return None
        return max(defined) if self.better == "higher" else min(defined)

    def format(self, value: float) -> str:
        """Return a value as text; ``UNDEFINED`` for NaN."""
        return UNDEFINED if math.isnan(value) else f"{value:.{self.digits}f}"
