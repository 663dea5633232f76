"""Differences between the masks of two methods: before and after further training."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from torch import Tensor

from roadtorch.data.dataset import Dataset, LabelledItem
from roadtorch.detectors.detection import Detection
from roadtorch.evaluation.methods import Contender
from roadtorch.evaluation.result import Failure
from roadtorch.evaluation.scoring import run_contenders


@dataclass(frozen=True)
class Disagreement:
    """Masks of two detectors on one image."""

    item: LabelledItem
    difference: float  # fraction of the pixels on which they differ
    first_road: float  # fraction of the pixels
    second_road: float
    first_trust: float  # NaN where the detector gives none
    second_trust: float

    @property
    def has_trust(self) -> bool:
        """Return whether both detectors give a trust."""
        return not math.isnan(self.first_trust + self.second_trust)


@dataclass(frozen=True)
class Disagreements:
    """Masks of two methods on a set; images: the largest difference first, then by name."""

    dataset: Dataset
    methods: tuple[Contender, Contender]
    images: Sequence[Disagreement]
    failures: Sequence[Failure]


def compare_masks(
    dataset: Dataset, methods: tuple[Contender, Contender], quiet: bool = False, **progress: str
) -> Disagreements:
    """Compare the masks of two methods on every image, each at its own threshold."""
    images, failures = list[Disagreement](), list[Failure]()
    for item, sides in run_contenders(dataset, methods, _take_mask, None, quiet, **progress):
        if isinstance(sides, Failure):
            failures.append(sides)
            continue
        (first, trust), (second, second_trust) = sides.values()
        difference, road, second_road = (
            float(part.double().mean()) for part in (first ^ second, first, second)
        )
        images.append(Disagreement(item, difference, road, second_road, trust, second_trust))
    images.sort(key=lambda pair: (-pair.difference, pair.item.name))
    return Disagreements(dataset, methods, images, failures)


def _take_mask(detection: Detection, *_: object) -> tuple[Tensor, float]:
    return detection.mask, math.nan if detection.trust is None else detection.trust


# --- effect of further training: first is before, second is after -------------------------


def select_changed(ranked: Sequence[Disagreement], count: int) -> list[Disagreement]:
    """Select images to show: half have the largest difference, the others are evenly spread.

    ranked: the largest difference first. The spread covers the remaining ones, down to the smallest
    difference. All are selected where there are no more than ``count``.
    """
    if len(ranked) <= count:
        return list(ranked)
    steps = count // 2
    largest, remaining = ranked[: count - steps], ranked[count - steps :]
    indices = ((step + 1) * len(remaining) // steps - 1 for step in range(steps))
    return [*largest, *(remaining[i] for i in indices)]
