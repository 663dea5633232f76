"""A lens in front of a detector, which sees rectified views of the images. Ours."""

from collections.abc import Mapping

import torch
from torch import Tensor, nn

from roadtorch.camera.views import merge_views, rectified_views, sample_view, view_itself
from roadtorch.detectors.detector import Detector
from roadtorch.detectors.entry import WorkingSettings
from roadtorch.imaging.levels import is_above, is_at_least
from roadtorch.imaging.resize import resize_to_image, spatial_size, working_size

MIN_TRUST = 0.01
"""Least weight of a view, whose trust may be 0."""

IMAGE_WEIGHT = 1.5
"""Weight of the image beside its views: two or three show a pixel, and are no independent votes."""


class Rectified(Detector):
    """A detector of the images of a lens: analyses rectified views, merges their maps by trust.

    detector: any with the setting ``rectification``; its parts are shared.
    """

    def __init__(self, detector: Detector) -> None:
        nn.Module.__init__(self)
        self.__dict__.update(vars(detector))

    def find_maps(self, image: Tensor) -> tuple[Mapping[str, Tensor], Tensor]:
        """Return the maps of an image's views and of itself, merged.

        Each counts by its trust: a view of a bumper alone finds no road, and is not trusted.
        """
        size, settings = spatial_size(image), self.settings
        rectification = settings.rectification
        assert rectification is not None
        lens = rectification.lens.at(size[1], size[0])
        rectified = rectified_views(lens, rectification.pitch)
        outputs, likelihoods, weights = list[Mapping[str, Tensor]](), list[Tensor](), list[float]()
        for view in [*(sample_view(image, lens, view) for view in rectified), image]:
            maps, likelihood = super().find_maps(view)
            ego = maps.get("ego")
            if ego is not None:  # no road here; other views may see past it
                likelihood = likelihood.masked_fill(resize_to_image(ego, spatial_size(view)), 0)
            trust, _ = self.judge(is_at_least(likelihood, settings.threshold), maps, ego)
            weights.append(1.0 if trust is None else max(trust, MIN_TRUST))
            outputs.append(maps if ego is None else {**maps, "ego": ego.to(torch.float32)})
            likelihoods.append(likelihood)
        weights[-1] *= IMAGE_WEIGHT
        views = [*rectified, view_itself(lens)]
        is_small = isinstance(settings, WorkingSettings)
        small = working_size(*size, settings.working) if is_small else size
        merged = {
            name: merge_views([maps[name] for maps in outputs], lens, views, small, weights)
            for name in outputs[0]
        }
        if "ego" in merged:
            merged["ego"] = is_above(merged["ego"], 0.5)
        return merged, merge_views(likelihoods, lens, views, size, weights).clamp(0, 1)
