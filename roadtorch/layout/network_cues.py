"""From an image to a network's input, and from its outputs to layout, road and ego car. Ours."""

from collections.abc import Callable, Mapping

import torch
from torch import Tensor

from roadtorch.imaging.resize import resize_maps, round_to_pixels, side_length, spatial_size
from roadtorch.layout.backbone_network import BackboneNetwork
from roadtorch.layout.classes import NUM_CLASSES

ROAD_OUTPUT, EGO_OUTPUT = NUM_CLASSES, NUM_CLASSES + 1
"""Channels of the outputs after the classes of the layout."""

ROAD_CUES = ("road", "ego", "fused_road", "appearance")
"""Cues after the layout; the last two only where the road is fused."""

RoadFusion = Callable[[Tensor, Tensor, Tensor], Tensor]
"""Log odds of road (B, h, w), features (B, C, h, w) and images (B, 3, H, W) → log odds of the fused
road and of the appearance alone (B, 2, h, w)."""

UPPER = 0.3
"""Fraction of an image's height that is its upper part: sky, trees and roofs, hardly road."""

ROW_STEP = 8
"""Divisor of the rows of a network's input that show the upper part: its heads work at 1/8."""


@torch.no_grad()
def compute_cues(
    network: BackboneNetwork, image: Tensor, fuse: RoadFusion | None = None
) -> Mapping[str, Tensor]:
    """Return a whole-image network's ``layout`` (3, H, W), ``road`` and ``ego`` (H, W), in [0, 1].

    Of an image (3, H, W), in an exported graph of a batch. With ``fuse``, ``fused_road`` and
    ``appearance`` (H, W) as well.
    """
    settings = network.settings
    rows = count_upper_rows(settings.upper_rows, settings.height)
    small = resize_rows(image, (settings.height, settings.width), rows).clamp(0, 1)
    is_batch = small.ndim == 4
    images = small if is_batch else small[None]
    encoded = network.encode(images.to(next(network.parameters())))
    scores, features = (maps.to(image) for maps in encoded)
    potentials = scores_to_potentials(scores)
    if fuse is not None:
        road = fuse(scores[:, ROAD_OUTPUT], features, images)
        potentials = torch.cat([potentials, road.sigmoid()], 1)
    maps = potentials if is_batch else potentials[0]
    rows = rows * maps.shape[-2] // settings.height
    maps = restore_rows(maps, spatial_size(image), rows).clamp(0, 1)
    layout, planes = maps.tensor_split((NUM_CLASSES,), -3)
    return {"layout": layout, **dict(zip(ROAD_CUES, planes.unbind(-3), strict=False))}


Resize = Callable[[Tensor, tuple[int, int]], Tensor]
"""A function that resizes maps (…, H, W) to a size."""


def resize_rows(
    maps: Tensor, size: tuple[int, int], rows: int, resize: Resize = resize_maps
) -> Tensor:
    """Resize maps (…, H, W) with so many rows for the upper part; 0: as many as it has. Ours.

    So a network sees the ground, where the road is, at more pixels.
    """
    return resize_parts(maps, upper_height(maps.shape[-2]), size, rows, resize)


def restore_rows(maps: Tensor, size: tuple[int, int], rows: int) -> Tensor:
    """Resize maps (…, h, w), of which so many rows are the upper part, to an image's size."""
    return resize_parts(maps, rows, size, upper_height(size[0]) if rows else 0, resize_maps)


def count_upper_rows(fraction: float, height: int) -> int:
    """Return the rows of a network's input, a multiple of ``ROW_STEP``, nearest to a fraction."""
    return ROW_STEP * round(fraction * height / ROW_STEP)


def upper_height(height: int) -> int:
    """Return the pixels of an image's height that are its upper part."""
    return round_to_pixels(side_length(height) * UPPER, 1)


def resize_parts(
    maps: Tensor, upper: int, size: tuple[int, int], rows: int, resize: Resize
) -> Tensor:
    """Resize the upper rows of maps (…, H, W) to so many rows, the others to the rest of a size.

    With 0 rows all are resized alike.
    """
    if not rows:
        return resize(maps, size)
    numbers = torch.arange(maps.shape[-2], device=maps.device)
    top, ground = (maps.index_select(-2, part) for part in (numbers[:upper], numbers[upper:]))
    parts = resize(top, (rows, size[1])), resize(ground, (size[0] - rows, size[1]))
    return torch.cat(parts, -2)


def scores_to_potentials(scores: Tensor) -> Tensor:
    """Return potentials of scores (B, 5, …): softmax of the layout, sigmoids of road and ego."""
    return torch.cat([scores[:, :NUM_CLASSES].softmax(1), scores[:, NUM_CLASSES:].sigmoid()], 1)
