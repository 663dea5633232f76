"""What never moves in the footage of one camera: gradients that stay while the street changes.

Where a bonnet, a dashboard or a wiper begins, the gradient points the same way in every frame;
where the street passes, it points anywhere. Frames are looked at 320 pixels wide: edges of the
ego car stay visible, and a hundred frames take seconds. Ours.
"""

from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import cv2
import numpy as np
import torch
from torch import Tensor

WIDTH = 320
"""Pixels in a row of a small frame."""

SOFTNESS = 8.0
"""Grey levels of 255: gradients far below it are noise and count little."""

BLUR = 0.8
"""Pixels; standard deviation of the Gaussian that takes the noise of a small frame away."""

FAINT = 0.12
"""Mean length of a unit gradient at which coherence is halved: the even slope of light on a
road points the same way in all frames, but is faint."""


class Stillness(NamedTuple):
    """Sums over n frames of gradients g, softened: u = g / (|g| + 8 grey levels).

    mean: (2,h,w), of u, across and down. squares: (2,h,w), of u², each part. length: (h,w), of |u|.
    """

    mean: Tensor
    squares: Tensor
    length: Tensor
    frames: int

    @property
    def common(self) -> Tensor:
        """Length (h,w) in [0,1] of what the gradients of two different frames have in common.

        The mean over pairs of frames of u·u', which is 0 on average where frames are unrelated,
        however few they are; its root, and 0 where it is negative.
        """
        n = self.frames
        pairs = (self.mean.square() * n - self.squares).sum(0) / (n - 1)
        return pairs.clamp_min(0).sqrt()

    @property
    def coherence(self) -> Tensor:
        """The same as a share of the mean length, (h,w) in [0,1]; small where all is faint."""
        return (self.common / (self.length + FAINT)).clamp(0, 1)

    @property
    def share(self) -> float:
        """Share of all gradients that is common, in [0,1]: about 1 where nothing moves."""
        return float(self.common.sum() / self.length.sum().clamp_min(1e-9))

    @property
    def direction(self) -> Tensor:
        """Unit vectors (2,h,w) of the mean gradient; 0 where there is none."""
        return self.mean / self.mean.square().sum(0).sqrt().clamp_min(1e-9)


def small_grey(image: Tensor, size: tuple[int, int]) -> Tensor:
    """An image (3,H,W) in [0,1] as grey levels (h,w) from 0 to 255: ITU-R BT.601 luma."""
    luma = torch.einsum("chw,c->hw", image, image.new_tensor((0.299, 0.587, 0.114))) * 255
    pixels = np.ascontiguousarray(luma.float().cpu().numpy())
    return torch.from_numpy(cv2.resize(pixels, size[::-1], interpolation=cv2.INTER_AREA))


def small_size(frames: Sequence[Tensor]) -> tuple[int, int]:
    """Height and width at which frames (…,H,W) are looked at: the median of their shapes."""
    shapes = sorted(frame.shape[-2] / frame.shape[-1] for frame in frames)
    return max(16, round(shapes[len(shapes) // 2] * WIDTH)), WIDTH


def gradients(greys: Iterable[Tensor]) -> Iterator[Tensor]:
    """Sobel's gradients (2,h,w) of grey levels (h,w): across and down, levels over two pixels."""
    for grey in greys:
        smooth = cv2.GaussianBlur(grey.numpy(), (0, 0), BLUR)
        across, down = (
            cv2.Sobel(smooth, cv2.CV_32F, *way, scale=1 / 4) for way in ((1, 0), (0, 1))
        )
        yield torch.from_numpy(np.stack([across, down]))


def softened(gradient: Tensor) -> Tensor:
    """A gradient (2,h,w) with a length below 1: divided by its own and 8 grey levels more."""
    return gradient / (gradient.square().sum(0).sqrt() + SOFTNESS)


def stillness(found: Sequence[Tensor]) -> Stillness:
    """How alike the gradients (2,h,w) of two or more frames are."""
    mean, squares = torch.zeros_like(found[0]), torch.zeros_like(found[0])
    length = torch.zeros_like(found[0][0])
    for unit in map(softened, found):
        mean += unit
        squares += unit.square()
        length += unit.square().sum(0).sqrt()
    n = len(found)
    return Stillness(mean / n, squares / n, length / n, n)
