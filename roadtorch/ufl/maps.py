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
from roadtorch.ufl.features import DictionarySettings, learn_dictionary, white_patches
from roadtorch.ufl.preprocess import Smoothing, equalised

BLOCK = 16
"""Bases whose maps are held at a time; maps that are not selected are never kept."""

MIN_RESPONSE = 0.01
"""The least maximum of a map, in distances between white patches; real ones have 1 and more.
Below it there is only rounding, as in an image of one colour."""

RowWeights = Literal["centred", "from_one"]


class MapSettings(Settings):
    """Encoding, scoring and selection of the feature maps."""

    encoder: Literal["base", "patch"] = Field(
        default="base",
        description="a distance is compared with the mean of its base (eq. 4) or patch (eq. 3)",
    )
    row_weights: RowWeights = Field(
        default="centred",
        description="eq. 5: row - H/2 counted from the middle row (program), or from 1 (text)",
    )
    share: float = Field(
        default=0.2, gt=0, le=1, description="share of the maps that is selected, the best ones"
    )
    scale: Literal["maximum", "none"] = Field(
        default="maximum",
        description="what the mean map is divided by: its maximum (program), or nothing (text)",
    )


@dataclass(frozen=True)
class FeatureMaps:
    """The selected maps (m,H,W) in [0,1], best first, and where they come from.

    order: int64 (K,), all bases by falling score; scores: (K,), by base.
    """

    maps: Tensor
    order: Tensor
    scores: Tensor


def make_encoder(
    patches: Tensor, dictionary: Tensor, kind: Literal["base", "patch"] = "base"
) -> Callable[[Tensor], Tensor]:
    """What encodes patches (n,d): bases (k,d) → responses (k,n) ≥ 0.

    How much nearer than usual each patch is to each base: than all patches are to the base (eq. 4,
    ``base``), or than the patch is to all bases of the dictionary (eq. 3, ``patch``).
    """
    squares = patches.square().sum(1, keepdim=True)
    points = torch.cat([patches, squares, torch.ones_like(squares)], 1)

    def distances(bases: Tensor) -> Tensor:
        """(k,n), by one matrix product: |x-c|² = x·x + c·c - 2 x·c, at least 0."""
        sizes = bases.square().sum(1, keepdim=True)
        planes = torch.cat([-2 * bases, torch.ones_like(sizes), sizes], 1)
        return (planes @ points.T).clamp_min_(0).sqrt_()

    total = torch.zeros_like(squares[:, 0])
    for bases in dictionary.split(BLOCK) if kind == "patch" else ():
        total += distances(bases).sum(0)

    def encode(bases: Tensor) -> Tensor:
        far = distances(bases)
        usual = total / len(dictionary) if kind == "patch" else far.mean(1, keepdim=True)
        return torch.sub(usual, far, out=far).clamp_min_(0)

    return encode


def divisor(responses: Tensor) -> Tensor:
    """What scales responses (k,n) ≥ 0 to [0,1]: the maximum of each map, (k,); faint ones to 0."""
    top = responses.amax(1)
    return torch.where(top > MIN_RESPONSE, top, torch.inf)


def row_weights(rows: int, kind: RowWeights) -> Tensor:
    """The weights of eq. 5, (rows,) float64; ``centred`` in rows, ``from_one`` in (-1,1]."""
    row = torch.arange(rows, dtype=torch.float64)
    if kind == "centred":
        return row - rows // 2
    return (row + 1 - rows / 2) / (rows / 2)


def score_maps(responses: Tensor, weights: Tensor) -> Tensor:
    """Eq. 5: scores (k,) of responses (k,n), scaled to [0,1], with a weight for each pixel (n,)."""
    return (responses @ weights.to(responses)) / divisor(responses)


def select_maps(
    patches: Tensor, dictionary: Tensor, size: tuple[int, int], settings: MapSettings
) -> FeatureMaps:
    """Encode, score and keep the best maps; size: rows and columns of the maps.

    The selected maps are encoded twice, so that the others need no room.
    """
    encode = make_encoder(patches, dictionary, settings.encoder)
    weights = row_weights(size[0], settings.row_weights).repeat_interleave(size[1])
    scores = torch.cat([score_maps(encode(bases), weights) for bases in dictionary.split(BLOCK)])
    order = scores.argsort(descending=True, stable=True)
    best = encode(dictionary[order[: max(1, int(len(order) * settings.share + 0.5))]])
    return FeatureMaps((best / divisor(best)[:, None]).view(-1, *size), order, scores)


def mean_map(maps: Tensor, scale: Literal["maximum", "none"]) -> Tensor:
    """The mean (H,W) in [0,1] of maps (m,H,W), with ``maximum`` over its own maximum."""
    mean = maps.mean(0)
    if scale == "none":
        return mean
    top = mean.max()
    return mean / top if top > 0 else mean


@dataclass(frozen=True)
class LearnedFeatures:
    """What is learned from one image, before any road is looked for.

    even: (3,H,W), equalised. patches: (n,d), white. dictionary: (K,d). maps: the selected ones,
    of ``size`` rows and columns.
    """

    even: Tensor
    patches: Tensor
    dictionary: Tensor
    maps: FeatureMaps
    size: tuple[int, int]


def learn_features(
    image: Tensor, smoothing: Smoothing, dictionary: DictionarySettings, maps: MapSettings
) -> LearnedFeatures:
    """Preprocessing, dictionary and feature maps of an image (3,H,W) (P1, sections II.A, B)."""
    even = equalised(image, smoothing)
    patches = white_patches(even, dictionary)
    bases = learn_dictionary(patches, dictionary)
    size = (image.shape[1] - dictionary.side + 1, image.shape[2] - dictionary.side + 1)
    return LearnedFeatures(even, patches, bases, select_maps(patches, bases, size, maps), size)


def dictionary_image(
    dictionary: Tensor, order: Tensor, side: int, shape: tuple[int, ...]
) -> Tensor:
    """The bases (K,d) as small RGB images in one, by falling score (P1, Fig. 3): (3,h,w)."""
    tiles = dictionary[order].view(-1, 3, side, side)
    low, high = tiles.amin((1, 2, 3), keepdim=True), tiles.amax((1, 2, 3), keepdim=True)
    return mosaic((tiles - low) / torch.where(high > low, high - low, 1), shape)


def mosaic(tiles: Tensor, shape: tuple[int, ...]) -> Tensor:
    """Tiles (k,C,h,w) side by side in reading order, on black: (C,rows·h,columns·w).

    As many in a row as bring the whole near to the shape, given as height and width.
    """
    from skimage.util import montage  # late: half a second that only these images need

    count, channels, height, width = tiles.shape
    columns = round(math.sqrt(count * height * shape[1] / (width * shape[0])))
    columns = min(max(1, columns), count)
    rows = -(-count // columns)
    pixels = tiles.movedim(1, -1).cpu().numpy()
    board = montage(pixels, [0] * channels, grid_shape=(rows, columns), channel_axis=-1)
    return torch.from_numpy(board).movedim(-1, 0).contiguous().to(tiles.device)
