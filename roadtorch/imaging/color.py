"""Colour planes of P2 and P3, the representations that P3 combines from them, and exposure.

All planes are computed from gamma-encoded sRGB; only Lab linearises it. Every plane is of order 1,
so that distances and kernel widths mean the same in each.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import torch
from pydantic import Field
from torch import Tensor

from roadtorch.base.errors import InputError, unknown_name_error
from roadtorch.base.image_cache import cached_per_image
from roadtorch.base.settings import Settings
from roadtorch.base.twins import has_twin
from roadtorch.imaging.levels import order_statistic

LUMA = (0.299, 0.587, 0.114)
"""Weights of R, G, B in luma (Rec. 601), as in OpenCV, Pillow and MATLAB."""

_XYZ = (
    (0.412453, 0.357580, 0.180423),
    (0.212671, 0.715160, 0.072169),
    (0.019334, 0.119193, 0.950227),
)
RGB_TO_XYZ = tuple(tuple(value / sum(row) for value in row) for row in _XYZ)
"""Linear sRGB to CIE XYZ for D65, over the white point. Rows sum to 1, so grey has a = b = 0;
with the tabulated white (0.95047, 1, 1.08883) a and b would be off by up to 5e-5."""

STRAIGHT_LIGHT, STRAIGHT_CODE = 216 / 24389, 0.04045
"""Values below which CIE f and sRGB's transfer curve are straight lines; both are computed as the
curve of the clamped value plus the straight line of the rest."""


class Channels:
    """Intermediate results that several planes of one image (…, 3, H, W) share, computed once."""

    def __init__(self, image: Tensor) -> None:
        self.image = image
        self.red, self.green, self.blue = image.unbind(-3)

    @cached_property
    def total(self) -> Tensor:
        """R+G+B, in [0, 3]."""
        return self.red + self.green + self.blue

    @cached_property
    def black(self) -> Tensor:
        """1 where all channels are 0, else 0."""
        return self.total.clone().le_(0)  # in place, as 0 and 1: a sixth of the time

    @cached_property
    def divisor(self) -> Tensor:
        """R+G+B, or 1 where that is 0."""
        return self.total + self.black

    @cached_property
    def highest(self) -> Tensor:
        """max(R, G, B)."""
        return torch.maximum(torch.maximum(self.red, self.green), self.blue)

    @cached_property
    def chroma(self) -> Tensor:
        """max(R, G, B) - min(R, G, B)."""
        return self.highest - torch.minimum(torch.minimum(self.red, self.green), self.blue)

    @cached_property
    def red_green(self) -> Tensor:
        """R+G-2B, the numerator of O2."""
        return self.red + self.green - 2 * self.blue

    @cached_property
    def lab_roots(self) -> tuple[Tensor, Tensor, Tensor]:
        """CIE f(X/Xn), f(Y/Yn), f(Z/Zn)."""
        # Plane by plane, as the last pixels of a tensor may be rounded differently.
        red, green, blue = (_linear(plane) for plane in (self.red, self.green, self.blue))
        red, blue = red - green, blue - green
        # Rows sum to 1, so this is M·RGB; written thus, grey has X = Y = Z to the bit.
        x, y, z = (
            green.add(red, alpha=red_weight).add_(blue, alpha=blue_weight)
            for red_weight, _, blue_weight in RGB_TO_XYZ
        )
        return _root(x), _root(y), _root(z)


def _root(light: Tensor) -> Tensor:
    """Apply CIE f: the cube root, with a straight piece near black."""
    straight = light.clamp_max(STRAIGHT_LIGHT).sub_(STRAIGHT_LIGHT)
    return _power(light.clamp_min(STRAIGHT_LIGHT), 1 / 3).add_(straight, alpha=841 / 108)


def _linear(image: Tensor) -> Tensor:
    """Convert gamma-encoded sRGB to linear light (IEC 61966-2-1)."""
    straight = image.clamp_max(STRAIGHT_CODE).sub_(STRAIGHT_CODE)
    above = image.clamp_min(STRAIGHT_CODE).add_(0.055).div_(1.055)
    return _power(above, 2.4).add_(straight, alpha=1 / 12.92)


def _power(base: Tensor, exponent: float) -> Tensor:
    """Compute base ** exponent in place, for base > 0."""
    return base.log2_().mul_(exponent).exp2_()


def _over_total(channels: Channels, values: Tensor) -> Tensor:
    """Divide values by R+G+B, so that 3 · grey / (grey + grey + grey) is exactly 1."""
    return (3 * values).add_(channels.black).div_(channels.divisor).div_(3).clamp_max_(1)


def _hue(channels: Channels) -> Tensor:
    red, green, blue = channels.red, channels.green, channels.blue
    over = torch.where(channels.chroma > 0, channels.chroma, 1)
    hue_at_red = torch.remainder((green - blue) / over, 6)
    hue_at_green = (blue - red) / over + 2
    hue_at_blue = (red - green) / over + 4
    hue = torch.where(green == channels.highest, hue_at_green, hue_at_blue)
    hue = torch.where(red == channels.highest, hue_at_red, hue) / 6
    return torch.where(hue < 1, hue, 0)  # a tiny negative one is rounded to a whole turn


def _saturation(channels: Channels) -> Tensor:
    return channels.chroma / (channels.highest + channels.black)


def _grey(channels: Channels) -> Tensor:
    red, green, blue = LUMA
    return (channels.red * red).add_(channels.green, alpha=green).add_(channels.blue, alpha=blue)


@dataclass(frozen=True)
class Plane:
    """A colour plane.

    low, high: bounds of its values. circular: whether high equals low, as for hue. formula:
    computes the plane from the channels of an image.
    """

    low: float
    high: float
    circular: bool
    formula: Callable[[Channels], Tensor] = field(repr=False)


_ROOT_2, _ROOT_3, _ROOT_6 = math.sqrt(2), math.sqrt(3), math.sqrt(6)

PLANES: dict[str, Plane] = {
    "R": Plane(0, 1, False, lambda c: c.red),
    "G": Plane(0, 1, False, lambda c: c.green),
    "B": Plane(0, 1, False, lambda c: c.blue),
    "nr": Plane(0, 1, False, lambda c: _over_total(c, c.red)),  # R/(R+G+B), 1/3 at black
    "ng": Plane(0, 1, False, lambda c: _over_total(c, c.green)),
    "O1": Plane(-1 / _ROOT_2, 1 / _ROOT_2, False, lambda c: (c.red - c.green) / _ROOT_2),
    "O2": Plane(-2 / _ROOT_6, 2 / _ROOT_6, False, lambda c: c.red_green / _ROOT_6),
    "O3": Plane(0, _ROOT_3, False, lambda c: c.total / _ROOT_3),
    # CIE L*, a*, b* over 100, D65
    "L": Plane(0, 1, False, lambda c: 1.16 * c.lab_roots[1] - 0.16),
    "a": Plane(-0.862, 0.983, False, lambda c: 5 * (c.lab_roots[0] - c.lab_roots[1])),
    "b": Plane(-1.079, 0.945, False, lambda c: 2 * (c.lab_roots[1] - c.lab_roots[2])),
    "H": Plane(0, 1, True, _hue),  # of the HSV hexcone in turns, 0 for grey
    "S": Plane(0, 1, False, _saturation),  # (max-min)/max of R, G, B; 0 at black
    "V": Plane(0, 1, False, lambda c: c.highest),
    "grey": Plane(0, 1, False, _grey),  # luma of Rec. 601
}
"""All planes by name. O3 and grey are not among the representations of P3."""

REPRESENTATIONS: dict[str, tuple[str, ...]] = {
    **{name: (name,) for name in PLANES if name not in ("O3", "grey")},
    "RGB": ("R", "G", "B"),
    "nrng": ("nr", "ng"),
    "O1O2": ("O1", "O2"),
    "Lab": ("L", "a", "b"),
    "HSV": ("H", "S", "V"),
    "HS": ("H", "S"),
}
"""The 19 colour representations of P3 by name: 13 single planes and 6 combinations."""


def color_planes(image: Tensor, names: Sequence[str]) -> Tensor:
    """Compute N planes of ``PLANES`` by name of an sRGB image (…, 3, H, W) in [0, 1]: (…, N, H, W).

    Raises ConfigError for an unknown name, InputError for an image of other than 3 channels. P2,
    section 6.2; P3, section III.
    """
    return torch.stack(list(iterate_color_planes(image, names)), -3)


def iterate_color_planes(image: Tensor, names: Sequence[str]) -> Iterator[Tensor]:
    """Yield the planes of ``color_planes``, each (…, H, W), one by one to save memory."""
    if image.ndim < 3 or image.shape[-3] != 3:
        problem = f"has the shape {tuple(image.shape)}"
        raise InputError("image", problem, "give RGB as (…, 3, height, width)")
    for name in names:
        if name not in PLANES:
            raise unknown_name_error("plane", name, PLANES)
    channels = Channels(image)
    yield from (PLANES[name].formula(channels) for name in names)


def color_plane(image: Tensor, name: str) -> Tensor:
    """Compute one colour plane (…, H, W) of an image (…, 3, H, W), as ``color_planes``."""
    return color_planes(image, (name,)).squeeze(-3)


# --- exposure -------------------------------------------------------------------------


MIN_GAMMA = 0.3  # the strongest brightening: 0.01 becomes 0.25

MIN_VALUE = 1e-4
"""Lower bound of pixel values before the gamma, so that black stays nearly black."""


class Exposure(Settings):
    """Brightening of dark images before analysis."""

    ground: float = Field(
        default=0.4,
        gt=0,
        lt=1,
        description="median grey level, 0 to 1, to which the lower part of a dark image is raised",
    )


@has_twin
@cached_per_image
def brighten(image: Tensor, exposure: Exposure) -> Tensor:
    """Raise the median grey of an image's lower 45 % to ``ground`` by a gamma. Ours.

    Bright images are returned as they are, and the exponent is at least ``MIN_GAMMA``. It replaces
    P1's brightness equalisation. image: (3, H, W) in [0, 1].
    """
    lower = image[..., image.shape[-2] * 11 // 20 :, :].mean(-3).flatten(-2)
    grey = min(max(order_statistic(lower, (len(lower) - 1) // 2), 0.01), 0.99)
    exponent = min(max(math.log(exposure.ground) / math.log(grey), MIN_GAMMA), 1.0)
    # As 2 to the log2, which is three times as fast as a power.
    return image if exponent == 1 else image.clamp_min(MIN_VALUE).log2_().mul_(exponent).exp2_()
