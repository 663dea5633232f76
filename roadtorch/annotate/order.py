"""In which order the page offers pictures: a rule, over what is known of them so far."""

import threading
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from roadtorch.annotate.machine import PictureView
from roadtorch.annotate.next_pictures import GRID, RULES, Candidates, picture_features
from roadtorch.imaging.resize import resized
from roadtorch.io.image import read_image
from roadtorch.layout.classes import CLASSES
from roadtorch.superpixels.statistics import paint

BATCH = 20
"""Pictures that have a turn; the rest follows by trust."""


@dataclass
class PictureOrder:
    """The order by a rule of ``RULES``; trust and features by the picture's name, as they come."""

    rule: str
    features: dict[str, Tensor] = field(default_factory=dict)
    _known: tuple[object, dict[str, int]] | None = field(default=None, repr=False)
    _lock: threading.Lock = field(default_factory=threading.Lock, repr=False)

    def look(self, name: str, picture: Path, view: PictureView) -> None:
        """Keep the features of a picture; InputError where it cannot be read."""
        self.features[name] = view_features(read_image(picture), view)

    def turns(
        self, names: Collection[str], trusts: Mapping[str, float], corrected: Collection[str]
    ) -> dict[str, int]:
        """The turn, from 0, of the pictures of the next batch.

        names: of the folder. trusts: NaN where there is none. corrected: on which somebody worked.
        Pictures that nobody looked at yet have no turn.
        """
        seen = [one for one in names if one in self.features]
        done = [place for place, one in enumerate(seen) if one in corrected]
        with self._lock:
            key = (tuple(seen), tuple(done))
            if self._known is None or self._known[0] != key:
                self._known = key, self._chosen(seen, trusts, done)
            return self._known[1]

    def _chosen(
        self, seen: list[str], trusts: Mapping[str, float], done: list[int]
    ) -> dict[str, int]:
        if not seen:
            return {}
        trust = torch.tensor([trusts.get(one, np.nan) for one in seen])
        candidates = Candidates(trust, torch.stack([self.features[one] for one in seen]))
        places = RULES[self.rule](candidates, done, BATCH, 0)
        return {seen[place]: turn for turn, place in enumerate(places)}


def view_features(image: Tensor, view: PictureView) -> Tensor:
    """Features (d,) of an image (3,H,W) and what the machine sees in it: colours, layout, road."""
    maps = [resized(view.odds.sigmoid()[None], GRID)]
    if view.layout.shape[1] == CLASSES:
        maps.append(resized(paint(view.layout.sigmoid().T, view.labels).float(), GRID))
    return picture_features(image, torch.cat(maps))
