"""Outlines: a likelihood enlarged as the image's edges are, without thin holes in its road."""

from collections.abc import Callable, Mapping
from typing import Annotated, Literal

import cv2
import numpy as np
import torch
from pydantic import Field
from torch import Tensor

from roadtorch.imaging.levels import at_least
from roadtorch.imaging.resize import WorkingSize, at_work, resized, side, size_of, whole
from roadtorch.road.seed_area import remove_isolated

Outlines = Annotated[
    Literal["guided", "smooth"],
    Field(description="guided by the image, without thin holes; or smooth, as they were found"),
]

MAX_ENLARGEMENT = 8  # times the pixels of the working size: 640x480, of 240x180

SUBSAMPLING = 2
"""Pixels of the analysed image, along a side, to one of that from which windows are made."""

CELL = 6  # such pixels between the centres of two windows: with the above, the side of a superpixel

RIDGE = 1e-3
"""Variance of a colour, in [0,1], below which it is grain that a likelihood does not follow."""

PASSES = 2
"""The first brings the likelihood to the nearest edge, the second parts the sides of the edge."""

THIN = 11 / 640  # share of the image's width up to which a hole is thin: a line near the camera

BARELY = 1 / 255
"""By which a hole is above the threshold: the least that an image of 8 bits can say."""


def guided(
    maps: Mapping[str, Tensor], small: Tensor, image: Tensor, working: WorkingSize, threshold: float
) -> Tensor:
    """The likelihood of the maps of a small image (3,h,w), as large as it is worth.

    image: the same (3,H,W) at the image's own size. working: the size of the small one.
    threshold: road from this likelihood on.

    It follows the image where that decides otherwise, and stays as it is elsewhere: smoothed all
    over, MaxF on the fourteen cameras falls by .004. At most ``MAX_ENLARGEMENT`` times the working
    size's pixels: beyond that, an image shows but grain. The ego car is no road here, in its own
    looks: so what is left of its bonnet above the map of it does not become road.
    """
    return filled(outlined(maps, small, image, working, threshold), threshold)


def outlined(
    maps: Mapping[str, Tensor], small: Tensor, image: Tensor, working: WorkingSize, threshold: float
) -> Tensor:
    """The same but for its last step: thin holes are still there.

    In an exported graph it is as large as the image, and may be one of a batch.
    """
    more = working.model_copy(update={"pixels": MAX_ENLARGEMENT * working.pixels})
    is_small = torch.compiler.is_exporting() or image[0].numel() <= more.pixels
    larger = image if is_small else at_work(image, more)
    likelihood = maps["likelihood"]
    if "ego" in maps:
        likelihood = likelihood.masked_fill(maps["ego"], 0)
    fine = followed(likelihood, small, larger)
    before = resized(likelihood, size_of(larger))
    same = at_least(fine, threshold) == at_least(before, threshold)
    return torch.where(same, before, fine)


def followed(likelihood: Tensor, image: Tensor, larger: Tensor) -> Tensor:
    """A likelihood (…,h,w) of an image (…,3,h,w) in a larger one (…,3,H,W): (…,H,W), in [0,1].

    In each window it is an affine function of the colour, q = a · I + b with
    a = (Σ + ε U)⁻¹ (mean(I p) - mean(I) mean(p)) and b = mean(p) - a · mean(I): the guided filter
    of He, Sun, Tang, "Guided Image Filtering", PAMI 35(6), 2013, eqs. 19 to 21. As in their "Fast
    Guided Filter", arXiv 1505.00996, 2015, a and b are found in a small image and enlarged. Ours:
    windows are triangles ``CELL`` apart and twice as wide, so no filter runs over all pixels.
    """
    both = resized(_joined(likelihood, image), _size(likelihood, SUBSAMPLING))
    likelihood, small = both[..., 0, :, :], both[..., 1:, :, :]
    cells = _size(likelihood, CELL)
    first, second = SYMMETRIC
    products = small[..., first, :, :] * small[..., second, :, :]
    mean, square = resized(torch.cat([small, products], -3), cells).split([3, 6], -3)
    inverse = _inverse(square - mean[..., first, :, :] * mean[..., second, :, :])
    for target in [*[small] * (PASSES - 1), larger]:
        joint = resized(_joined(likelihood, small * likelihood[..., None, :, :]), cells)
        road, joint = joint.split([1, 3], -3)
        slope = inverse(joint - mean * road)
        offset = road.squeeze(-3) - (slope * mean).sum(-3)
        slopes, likelihood = (resized(part, size_of(target)) for part in (slope, offset))
        for weight, plane in zip(slopes.unbind(-3), target.unbind(-3), strict=True):
            likelihood.addcmul_(weight, plane)
        likelihood.clamp_(0, 1)
    return likelihood


