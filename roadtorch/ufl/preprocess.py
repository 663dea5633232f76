"""What is done to an image before its features are learned (P1, section II.A)."""

import math

import torch
from pydantic import Field
from torch import Tensor
from torch.nn import functional as F

from roadtorch.base.settings import Settings

GREY_WEIGHTS = (0.298936021, 0.587043074, 0.114020904)
"""Of R, G and B, as in the authors' program (ITU-R BT.601)."""

MIN_BRIGHTNESS = 1e-6
"""The least brightness, of 1: where it is 0, eq. 2 has no value. Below what 8 bits can tell."""

STRETCH = 255
"""Levels of the 8-bit images that the authors' program reads."""


class WorkingShape(Settings):
    """The size at which P1 works: 160x120 for images of 4:3, 397x120 for KITTI's."""

    rows: int = Field(
        default=120, ge=16, le=480, description="height in pixels; the width keeps the shape"
    )
    widest: float = Field(
        default=4.0, ge=1, le=64, description="width at most, in heights (and height, in widths)"
    )

    def size(self, height: int, width: int) -> tuple[int, int]:
        """Rows and columns for an image of height × width pixels."""
        shape = min(max(width / height, 1 / self.widest), self.widest)
        return self.rows, max(16, round(self.rows * shape))


class Smoothing(Settings):
    """Blurring and brightness equalisation (eqs. 1 and 2)."""

    sigma: float = Field(
        default=1.5, gt=0, le=50, description="blur of the image, pixels; 2.5 for KITTI road"
    )
    window: float = Field(
        default=2.0,
        ge=0,
        le=10,
        description="the blur's window on each side, in sigmas; rounded up",
    )
    light_sigma: float = Field(
        default=0.5, gt=0, le=50, description="blur of the brightness map, pixels"
    )
    light_reach: int = Field(default=2, ge=0, le=50, description="its window on each side, pixels")
    target: float = Field(
        default=0.5, gt=0, le=10, description="brightness after equalisation; 1 in the text"
    )

    @property
    def reach(self) -> int:
        """The blur's window on each side, pixels: 3 for sigma 1.5 (program), 5 for 2.5.

        Ours: the program has 3 for its one sigma, and no setting for the text's 2.5. In a window
        of 3, weights of sigma 2.5 have a standard deviation of 1.76; in one of 5 of 2.29.
        """
        return math.ceil(self.window * self.sigma)


def bicubic(image: Tensor, size: tuple[int, int]) -> Tensor:
    """An image (3,H,W) in [0,1] at another size, as MATLAB's ``imresize`` makes it.

    Cubic kernel a = -0.5, stretched by the reduction, mirrored border, rounded to 8 bits
    after the rows and again after the columns: what the authors' data reader gives.
    """
    if tuple(image.shape[-2:]) == tuple(size):
        return image
    rows = _cubic_weights(image.shape[-2], size[0]).to(image)
    columns = _cubic_weights(image.shape[-1], size[1]).to(image)
    return _to_eight_bits(_to_eight_bits(rows @ image) @ columns.T)


def _to_eight_bits(image: Tensor) -> Tensor:
    return (image * STRETCH + 0.5).floor_().clamp_(0, STRETCH).div_(STRETCH)


def _cubic_weights(length: int, wanted: int) -> Tensor:
    """(wanted,length) float64: every new pixel as a mean of old ones; rows sum to 1."""
    scale = wanted / length
    shrink = min(scale, 1.0)
    centre = (torch.arange(wanted, dtype=torch.float64) + 0.5) / scale - 0.5
    taps = torch.arange(int(4 / shrink) + 3)
    place = (centre - 2 / shrink).floor()[:, None] + taps
    x = shrink * (place - centre[:, None]).abs()  # Keys' kernel, a = -0.5
    far = -0.5 * x**3 + 2.5 * x**2 - 4 * x + 2
    weight = torch.where(x <= 1, 1.5 * x**3 - 2.5 * x**2 + 1, torch.where(x <= 2, far, 0))
    mirrored = place.long() % (2 * length)
    mirrored = torch.where(mirrored < length, mirrored, 2 * length - 1 - mirrored)
    table = torch.zeros(wanted, length, dtype=torch.float64).scatter_add_(1, mirrored, weight)
    return table / table.sum(1, keepdim=True)


def blur(maps: Tensor, sigma: float, reach: int) -> Tensor:
    """Maps (C,H,W) under a Gaussian of 2·reach + 1 pixels whose weights sum to 1 (eq. 1).

    The border is repeated. sigma in pixels.
    """
    offsets = torch.arange(-reach, reach + 1, dtype=torch.float64)
    weights = torch.exp(-(offsets**2) / (2 * sigma**2))
    weights = (weights / weights.sum()).to(maps)
    padded = F.pad(maps[:, None], (reach, reach, reach, reach), mode="replicate")
    rows = F.conv2d(padded, weights.view(1, 1, -1, 1))
    return F.conv2d(rows, weights.view(1, 1, 1, -1))[:, 0]


def brightness(image: Tensor, sigma: float, reach: int) -> Tensor:
    """The brightness map (H,W) of an image (3,H,W): its grey, blurred (denominator of eq. 2)."""
    grey = torch.tensordot(image.new_tensor(GREY_WEIGHTS), image, 1)
    return blur(grey[None], sigma, reach)[0]


def equalised(image: Tensor, settings: Smoothing) -> Tensor:
    """Blurred and equalised (3,H,W), grey being ``target`` everywhere (eqs. 1 and 2).

    Black places stay black: there the program divides 0 by 0, and stops.
    """
    smooth = blur(image, settings.sigma, settings.reach)
    light = brightness(smooth, settings.light_sigma, settings.light_reach)
    return settings.target * smooth / light.clamp_min(MIN_BRIGHTNESS)
