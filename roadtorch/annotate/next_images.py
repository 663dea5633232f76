"""The next images to correct: the least trusted ones, each of another scene.

Neighbouring frames of a recording teach a network little more than one of them, so a batch does not
repeat a scene.
"""

from collections.abc import Collection
from typing import NamedTuple

import torch
from torch import Tensor

from roadtorch.annotate.views import ImageView
from roadtorch.imaging.resize import resize_maps
from roadtorch.imaging.segments import paint_segments
from roadtorch.layout.classes import NUM_CLASSES

FEATURE_GRID = (4, 5)  # rows and columns of the grid of cells over which features are averaged
BATCH_IMAGES = 20  # number of images in a batch; the remaining ones are sorted by trust

SCENE_DISTANCE = 0.5
"""Fraction of the median feature distance above which two images are different scenes."""

DISTANCE_SAMPLE = 1000  # largest number of images for the median distance

DISTANCE_CHUNK = 256
"""Number of corrected images whose distances to all images are in memory at a time."""


class Candidates(NamedTuple):
    """n images: trust (n,), NaN where unknown, and features (n, d), see ``view_features``."""

    trust: Tensor
    features: Tensor


def view_features(image: Tensor, view: ImageView) -> Tensor:
    """Compute the features of an image (3, H, W), shape (d,), in [0, 1].

    Colours, road and layout averaged over a coarse grid, so that the distance between two images
    compares their scenes. Ours.
    """
    parts = [image, view.odds.sigmoid()[None]]
    if view.layout.shape[1] == NUM_CLASSES:
        parts.append(paint_segments(view.layout.sigmoid().T, view.labels).float())
    return torch.cat([resize_maps(part, FEATURE_GRID).flatten() for part in parts]).float()


def select_batch(
    candidates: Candidates, corrected: Collection[int], count: int = BATCH_IMAGES
) -> list[int]:
    """Return ``count`` uncorrected images: the least trusted of new scenes, then others by trust.

    A scene is new where its features are far from those of corrected and chosen images. Unknown
    trust comes last. Memory grows with the number of images, not with its square.
    """
    order = candidates.trust.nan_to_num(torch.inf).argsort(stable=True).tolist()
    order, features = [i for i in order if i not in corrected], candidates.features
    if len(features) < 2:
        return order[:count]
    threshold, chosen = SCENE_DISTANCE * median_distance(features), []
    nearest = torch.full((len(features),), torch.inf)  # distance to corrected or chosen images
    for start in range(0, len(corrected), DISTANCE_CHUNK):
        indices = [*corrected][start : start + DISTANCE_CHUNK]
        nearest = nearest.minimum(torch.cdist(features, features[indices]).amin(1))
    for index in order:
        if len(chosen) == count:
            break
        if nearest[index] >= threshold:
            chosen.append(index)
            nearest = nearest.minimum(torch.cdist(features, features[index : index + 1])[:, 0])
    repeated = set(order).difference(chosen)
    return [*chosen, *(index for index in order if index in repeated)][:count]


def median_distance(features: Tensor) -> float:
    """Return the median feature distance of ``DISTANCE_SAMPLE`` evenly spaced images."""
    count = min(len(features), DISTANCE_SAMPLE)
    sample = features[torch.linspace(0, len(features) - 1, count).round().long()]
    first, second = torch.triu_indices(count, count, 1)
    return float(torch.cdist(sample, sample)[first, second].median())
