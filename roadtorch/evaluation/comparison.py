"""How sure the figures are: pictures drawn anew, intervals, and detectors compared in pairs.

All detectors of a run are scored on the same pictures, and all are resampled with the same
draws, so that a difference between two is not blurred by what pictures they had.
"""

from collections.abc import Mapping, Sequence

import torch
from torch import Tensor

from roadtorch.errors import unknown_name
from roadtorch.evaluation import uncertainty
from roadtorch.evaluation.measure import Measure
from roadtorch.evaluation.measures import MAXF, MEASURES
from roadtorch.evaluation.parts import drawn
from roadtorch.evaluation.result import Comparison, DetectorFigures, Difference
from roadtorch.evaluation.tally import Pictures, Tally
from roadtorch.evaluation.uncertainty import Interval, Replicated, group_weights

SEED = 11  # of the draws

Draws = Mapping[str, Replicated]
"""Figures of all pictures and of every draw of them, by the key of the measure."""


def resample(
    tally: Tally, figures: DetectorFigures, measures: Sequence[Measure] = MEASURES
) -> Draws:
    """Draw pictures inside their drives anew, and take the headline figures of each draw.

    Thresholds stay as they were chosen. The draws, which are counted on 8-bit maps, are
    moved by what that changes in the figure of all pictures.
    """
    drives = [tally.kept([group]) for group in figures.counting]
    thresholds = [figures.thresholds[group] for group in figures.counting]
    generator = torch.Generator().manual_seed(SEED)
    weights = group_weights([len(drive.names) for drive in drives], generator)
    once = [torch.ones_like(drawing[:1]) for drawing in weights]
    kept = [one for one in measures if one.interval and one.key in figures.headline]
    coarse, draws = (_mean_over_drives(drives, thresholds, each, kept) for each in (once, weights))
    values = {one.key: one.of(figures.headline) for one in kept}
    return {
        key: Replicated(value, draws[key] + (value - float(coarse[key])))
        for key, value in values.items()
    }


def _mean_over_drives(
    drives: Sequence[Pictures],
    thresholds: Sequence[float],
    weights: Sequence[Tensor],
    measures: Sequence[Measure],
) -> dict[str, Tensor]:
    """The figures (draws,) by key, of the pictures of each drive as often as weights say."""
    found: dict[str, list[Tensor]] = {one.key: [] for one in measures}
    for drive, threshold, drawing in zip(drives, thresholds, weights, strict=True):
        part = drawn(drive, threshold, drawing)
        for one in measures:
            values = one.formula(part)
            if not isinstance(values, Tensor):
                raise TypeError(f"the formula of {one.key} needs what draws do not have")
            found[one.key].append(values)
    return {key: torch.stack(values).nanmean(0) for key, values in found.items()}


def intervals(draws: Draws) -> dict[str, Interval]:
    """95 % intervals of the headline figures, inside [0,1]."""
    found = {key: uncertainty.interval(figure) for key, figure in draws.items()}
    return {key: Interval(max(low, 0.0), min(high, 1.0)) for key, (low, high) in found.items()}


# --- pairs ------------------------------------------------------------------------------


def check_against(names: Sequence[str], against: str | None) -> None:
    """ConfigError when the detector that the others are to be compared with is not in the run."""
    if against is not None and against not in names:
        raise unknown_name("detector of this run", against, names)


def best_of(detectors: Mapping[str, DetectorFigures]) -> str:
    """The detector with the highest MaxF, the first of equals."""
    scores = {name: MAXF.of(one.headline) for name, one in detectors.items()}
    best = MAXF.best(scores.values())
    return next((name for name, value in scores.items() if value == best), next(iter(scores)))


def compare(
    draws: Mapping[str, Draws], against: str, measures: Sequence[Measure] = MEASURES
) -> Comparison:
    """Every detector less the one called ``against``, in the measures that both have."""
    other = draws[against]
    keys = [one.key for one in measures if "pairs" in one.shown]
    return Comparison(
        against,
        {
            name: {
                key: _difference(one[key], other[key])
                for key in keys
                if key in one and key in other
            }
            for name, one in draws.items()
            if name != against
        },
    )


def _difference(one: Replicated, other: Replicated) -> Difference:
    found = uncertainty.difference(one, other)
    return Difference(found.value, uncertainty.interval(found))