SYMMETRIC = tuple(torch.triu_indices(3, 3))
"""Rows and columns of the upper triangle of a symmetric matrix (3,3)."""


def _joined(map: Tensor, planes: Tensor) -> Tensor:
    return torch.cat([map[..., None, :, :], planes], -3)


def _inverse(spread: Tensor) -> Callable[[Tensor], Tensor]:
    """What multiplies vectors (…,3,h,w) by the inverse of a covariance (…,6,h,w) plus ``RIDGE``."""
    if torch.compiler.is_exporting():  # ONNX inverts no matrices: by minors
        a, b, c, d, e, f = spread.unbind(-3)
        a, d, f = a + RIDGE, d + RIDGE, f + RIDGE
        first, second, third = d * f - e * e, c * e - b * f, b * e - c * d
        fourth, fifth, sixth = a * f - c * c, b * c - a * e, a * d - b * b
        minors = torch.stack([first, second, third, fourth, fifth, sixth], -3)
        six = (minors / (a * first + b * second + c * third)[..., None, :, :]).unbind(-3)
        rows = [torch.stack([six[n] for n in row], -3) for row in ((0, 1, 2), (1, 3, 4), (2, 4, 5))]
        return lambda vectors: torch.stack([(row * vectors).sum(-3) for row in rows], -3)
    first, second = SYMMETRIC
    matrix = spread.new_empty(3, 3, *size_of(spread))
    matrix[first, second] = matrix[second, first] = spread
    ridge = RIDGE * torch.eye(3, dtype=spread.dtype, device=spread.device)
    inverse = torch.linalg.inv(matrix.permute(2, 3, 0, 1) + ridge)
    return lambda vectors: (inverse @ vectors.permute(1, 2, 0)[..., None])[..., 0].permute(2, 0, 1)


def _size(of: Tensor, times: int) -> tuple[int, int]:
    """So many times less on each side than a map (…,H,W), and two at least."""
    height, width = (whole(side(length) / times, 2) for length in size_of(of))
    return height, width


def filled(likelihood: Tensor, threshold: float) -> Tensor:
    """A likelihood (H,W) without the holes in its road where no square of ``THIN`` fits into one.

    Lines, letters and joints are road, though they look like nothing else on it: they become road
    by ``BARELY``. What lies at the image's edge counts as enclosed there. A reconstruction of the
    background from its erosion: Vincent, "Morphological Grayscale Reconstruction", IEEE Trans.
    Image Proc. 2(2), 1993.
    """
    mask = at_least(likelihood, threshold).cpu().contiguous().numpy()
    rows = np.flatnonzero(mask.any(1))
    side = max(2, round(THIN * mask.shape[1]))
    if not len(rows):
        return likelihood
    below = slice(max(0, int(rows[0]) - side), None)  # what is above is one with its lowest rows
    background = ~mask[below]
    wide = cv2.erode(background.view(np.uint8), np.ones((side, side), np.uint8)).view(bool)
    if not wide.any():
        return likelihood
    before = torch.from_numpy(background)
    left = remove_isolated(before, torch.from_numpy(wide))
    if left is before:
        return likelihood
    closed = likelihood.clone()
    holes = (before & ~left).to(likelihood.device)
    closed[below].masked_fill_(holes, min(1.0, threshold + BARELY))
    return closed
