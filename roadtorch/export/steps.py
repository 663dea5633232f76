"""Twins of steps in exported graphs: torch's operators alone, on batches of any size.

A graph has sizes known at run time only, and neither Python's branches nor OpenCV and NumPy.
"""

import math
from typing import Any

import torch
from torch import Tensor

from roadtorch.base.twins import Twins
from roadtorch.imaging.color import MIN_GAMMA, MIN_VALUE, Exposure, brighten
from roadtorch.imaging.levels import descending_order, is_above, is_at_least, select
from roadtorch.imaging.resize import (
    SHORTEST,
    resize_maps,
    resize_to_image,
    round_to_pixels,
    side_length,
    spatial_size,
    triangle_weights,
)
from roadtorch.road.appearance import solve
from roadtorch.road.ego import MAX_STRIP, any_pixel, extrapolate_over_ego
from roadtorch.road.trust import (
    FULL_TRUST_PROBABILITY,
    Judgement,
    TrustFeatures,
    TrustSettings,
    estimate_trust,
    expected_f,
    float_mask,
    masked_sum,
    ratio,
    road_log_odds,
)

LONGEST = 10**9  # pixels: torch.export needs a bound

SCHULZ_STEPS = 14
"""Iterations of the inverse, enough for a condition number of 1,000."""


def round_symbol(length: Tensor, least: int = SHORTEST) -> int:
    """Round a length to whole pixels, and tell the exporter its bounds."""
    pixels: Any = length.round().clamp(min=least).to(torch.int64).item()
    torch._check(pixels >= least)
    torch._check(pixels <= LONGEST)
    return pixels


def resize_by_matrices(maps: Tensor, size: tuple[int, int]) -> Tensor:
    """Resize maps by matrix products: ONNX's operator antialiases in few runtimes (up to 0.45)."""
    rows, columns = (resize_matrix(*sides) for sides in zip(spatial_size(maps), size, strict=True))
    return rows @ maps @ columns.mT


def resize_matrix(inputs: int, outputs: int) -> Tensor:
    """Return the weights as one matrix (outputs, inputs), for sides known at run time only."""
    scale = (side_length(inputs) / side_length(outputs)).to(torch.float32)
    centre = (torch.arange(outputs) + 0.5) * scale
    return triangle_weights(torch.arange(inputs), centre, scale.clamp(min=1.0))


def select_nearest(cue: Tensor, size: tuple[int, int]) -> Tensor:
    """Resize a cue: values by matrices, labels and masks nearest."""
    if cue.is_floating_point():
        return resize_by_matrices(cue, size)
    for axis in (-2, -1):
        cue = cue.index_select(axis, torch.arange(size[axis]) * cue.shape[axis] // size[axis])
    return cue


def brighten_batch(image: Tensor, exposure: Exposure) -> Tensor:
    """Raise the median grey of each image of a batch (N, 3, H, W)."""
    lower = image[..., image.shape[-2] * 11 // 20 :, :].mean(-3).flatten(-2)
    middle = lower.sort(-1).values[..., (lower.shape[-1] - 1) // 2].clamp(0.01, 0.99)
    exponents = (math.log(exposure.ground) / middle.log()).clamp(MIN_GAMMA, 1.0)
    power = exponents[..., None, None, None]
    return torch.where(power == 1, image, image.clamp(min=MIN_VALUE) ** power)


def solve_by_products(matrix: Tensor, vector: Tensor) -> Tensor:
    """Solve A x = v for symmetric positive definite matrices, for which ONNX has no operator.

    Schulz's iteration X ← X (2 I - A X), Z. Angew. Math. Mech. 13, 1933, doubles the correct
    digits of the inverse in each step.
    """
    identity = torch.eye(matrix.shape[-1]).to(matrix)
    inverse = identity / matrix.abs().sum(-1).amax(-1)[..., None, None].clamp_min(1e-12)
    for _ in range(SCHULZ_STEPS):
        inverse = inverse @ (2 * identity - matrix @ inverse)
    return inverse @ vector


def mirror_down(maps: Tensor, ego: Tensor) -> Tensor:
    """Mirror maps (N, C, H, W) down over an ego car (N, H, W) that reaches the lower edge."""
    height = maps.shape[-2]
    rows = torch.arange(height)[:, None]
    first = height - ego.to(torch.int64).sum(1, keepdim=True)
    strip = (side_length(height) * MAX_STRIP).round().to(torch.int64).clamp(min=1)
    run = first.minimum(strip).clamp(min=1)
    step = (rows - first).clamp(min=0) % (2 * run)
    source = (first - 1 - step.minimum(2 * run - 1 - step)).clamp(min=0)
    source = torch.where(ego, source, rows)
    return maps.gather(2, source[:, None].expand(-1, maps.shape[1], -1, -1))


def estimate_batch_trust(
    features: TrustFeatures, road: Tensor, settings: TrustSettings
) -> Judgement:
    """Predict the F-score of each mask, (N,), without a reason."""
    odds: Any = road_log_odds(features)
    f: Any = expected_f(features)
    presence = (odds.sigmoid() / FULL_TRUST_PROBABILITY).clamp(max=1)
    return Judgement((presence * f.clamp(0, 1)).where(road, 0.0), "")


TWINS: Twins = {
    is_at_least: lambda values, level: values >= level,
    is_above: lambda values, level: values > level,
    select: torch.where,
    descending_order: lambda values: values.sort(descending=True).indices,  # stable in ONNX
    round_to_pixels: round_symbol,
    resize_maps: resize_by_matrices,
    resize_to_image: select_nearest,
    brighten: brighten_batch,
    solve: solve_by_products,
    any_pixel: lambda mask: True,  # a graph cannot branch
    extrapolate_over_ego: mirror_down,
    float_mask: lambda area: area.to(torch.float32),
    masked_sum: lambda values, mask: (values * mask).sum((-2, -1)),
    ratio: lambda part, whole: part / whole.clamp(min=1),
    estimate_trust: estimate_batch_trust,
}
"""Twins by the step that they stand for."""
