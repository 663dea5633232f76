"""How whole pictures are varied: their frame and their light. Ours."""

import math

import torch
from torch import Tensor
from torch.nn import functional as F

from roadtorch.train.config import Light, Shift
from roadtorch.train.generators import uniform

DARKEST = 1e-4
"""Pixels count as at least this bright: a power of 0 has no slope."""


def draw_frames(count: int, size: tuple[int, int], shift: Shift, at: torch.Generator) -> Tensor:
    """Affine maps (n,2,3) from a varied frame to the picture's, both from -1 to 1."""
    mirror = torch.randint(2, (count,), generator=at) * 2 - 1
    zoom = torch.exp(uniform(at, count, -shift.scale, shift.scale))
    width = zoom * torch.exp(uniform(at, count, -shift.stretch, shift.stretch))
    angle = uniform(at, count, -shift.rotation, shift.rotation) * (math.pi / 180)
    move = [uniform(at, count, -2 * shift.move, 2 * shift.move) for _ in range(2)]
    cos, sin, aspect = angle.cos(), angle.sin(), size[1] / size[0]
    across = torch.stack([mirror * cos / width, -sin / (zoom * aspect), move[0]], 1)
    down = torch.stack([mirror * sin * aspect / width, cos / zoom, move[1]], 1)
    return torch.stack([across, down], 1)


def reframed(maps: Tensor, frames: Tensor, outside: str) -> Tensor:
    """Maps (n,C,H,W) seen in other frames (n,2,3); outside: "border" or "zeros"."""
    grid = F.affine_grid(frames, list(maps.shape), align_corners=False)
    return F.grid_sample(maps, grid, padding_mode=outside, align_corners=False)


def relit(images: Tensor, light: Light, at: torch.Generator) -> Tensor:
    """Images (n,3,H,W) in [0,1] in another light, as another sensor would see them."""
    count = len(images)
    exponent = torch.exp(uniform(at, count, -light.gamma, light.gamma))
    gain = torch.exp(uniform(at, count, -light.gain, light.gain))
    tint = torch.exp(uniform(at, 3 * count, -light.tint, light.tint)).reshape(count, 3)
    colour = uniform(at, count, 1 - light.saturation, 1 + light.saturation)
    noise = uniform(at, count, 0, light.noise / 255)
    each = (count, 1, 1, 1)
    varied = images.clamp_min(DARKEST).pow(exponent.reshape(each))
    varied = torch.lerp(varied.mean(1, keepdim=True), varied, colour.reshape(each))
    varied = varied * (gain[:, None] * tint)[:, :, None, None]
    grain = torch.randn(images.shape, generator=at) * noise.reshape(each)
    return (varied + grain).clamp(0, 1)
