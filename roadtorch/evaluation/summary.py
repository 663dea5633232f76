"""From counts to figures: of each drive, of all together, and what stands above them."""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

from torch import Tensor

from roadtorch.data.dataset import Item
from roadtorch.evaluation.contenders import Contender
from roadtorch.evaluation.measure import Figures, Measure
from roadtorch.evaluation.measures import MEASURES
from roadtorch.evaluation.parts import Part, counted, mean, taken_together
from roadtorch.evaluation.pictures import SHOWN, chosen_pictures
from roadtorch.evaluation.result import DetectorFigures
from roadtorch.evaluation.tally import WHOLE, Tally
from roadtorch.evaluation.thresholds import choose_thresholds, shared_threshold


def summarise(
    contender: Contender,
    tally: Tally,
    given: float | None = None,
    measures: Sequence[Measure] = MEASURES,
    left_out: Collection[str] = (),
) -> DetectorFigures:
    """All figures of one detector but its intervals.

    given: a threshold chosen elsewhere. left_out: drives that count in nothing but their own.
    """
    source, thresholds = choose_thresholds(tally.road, contender.threshold, given, left_out)
    counting = {group: one for group, one in thresholds.items() if group not in left_out}
    parts = {
        group: figures_of(replace(counted(tally, {group: one}), threshold=one), measures)
        for group, one in thresholds.items()
    }
    found = DetectorFigures(
        contender,
        parts.get(WHOLE, {}),
        thresholds=thresholds,
        threshold_from=source,
        best_threshold=shared_threshold({group: tally.road[group] for group in counting}),
        pictures_by_f=chosen_pictures(tally.kept(counting), thresholds, SHOWN),
    )
    if list(parts) == [WHOLE]:
        return found
    drives, pooled = {g: parts[g] for g in counting}, figures_of(counted(tally, counting), measures)
    return replace(
        found,
        headline=over_drives(drives, pooled, measures),
        drives=drives,
        left_out={group: figures for group, figures in parts.items() if group not in counting},
        pooled=pooled,
    )


def add_conditions(
    figures: DetectorFigures,
    tally: Tally,
    conditions: Mapping[str, Sequence[Item]],
    measures: Sequence[Measure] = MEASURES,
) -> DetectorFigures:
    """The same with the figures of each condition's pictures, whatever drives they are of."""
    seen = {name: tally.named({item.name for item in items}) for name, items in conditions.items()}
    found = {
        name: figures_of(taken_together(pictures, figures.thresholds), measures)
        for name, pictures in seen.items()
        if pictures.names
    }
    return replace(figures, conditions=found)


def figures_of(part: Part, measures: Sequence[Measure]) -> Figures:
    """The measures of a part, without those that it does not have."""
    values = {one.key: one.formula(part) for one in measures}
    return {
        key: value.item() if isinstance(value, Tensor) else value
        for key, value in values.items()
        if value is not None
    }


def over_drives(
    drives: Mapping[str, Figures], pooled: Figures, measures: Sequence[Measure]
) -> Figures:
    """What stands above the figures of the drives: means, or those of all pictures together."""
    found = {}
    for one in measures:
        if one.key in pooled and one.over_drives == "whole":
            found[one.key] = pooled[one.key]
        elif one.key in pooled and one.over_drives == "mean":
            found[one.key] = mean([drive.get(one.key, math.nan) for drive in drives.values()])
    return found
