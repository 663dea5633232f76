"""Refinement of a likelihood at full size: edges of the image, no thin holes in the road."""

from collections.abc import Mapping
from typing import Annotated, Literal

import cv2
import numpy as np
import torch
from pydantic import Field
from torch import Tensor

from roadtorch.imaging.levels import is_above, is_at_least, select
from roadtorch.imaging.resize import (
    WorkingSize,
    resize_maps,
    resize_to_image,
    resize_to_work,
    round_to_pixels,
    side_length,
    spatial_size,
)
from roadtorch.layout.classes import VERTICAL
from roadtorch.road.ego import any_pixel
from roadtorch.road.seed_area import remove_isolated

Outlines = Annotated[
    Literal["guided", "smooth"],
    Field(
        description="likelihood refined at the image's edges, thin holes in the road filled "
        "(guided), or as computed (smooth)"
    ),
]

MAX_ENLARGEMENT = 8  # times the pixels of the working size

SUBSAMPLING = 2
"""Factor by which the analysed image is reduced for the guided filter."""

WINDOW_SPACING = 6
"""Distance in pixels of window centres in the reduced image."""

RIDGE = 1e-3
"""ε of the guided filter: colour variance, in [0, 1], below which an edge counts as noise."""

PASSES = 2
"""The first pass moves the likelihood to the nearest edge, the second sharpens it there."""

MAX_VERTICAL = 0.3
"""Potential of the class vertical above which edges add no road: legs, posts, wheels."""

MAX_HOLE_WIDTH = 11 / 640  # fraction of the image's width: a lane marking near the camera

HOLE_MARGIN = 1 / 255
"""Amount by which a filled hole exceeds the threshold: one level of an 8-bit map."""


def refine(
    maps: Mapping[str, Tensor], small: Tensor, image: Tensor, working: WorkingSize, threshold: float
) -> Tensor:
    """Enlarge a likelihood along the edges of the image and fill thin holes in its road.

    Only pixels whose decision changes take the filtered value: filtering all of them lowers MaxF
    on the fourteen cameras by .004. The ego car counts as no road, so that the strip of bonnet
    that its mask misses does not become road.

    maps: ``likelihood`` (h, w) and, if there are, ``layout`` (3, h, w) and ``ego``, bool (h, w).
    small: the analysed image (3, h, w). image: at full size, (3, H, W). The result has at most
    ``MAX_ENLARGEMENT`` times the pixels of ``working``.
    """
    most = MAX_ENLARGEMENT * working.pixels
    larger = resize_to_work(image, WorkingSize(pixels=most)) if image[0].numel() > most else image
    return fill_thin_holes(snap_to_edges(maps, small, larger, threshold), threshold)


def snap_to_edges(
    maps: Mapping[str, Tensor], small: Tensor, larger: Tensor, threshold: float
) -> Tensor:
    """Enlarge a likelihood along the edges of ``larger``, as ``refine`` before it fills holes."""
    likelihood = maps["likelihood"]
    if "ego" in maps and any_pixel(maps["ego"]):
        likelihood = likelihood.masked_fill(maps["ego"], 0)
    fine = guided_filter(likelihood, small, larger)
    smooth = resize_maps(likelihood, spatial_size(larger))
    is_road = is_at_least(fine, threshold)
    keeps = is_road == is_at_least(smooth, threshold)
    if "layout" in maps:
        stands = is_above(maps["layout"][..., VERTICAL, :, :], MAX_VERTICAL)
        keeps = keeps | (is_road & resize_to_image(stands, spatial_size(larger)))
    return select(keeps, smooth, fine)


