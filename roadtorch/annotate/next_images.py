"""Which images to correct next: the least trusted, or at random.

The rules are pure functions of what is known of n images. A batch does not repeat one scene:
neighbouring frames of a recording teach a network nearly the same, and cost a person as much.
"""

import threading
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from roadtorch.annotate.machine import ImageView
from roadtorch.base.image import read_image
from roadtorch.imaging.resize import resized
from roadtorch.imaging.segments import paint
from roadtorch.layout.classes import CLASSES

GRID = (4, 5)
"""Rows and columns of the cells over which an image's features are averaged."""

BATCH = 20
"""Images that have a turn; the rest follows by trust."""

APART = 0.5
"""Share of the median distance between images from which two are different scenes."""

SAMPLE = 1000
"""Images of which the median distance is taken; all where there are no more."""

CHUNK = 256
"""Corrected images whose distances to all images are in memory at the same time."""


class Candidates(NamedTuple):
    """What is known of n images. trust: (n,), NaN unknown; features: (n,d), see below."""

    trust: Tensor
    features: Tensor


def view_features(image: Tensor, view: ImageView) -> Tensor:
    """What an image looks like, (d,): colours of an image (3,H,W), and road and layout in it.

    All in [0,1]: means over the cells of a coarse grid, so that distance is about what stands
    where. Ours.
    """
    parts = [image, view.odds.sigmoid()[None]]
    if view.layout.shape[1] == CLASSES:
        parts.append(paint(view.layout.sigmoid().T, view.labels).float())
    return torch.cat([resized(part, GRID).flatten() for part in parts]).float()


Rule = Callable[[Candidates, Collection[int], int], list[int]]
"""What is known, which are corrected, and how many are wanted → places, the first first."""


def random_images(candidates: Candidates, corrected: Collection[int], count: int) -> list[int]:
    """So many of those that are not corrected, at random; the rule that others have to beat."""
    generator = torch.Generator().manual_seed(0)
    order = torch.randperm(len(candidates.trust), generator=generator).tolist()
    return [place for place in order if place not in corrected][:count]


def least_trust_first(candidates: Candidates, corrected: Collection[int], count: int) -> list[int]:
    """Those with the least trust, each another scene than those corrected or before it.

    Where scenes run out, the rest follows by trust alone; unknown trust comes last.
    """
    order = candidates.trust.nan_to_num(torch.inf).argsort(stable=True).tolist()
    waiting = [place for place in order if place not in corrected]
    return new_scenes_first(waiting, candidates.features, corrected, count)


def new_scenes_first(
    order: Sequence[int], features: Tensor, corrected: Collection[int], count: int
) -> list[int]:
    """Return the first of an order that repeat no scene, then the rest of it, ``count`` in all.

    features: (n,d) of all images; no scene of ``corrected`` ones is repeated either. Memory grows
    with n, not with its square.
    """
    if len(features) < 2:
        return list(order[:count])
    apart, chosen = APART * median_distance(features), []
    nearest = torch.full((len(features),), torch.inf)  # distance to what is corrected or chosen
    for start in range(0, len(corrected), CHUNK):
        places = [*corrected][start : start + CHUNK]
        nearest = nearest.minimum(torch.cdist(features, features[places]).amin(1))
    for place in order:
        if len(chosen) == count:
            break
        if nearest[place] >= apart:
            chosen.append(place)
            nearest = nearest.minimum(torch.cdist(features, features[place : place + 1])[:, 0])
    repeated = set(order).difference(chosen)
    return [*chosen, *(place for place in order if place in repeated)][:count]


def median_distance(features: Tensor) -> float:
    """Return the median distance between images, of at most ``SAMPLE`` evenly spaced ones."""
    count = min(len(features), SAMPLE)
    sample = features[torch.linspace(0, len(features) - 1, count).round().long()]
    first, second = torch.triu_indices(count, count, 1)
    return float(torch.cdist(sample, sample)[first, second].median())


RULES: Mapping[str, Rule] = {
    "least-trust": least_trust_first,
    "random": random_images,
}


# --- in the page ------------------------------------------------------------------------


@dataclass
class ImageOrder:
    """The order by a rule of ``RULES``; trust and features by the image's name, as they come."""

    rule: str
    features: dict[str, Tensor] = field(default_factory=dict)
    _turns: tuple[object, dict[str, int]] = field(default=(None, {}), repr=False)
    _lock: threading.Lock = field(default_factory=threading.Lock, repr=False)

    def learn(self, name: str, image: Path, view: ImageView) -> None:
        """Keep the features of an image; InputError where it cannot be read."""
        self.features[name] = view_features(read_image(image), view)

    def turns(
        self, names: Collection[str], trusts: Mapping[str, float], corrected: Collection[str]
    ) -> dict[str, int]:
        """The turn, from 0, of the images of the next batch.

        names: of the folder. trusts: NaN where there is none. corrected: on which somebody worked.
        Images that nobody looked at yet have no turn.
        """
        known = [name for name in names if name in self.features]
        done = {place for place, name in enumerate(known) if name in corrected}
        key = (tuple(known), frozenset(done))
        with self._lock:
            if known and self._turns[0] != key:
                trust = torch.tensor([trusts.get(name, np.nan) for name in known])
                candidates = Candidates(trust, torch.stack([self.features[name] for name in known]))
                places = RULES[self.rule](candidates, done, BATCH)
                self._turns = key, {known[place]: turn for turn, place in enumerate(places)}
            return self._turns[1]
