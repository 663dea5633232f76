"""Feature maps: patches encoded by a dictionary, scored and selected (P1, eqs. 3 to 5).

``learn_features`` is all of sections II.A and B; Figs. 3 and 4 show bases and maps as images.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import torch
from pydantic import Field
from torch import Tensor

from roadtorch.base.settings import Settings
from roadtorch.ufl.features import DictionarySettings, learn_dictionary, whiten_patches
from roadtorch.ufl.preprocess import Smoothing, equalise

BASIS_BLOCK = 16
"""Bases whose maps are in memory at a time; maps that are not selected are discarded."""

MIN_MAXIMUM = 0.01  # least maximum of a map; smaller ones are rounding; real maps reach 1 and more

RowWeights = Literal["centred", "from_one"]


class MapSettings(Settings):
    """Settings of the encoding, scoring and selection of feature maps."""

    encoder: Literal["base", "patch"] = Field(
        default="base",
        description="mean distance of the base (eq. 4) or patch (eq. 3), minus the distance",
    )
    row_weights: RowWeights = Field(
        default="centred",
        description="eq. 5, row - H/2: from the middle row (program), or rows from 1 (paper)",
    )
    fraction: float = Field(
        default=0.2, gt=0, le=1, description="fraction of the maps that is selected, the best ones"
    )
    scale: Literal["maximum", "none"] = Field(
        default="maximum",
        description="divisor of the mean map: its maximum (the authors' program), or none",
    )


@dataclass(frozen=True, eq=False)
class FeatureMaps:
    """Selected maps (m, H, W) in [0, 1], the best first.

    ``order`` has all bases by falling score, int64 (K,); ``scores`` the score of each base, (K,).
    """

    maps: Tensor
    order: Tensor
    scores: Tensor


def make_encoder(
    patches: Tensor, dictionary: Tensor, variant: Literal["base", "patch"] = "base"
) -> Callable[[Tensor], Tensor]:
    """Return the function that encodes patches: bases (k, d) → responses (k, n) ≥ 0.

    A response is how much nearer than average a patch (n, d) is to a base: than all patches are to
    the base (eq. 4, ``base``), or than this patch is to all bases (eq. 3, ``patch``).
    """
    squares = patches.square().sum(1, keepdim=True)
    points = torch.cat([patches, squares, torch.ones_like(squares)], 1)

    def distances(bases: Tensor) -> Tensor:  # (k, n), as |x-c|² = x·x + c·c - 2 x·c
        sizes = bases.square().sum(1, keepdim=True)
        planes = torch.cat([-2 * bases, torch.ones_like(sizes), sizes], 1)
        return (planes @ points.T).clamp_min_(0).sqrt_()

    total = torch.zeros_like(squares[:, 0])
    for bases in dictionary.split(BASIS_BLOCK) if variant == "patch" else ():
        total += distances(bases).sum(0)

    def encode(bases: Tensor) -> Tensor:
        distance = distances(bases)
        mean = total / len(dictionary) if variant == "patch" else distance.mean(1, keepdim=True)
        return torch.sub(mean, distance, out=distance).clamp_min_(0)

    return encode


def response_scale(responses: Tensor) -> Tensor:
    """Return divisors (k,) that scale responses (k, n) to [0, 1]; infinite for faint ones."""
    top = responses.amax(1)
    return torch.where(top > MIN_MAXIMUM, top, torch.inf)


def row_weights(rows: int, variant: RowWeights) -> Tensor:
    """Return the weights of eq. 5, float64 (rows,): in rows, or in (-1, 1] for ``from_one``."""
    row = torch.arange(rows, dtype=torch.float64)
    if variant == "centred":
        return row - rows // 2
    return (row + 1 - rows / 2) / (rows / 2)


def score_maps(responses: Tensor, weights: Tensor) -> Tensor:
    """Return the scores (k,) of responses (k, n) with pixel weights (n,), by eq. 5."""
    return (responses @ weights.to(responses)) / response_scale(responses)


def select_maps(
    patches: Tensor, dictionary: Tensor, size: tuple[int, int], settings: MapSettings
) -> FeatureMaps:
    """Encode, score and select the best maps; ``size`` is their rows and columns.

    Selected maps are encoded twice, so that the rest needs no memory.
    """
    encode = make_encoder(patches, dictionary, settings.encoder)
    weights = row_weights(size[0], settings.row_weights).repeat_interleave(size[1])
    blocks = dictionary.split(BASIS_BLOCK)
    scores = torch.cat([score_maps(encode(bases), weights) for bases in blocks])
    order = scores.argsort(descending=True, stable=True)
    best = encode(dictionary[order[: max(1, int(len(order) * settings.fraction + 0.5))]])
    return FeatureMaps((best / response_scale(best)[:, None]).view(-1, *size), order, scores)


def mean_map(maps: Tensor, scale: Literal["maximum", "none"]) -> Tensor:
    """Return the mean (H, W) in [0, 1] of maps (m, H, W), for ``maximum`` over its own maximum."""
    mean = maps.mean(0)
    if scale == "none":
        return mean
    top = mean.max()
    return mean / top if top > 0 else mean


@dataclass(frozen=True, eq=False)
class LearnedFeatures:
    """Features learned from one image.

    ``equalised`` is the image (3, H, W), ``patches`` are white (n, d), ``dictionary``
    has the bases (K, d), ``size`` the rows and columns of the selected maps.
    """

    equalised: Tensor
    patches: Tensor
    dictionary: Tensor
    maps: FeatureMaps
    size: tuple[int, int]


def learn_features(
    image: Tensor, smoothing: Smoothing, dictionary: DictionarySettings, maps: MapSettings
) -> LearnedFeatures:
    """Preprocess an image (3, H, W) and learn its features (P1, sections II.A and B)."""
    equalised = equalise(image, smoothing)
    patches = whiten_patches(equalised, dictionary)
    bases = learn_dictionary(patches, dictionary)
    size = (image.shape[1] - dictionary.side + 1, image.shape[2] - dictionary.side + 1)
    return LearnedFeatures(equalised, patches, bases, select_maps(patches, bases, size, maps), size)


def dictionary_image(
    dictionary: Tensor, order: Tensor, side: int, shape: tuple[int, ...]
) -> Tensor:
    """Return the bases (K, d) as tiles of an RGB image (3, h, w), by falling score (P1, Fig. 3)."""
    tiles = dictionary[order].view(-1, 3, side, side)
    low, high = tiles.amin((1, 2, 3), keepdim=True), tiles.amax((1, 2, 3), keepdim=True)
    return mosaic((tiles - low) / torch.where(high > low, high - low, 1), shape)


def mosaic(tiles: Tensor, shape: tuple[int, ...]) -> Tensor:
    """Arrange tiles (k, C, h, w) in row-major order on black: (C, rows·h, columns·w).

    The number of columns is chosen to approximate the aspect ratio of ``shape``, height and width.
    """
    from skimage.util import montage  # slow to import

    count, channels, height, width = tiles.shape
    columns = round(math.sqrt(count * height * shape[1] / (width * shape[0])))
    columns = min(max(1, columns), count)
    rows = -(-count // columns)
    pixels = tiles.movedim(1, -1).cpu().numpy()
    board = montage(pixels, [0] * channels, grid_shape=(rows, columns), channel_axis=-1)
    return torch.from_numpy(board).movedim(-1, 0).contiguous().to(tiles.device)
