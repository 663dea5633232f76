"""Ego cars that footage shows, cut out and laid over other streets. Ours.

Cut and paste after Dwibedi et al., "Cut, Paste and Learn", 2017: a network that has seen few
bonnets learns what one is from many streets with one of them below.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import torch
from torch import Tensor

from roadtorch.layout.classes import CLASSES
from roadtorch.train.arrays import from_bytes, read_arrays
from roadtorch.train.config import EgoCars
from roadtorch.train.generators import uniform
from roadtorch.train.variation import DARKEST, reframed

TINT = 0.2
"""Share of the light's variation that each colour has alone."""


class EgoCar(NamedTuple):
    """A frame (1,3,H,W) in [0,1] and where in it the ego car is, (1,1,H,W), 0 or 1."""

    image: Tensor
    ego: Tensor


def lent(recordings: Mapping[str, Sequence[Path]], at: torch.Generator) -> EgoCar:
    """A frame with its ego car: each recording is as likely, and each of its frames."""
    names = sorted(recordings)
    frames = recordings[names[int(torch.randint(len(names), (), generator=at))]]
    path = frames[int(torch.randint(len(frames), (), generator=at))]
    arrays = read_arrays(path, "image", "ego")
    ego = from_bytes(arrays["ego"])[None, None] > 0.75  # 0.5 is unknown
    return EgoCar(from_bytes(arrays["image"])[None], ego.to(torch.float32))


def varied(car: EgoCar, settings: EgoCars, at: torch.Generator) -> EgoCar:
    """The ego car larger or smaller, mirrored, in another light; its lower edge stays below."""
    grown = float(torch.exp(uniform(at, 1, -settings.flattest, settings.tallest)))
    wider = float(torch.exp(uniform(at, 1, 0, settings.widest)))  # no gap at the sides
    mirror = 1 - 2 * int(torch.randint(2, (), generator=at))
    aside = float(uniform(at, 1, -1, 1)) * (1 - 1 / wider)
    frame = torch.tensor([[[mirror / wider, 0, aside], [0, 1 / grown, 1 - 1 / grown]]])
    gamma, gain, *tint = torch.exp(uniform(at, 5, -settings.light, settings.light)).tolist()
    image = reframed(car.image, frame, "border").clamp_min(DARKEST).pow(gamma) * gain
    colour = torch.tensor(tint).pow(TINT).reshape(1, 3, 1, 1)
    return EgoCar((image * colour).clamp(0, 1), reframed(car.ego, frame, "border"))


def laid_over(image: Tensor, targets: Tensor, car: EgoCar) -> tuple[Tensor, Tensor]:
    """An image (1,3,H,W) and its targets (1,8,H,W) with the ego car over them.

    On it there is no road and no layout that counts, and the ego car is known.
    """
    over = (car.ego > 0.5).to(targets)
    said = targets.new_tensor([0.0] * CLASSES + [0, 0, 1, 1, 1]).reshape(1, -1, 1, 1)
    return torch.lerp(image, car.image, car.ego), torch.lerp(targets, said, over)
