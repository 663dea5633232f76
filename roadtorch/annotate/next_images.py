"""The order in which images are offered for correction: least trusted first, or at random.

Order rules are pure functions of the trusts and features of n images. A batch does not repeat a
scene: neighbouring frames of a recording teach a network little more than one of them.
"""

import threading
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from roadtorch.annotate.views import ImageView
from roadtorch.base.image import read_image
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


OrderRule = Callable[[Candidates, Collection[int], int], list[int]]
"""Candidates, indices of corrected images, batch size → indices of the batch, in order."""


def random_images(candidates: Candidates, corrected: Collection[int], count: int) -> list[int]:
    """Return ``count`` uncorrected images at random; the baseline for other rules."""
    generator = torch.Generator().manual_seed(0)
    order = torch.randperm(len(candidates.trust), generator=generator).tolist()
    return [index for index in order if index not in corrected][:count]


def least_trust_first(candidates: Candidates, corrected: Collection[int], count: int) -> list[int]:
    """Return the least trusted images of new scenes, then others by trust, unknown trust last."""
    order = candidates.trust.nan_to_num(torch.inf).argsort(stable=True).tolist()
    uncorrected = [index for index in order if index not in corrected]
    return new_scenes_first(uncorrected, candidates.features, corrected, count)


def new_scenes_first(
    order: Sequence[int], features: Tensor, corrected: Collection[int], count: int
) -> list[int]:
    """Return the first images of an order whose scenes are new, then the others, ``count`` in all.

    A scene is new where its features (n, d) are far from those of corrected and chosen images.
    Memory grows with n, not with its square.
    """
    if len(features) < 2:
        return list(order[:count])
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


ORDER_RULES: Mapping[str, OrderRule] = {"least-trust": least_trust_first, "random": random_images}


# --- in the page ------------------------------------------------------------------------


@dataclass(eq=False)
class ImageOrder:
    """The order of images by a rule of ``ORDER_RULES``; features are added with views."""

    rule: str
    features: dict[str, Tensor] = field(default_factory=dict)
    _turns: tuple[object, dict[str, int]] = field(default=(None, {}), repr=False)
    _lock: threading.Lock = field(default_factory=threading.Lock, repr=False)

    def add(self, name: str, image: Path, view: ImageView) -> None:
        """Add the features of an image; InputError where it cannot be read."""
        self.features[name] = view_features(read_image(image), view)

    def turns(
        self, names: Collection[str], trusts: Mapping[str, float], corrected: Collection[str]
    ) -> dict[str, int]:
        """Return the position, from 0, of each image of the next batch.

        names: of all images. trusts: NaN where there is none. corrected: names of images with
        corrections. Images without features are left out.
        """
        ready = [name for name in names if name in self.features]
        done = {index for index, name in enumerate(ready) if name in corrected}
        key = (tuple(ready), frozenset(done))
        with self._lock:
            if ready and self._turns[0] != key:
                trust = torch.tensor([trusts.get(name, np.nan) for name in ready])
                candidates = Candidates(trust, torch.stack([self.features[name] for name in ready]))
                indices = ORDER_RULES[self.rule](candidates, done, BATCH_IMAGES)
                self._turns = key, {ready[index]: turn for turn, index in enumerate(indices)}
            return self._turns[1]