def guided_filter(likelihood: Tensor, image: Tensor, larger: Tensor) -> Tensor:
    """Enlarge a likelihood (…, h, w) by the guided filter, with the image at both sizes as guide.

    In each window it is an affine function of the colour, q = a · I + b with
    a = (Σ + ε U)⁻¹ (mean(I p) - mean(I) mean(p)) and b = mean(p) - a · mean(I): He, Sun, Tang,
    "Guided Image Filtering", PAMI 35(6), 2013, eqs. 19 to 21. As in their "Fast Guided Filter",
    arXiv 1505.00996, 2015, a and b are computed in a small image and enlarged. Ours: windows are
    triangles ``WINDOW_SPACING`` apart and twice as wide, so no filter runs over all pixels.
    """
    stack = resize_maps(_stack(likelihood, image), _reduced_size(likelihood, SUBSAMPLING))
    likelihood, small = stack[..., 0, :, :], stack[..., 1:, :, :]
    cells = _reduced_size(likelihood, WINDOW_SPACING)
    first, second = UPPER_TRIANGLE
    products = small[..., first, :, :] * small[..., second, :, :]
    mean, square = resize_maps(torch.cat([small, products], -3), cells).split([3, 6], -3)
    inverse = _inverse(square - mean[..., first, :, :] * mean[..., second, :, :])
    for guide in [*[small] * (PASSES - 1), larger]:
        joint = resize_maps(_stack(likelihood, small * likelihood[..., None, :, :]), cells)
        road, joint = joint.split([1, 3], -3)
        slope = (inverse * (joint - mean * road).unsqueeze(-4)).sum(-3)
        offset = road.squeeze(-3) - (slope * mean).sum(-3)
        slopes, likelihood = (resize_maps(part, spatial_size(guide)) for part in (slope, offset))
        for weight, plane in zip(slopes.unbind(-3), guide.unbind(-3), strict=True):
            likelihood.addcmul_(weight, plane)
        likelihood.clamp_(0, 1)
    return likelihood


UPPER_TRIANGLE = tuple(torch.triu_indices(3, 3))
"""Rows and columns of the upper triangle of a symmetric matrix (3, 3)."""

SYMMETRIC = torch.tensor([[0, 1, 2], [1, 3, 4], [2, 4, 5]])
"""Position of each element of the matrix in its upper triangle."""


def _stack(map: Tensor, planes: Tensor) -> Tensor:
    return torch.cat([map[..., None, :, :], planes], -3)


def _inverse(covariance: Tensor) -> Tensor:
    """Return (Σ + εU)⁻¹, (…, 3, 3, h, w), for covariances Σ (…, 6, h, w), from their minors."""
    a, b, c, d, e, f = covariance.unbind(-3)
    a, d, f = a + RIDGE, d + RIDGE, f + RIDGE
    first, second, third = d * f - e * e, c * e - b * f, b * e - c * d
    fourth, fifth, sixth = a * f - c * c, b * c - a * e, a * d - b * b
    minors = torch.stack([first, second, third, fourth, fifth, sixth], -3)
    determinant = a * first + b * second + c * third
    return (minors / determinant.unsqueeze(-3))[..., SYMMETRIC, :, :]


def _reduced_size(map: Tensor, factor: int) -> tuple[int, int]:
    """Return the size of a map (…, H, W) reduced by a factor, at least 2×2."""
    height, width = (round_to_pixels(side_length(n) / factor, 2) for n in spatial_size(map))
    return height, width


def fill_thin_holes(likelihood: Tensor, threshold: float) -> Tensor:
    """Raise thin non-road holes inside the road to just above the threshold.

    Lane markings, letters and joints are road although they look different. A hole is thin where
    no square of ``MAX_HOLE_WIDTH`` fits, if one fits anywhere; the image border encloses holes.
    Source: opening by reconstruction, Vincent, "Morphological Grayscale Reconstruction", IEEE
    Trans. Image Proc. 2(2), 1993.

    Args:
        likelihood: road likelihood in [0, 1], shape (H, W).
        threshold: likelihood from which a pixel is road.

    Returns:
        The likelihood, shape (H, W); the input itself where nothing changed.
    """
    mask = is_at_least(likelihood, threshold).cpu().contiguous().numpy()
    rows = np.flatnonzero(mask.any(1))
    side = max(2, round(MAX_HOLE_WIDTH * mask.shape[1]))
    if not len(rows):
        return likelihood
    below = slice(max(0, int(rows[0]) - side), None)  # all above is background without holes
    background = ~mask[below]
    wide = cv2.erode(background.view(np.uint8), np.ones((side, side), np.uint8)).view(bool)
    if not wide.any():
        return likelihood
    full = torch.from_numpy(background)
    opened = remove_isolated(full, torch.from_numpy(wide))
    if opened is full:
        return likelihood
    closed = likelihood.cpu().numpy().copy()
    np.copyto(closed[below], min(1.0, threshold + HOLE_MARGIN), where=full.numpy() > opened.numpy())
    return torch.from_numpy(closed).to(likelihood.device)
