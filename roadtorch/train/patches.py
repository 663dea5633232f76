"""Varied patches; all patches of a picture are cut in one pass.

P2, section 6.1: at a random scale and angle, with Gaussian noise.
"""

import math
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional as F

from roadtorch.train.config import Jitter
from roadtorch.train.generators import uniform

NOISES = 256
"""Patches of noise drawn for a chunk; each of its patches takes one, times its own deviation."""


class Draw(NamedTuple):
    """How n patches are taken, each (n,).

    centre: (n,2), row and column. scale: magnification. turn: radians. noise: deviation,
    grey levels of 255. which: int64, the patch of noise.
    """

    centre: Tensor
    scale: Tensor
    turn: Tensor
    noise: Tensor
    which: Tensor

    def at(self, index: Tensor) -> "Draw":
        """Some of the patches."""
        return Draw(*(values[index] for values in self))


def draw_jitter(centre: Tensor, jitter: Jitter, generator: torch.Generator) -> Draw:
    """Random scales, angles and noise for patches at centres (n,2)."""
    count = len(centre)
    angle = math.radians(jitter.rotation)
    return Draw(
        centre.to(torch.float32),
        uniform(generator, count, jitter.smallest, jitter.largest),
        uniform(generator, count, -angle, angle),
        uniform(generator, count, jitter.faintest, jitter.noisiest),
        torch.randint(NOISES, (count,), generator=generator),
    )


def draw_noise(patch: int, generator: torch.Generator) -> Tensor:
    """The noise of a chunk: ``NOISES`` patches (·,3,P,P), unit normal."""
    return torch.randn(NOISES, 3, patch, patch, generator=generator)


def cut_patches(pixels: Tensor, draw: Draw, patch: int) -> Tensor:
    """Patches (n,3,P,P) of a picture (3,H,W), bilinear, in one pass. Past the border it reflects.

    At scale 1 and angle 0 they are what ``PatchNetwork.dense`` sees: P/2 pixels before the
    centre, one less behind it.
    """
    count, (height, width) = len(draw.centre), pixels.shape[-2:]
    offsets = torch.arange(patch, dtype=torch.float32) - patch // 2
    along, aside = (f(draw.turn) / draw.scale for f in (torch.cos, torch.sin))
    grid = torch.empty(count, patch, patch, 2)
    # column = sin·down + cos·across, row = cos·down - sin·across; written where they are needed
    for axis, (down, across, length) in enumerate(((aside, along, width), (along, -aside, height))):
        unit = 2 / max(1, length - 1)  # from pixels to -1 (first) … 1 (last)
        start = draw.centre[:, 1 - axis] * unit - 1
        down = down[:, None] * offsets * unit + start[:, None]
        across = across[:, None] * offsets * unit
        torch.add(down[:, :, None], across[:, None, :], out=grid[..., axis])
    cut = F.grid_sample(
        pixels[None],
        grid.reshape(1, count * patch, patch, 2),
        padding_mode="reflection",
        align_corners=True,
    )
    return cut.reshape(3, count, patch, patch).transpose(0, 1)


def add_noise(
    patches: Tensor, draw: Draw, noises: Tensor, gain: float, out: Tensor | None = None
) -> Tensor:
    """Patches (n,3,P,P) with their noise; gain: what one level of [0,1] has become."""
    deviation = (draw.noise * (gain / 255))[:, None, None, None]
    return torch.addcmul(patches, noises.index_select(0, draw.which), deviation, out=out)
