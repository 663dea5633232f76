"""Preprocessing of an image before its features are learned (P1, section II.A)."""

import math

import torch
from pydantic import Field
from torch import Tensor
from torch.nn import functional as F

from roadtorch.base.settings import Settings

GREY_WEIGHTS = (0.298936021, 0.587043074, 0.114020904)
"""Weights of R, G and B, as in the authors' program (ITU-R BT.601)."""

MIN_BRIGHTNESS = 1e-6
"""Least brightness, of 1: eq. 2 is undefined at 0. Below the resolution of 8 bits."""

MAX_LEVEL = 255  # largest level of the 8-bit images that the authors' program reads


class WorkingShape(Settings):
    """Working size of P1: 160×120 for images of 4:3, 397×120 for KITTI's."""

    rows: int = Field(
        default=120, ge=16, le=480, description="height, pixels; the width keeps the aspect ratio"
    )
    max_aspect_ratio: float = Field(
        default=4.0, ge=1, le=64, description="largest aspect ratio, width/height or height/width"
    )

    def size(self, height: int, width: int) -> tuple[int, int]:
        """Return the working rows and columns for an image of height × width pixels."""
        limit = self.max_aspect_ratio
        shape = min(max(width / height, 1 / limit), limit)
        return self.rows, max(16, round(self.rows * shape))


class Smoothing(Settings):
    """Settings of blur and brightness equalisation (eqs. 1 and 2)."""

    sigma: float = Field(
        default=1.5, gt=0, le=50, description="sigma of the blur, pixels; 2.5 for KITTI road"
    )
    window: float = Field(
        default=2.0, ge=0, le=10, description="radius of the blur, in sigmas; rounded up"
    )
    light_sigma: float = Field(
        default=0.5, gt=0, le=50, description="sigma of the brightness map's blur, pixels"
    )
    light_reach: int = Field(
        default=2, ge=0, le=50, description="window radius of the brightness map's blur, pixels"
    )
    target: float = Field(
        default=0.5, gt=0, le=10, description="brightness of every position; the text of P1: 1"
    )

    @property
    def radius(self) -> int:
        """Radius of the blur's window, pixels: 3 for sigma 1.5 (program), 5 for 2.5.

        Ours: the program has 3 for its one sigma, and no setting for the text's 2.5. In a window of
        3, weights of sigma 2.5 have a standard deviation of 1.76; in one of 5, of 2.29.
        """
        return math.ceil(self.window * self.sigma)


def resize_bicubic(image: Tensor, size: tuple[int, int]) -> Tensor:
    """Resize an image (3, H, W) in [0, 1] as MATLAB's ``imresize`` does.

    Cubic kernel a = -0.5, widened when reducing, mirrored border, rounded to 8 bits after the rows
    and again after the columns: the result of the authors' data reader.
    """
    if tuple(image.shape[-2:]) == tuple(size):
        return image
    rows = _cubic_weights(image.shape[-2], size[0]).to(image)
    columns = _cubic_weights(image.shape[-1], size[1]).to(image)
    return _to_eight_bits(_to_eight_bits(rows @ image) @ columns.T)


def _to_eight_bits(image: Tensor) -> Tensor:
    return (image * MAX_LEVEL + 0.5).floor_().clamp_(0, MAX_LEVEL).div_(MAX_LEVEL)


def _cubic_weights(length: int, size: int) -> Tensor:
    """Return weights of old pixels in new ones, float64 (size, length); rows sum to 1."""
    scale = size / length
    shrink = min(scale, 1.0)
    centre = (torch.arange(size, dtype=torch.float64) + 0.5) / scale - 0.5
    index = (centre - 2 / shrink).floor()[:, None] + torch.arange(int(4 / shrink) + 3)
    x = shrink * (index - centre[:, None]).abs()  # Keys' kernel, a = -0.5
    far = -0.5 * x**3 + 2.5 * x**2 - 4 * x + 2
    weight = torch.where(x <= 1, 1.5 * x**3 - 2.5 * x**2 + 1, torch.where(x <= 2, far, 0))
    mirrored = index.long() % (2 * length)
    mirrored = torch.where(mirrored < length, mirrored, 2 * length - 1 - mirrored)
    table = torch.zeros(size, length, dtype=torch.float64).scatter_add_(1, mirrored, weight)
    return table / table.sum(1, keepdim=True)


def blur(maps: Tensor, sigma: float, radius: int) -> Tensor:
    """Blur maps (C, H, W) with a Gaussian of 2·radius + 1 pixels, sigma in pixels (eq. 1).

    The weights sum to 1; the border is repeated.
    """
    offsets = torch.arange(-radius, radius + 1, dtype=torch.float64)
    weights = torch.exp(-(offsets**2) / (2 * sigma**2))
    weights = (weights / weights.sum()).to(maps)
    padded = F.pad(maps[:, None], (radius, radius, radius, radius), mode="replicate")
    rows = F.conv2d(padded, weights.view(1, 1, -1, 1))
    return F.conv2d(rows, weights.view(1, 1, 1, -1))[:, 0]


def brightness(image: Tensor, sigma: float, radius: int) -> Tensor:
    """Return the blurred grey (H, W) of an image (3, H, W), the denominator of eq. 2."""
    grey = torch.tensordot(image.new_tensor(GREY_WEIGHTS), image, 1)
    return blur(grey[None], sigma, radius)[0]


def equalise(image: Tensor, settings: Smoothing) -> Tensor:
    """Blur an image (3, H, W) and equalise its brightness to ``target`` (eqs. 1 and 2).

    Black pixels stay black: the authors' program divides 0 by 0 there, and fails.
    """
    smooth = blur(image, settings.sigma, settings.radius)
    light = brightness(smooth, settings.light_sigma, settings.light_reach)
    return settings.target * smooth / light.clamp_min(MIN_BRIGHTNESS)
