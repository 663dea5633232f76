"""Masks: the decision where road is, from the evidence that the analysis of an image gives."""

from collections.abc import Mapping
from typing import NamedTuple

from torch import Tensor

from roadtorch.detectors.detection import Cues
from roadtorch.detectors.entry import DetectorSettings
from roadtorch.imaging.levels import is_at_least
from roadtorch.road.ego import any_pixel, extrapolate_over_ego
from roadtorch.road.seed_area import remove_isolated, seed_rectangle
from roadtorch.road.temporal_filter import Motion


class Evidence(NamedTuple):
    """Result of an image's analysis, before smoothing over time and the decision on the mask.

    outputs: likelihood and cues at the working size. likelihood: float32 (H, W), 0 on the ego car.
    ego: bool (H, W), of settings and analysis; None if neither has one. cues: without these two.
    image: (3, H, W) in [0, 1]. motion: of a frame, for smoothing.
    """

    outputs: Mapping[str, Tensor]
    likelihood: Tensor
    ego: Tensor | None
    cues: Cues
    image: Tensor
    motion: Motion | None = None

    def cpu(self) -> "Evidence":
        """Return the evidence with its maps and the image on the CPU."""
        outputs, cues = (
            {name: map.cpu() for name, map in maps.items()}
            for maps in (self.outputs, self.cues.maps)
        )
        ego = None if self.ego is None else self.ego.cpu()
        cues = Cues(cues, self.cues.size)
        likelihood, image = self.likelihood.cpu(), self.image.cpu()
        return Evidence(outputs, likelihood, ego, cues, image, self.motion)


def decide_mask(
    likelihood: Tensor,
    settings: DetectorSettings,
    seed: Tensor | None = None,
    ego: Tensor | None = None,
) -> Tensor:
    """Return the mask, bool (H, W): likelihood ≥ threshold, isolated regions dropped if set.

    seed: seed area, bool (H, W); None: the rectangle of the settings. ego: ego car, bool (H, W).
    Road may touch the seed area by ground hidden under the ego car; if only hidden ground touches
    it, no region is dropped.
    """
    if ego is not None and not any_pixel(ego):
        ego = None
    extended = likelihood if ego is None else extrapolate_over_ego(likelihood, ego)
    mask = is_at_least(extended, settings.threshold)
    if settings.isolated == "drop":
        area = seed_rectangle(mask.shape, settings.seed_area) if seed is None else seed
        mask = remove_isolated(mask, area)
    if ego is None:
        return mask
    mask = mask & ~ego
    return mask if mask.any() else is_at_least(likelihood, settings.threshold) & ~ego
