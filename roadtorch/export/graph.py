"""Networks from bytes to maps of the picture's size, as modules that can be exported. Ours.

The steps are those of ``PictureNetwork.cues`` and of ``layout:cnn-7``, for a batch, and written
without what a graph cannot hold: branches on values, OpenCV, NumPy. That they say the same is
checked whenever something is exported (see ``parity``).

Pictures are resized by matrix products, not by the operator for it: ONNX Runtime's averages as
torch does, OpenVINO's reads the same file and does not (up to 0.45 off in a trial).
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import torch
from torch import Tensor, nn

from roadtorch.detectors.fusion import FusionSettings, calibrated
from roadtorch.imaging.color import DARKEST, STRONGEST, Exposure
from roadtorch.imaging.resize import SHORTEST, WorkingSize
from roadtorch.layout.classes import CLASSES, HORIZONTAL
from roadtorch.layout.patch_network import (
    FIXED_GAIN,
    FIXED_MEAN,
    MIN_DEVIATION,
    Normalisation,
    PatchNetwork,
)
from roadtorch.layout.picture_network import EGO, potentials_of
from roadtorch.layout.weights import WholePictureNetwork
from roadtorch.road.ego import MIN_FREE, MIN_MEAN, PER_SHARE, SOLID, STRIP
from roadtorch.road.fusion import log_odds
from roadtorch.road.outlines import CELL, PASSES, RIDGE, SUBSAMPLING
from roadtorch.road.seed_area import CELL as SEED_CELL
from roadtorch.road.seed_area import NEARNESS, UPPER_HALF
from roadtorch.road.trust import (
    CONSTANT,
    ENOUGH,
    LOW_AND_HIGH,
    ROAD_STEADY,
    ROAD_THERE,
    ROAD_VAGUE,
    WEIGHTS,
    entropy,
)

MAX_SIDE = 10**5
"""Pixels of a side at most, so that sizes have a bound when a graph is made."""

OUTPUTS: Mapping[str, str] = {
    "likelihood": "float32 (N, H, W): how road-like each pixel is, 0 to 1",
    "layout": "float32 (N, 3, H, W): sky, vertical, horizontal, 0 to 1",
    "ego": "float32 (N, H, W): the vehicle that carries the camera, 0 to 1",
    "seed_area": "float32 (N, H, W): where road surely is, 0 or 1; isolated road does not touch it",
    "trust": "float32 (N): the F to expect of the mask, 0 to 1",
}
"""What graphs give, by name."""


class FusedRoad(nn.Module):
    """``fusion`` for bytes: likelihood, layout, ego, seed area, trust.

    All of the detector but what takes connected regions: thin holes are not filled, and isolated
    road is not dropped. Pictures are followed at their own size, however large that is.
    """

    outputs = ("likelihood", "layout", "ego", "seed_area", "trust")

    def __init__(
        self,
        network: WholePictureNetwork,
        second: WholePictureNetwork | None,
        settings: FusionSettings,
    ) -> None:
        super().__init__()
        self.network = network
        self.second = second
        self.settings = settings

    def forward(self, image: Tensor) -> tuple[Tensor, ...]:
        """Maps (N,H,W), but for the layout (N,3,H,W), and (N,), of pictures uint8 (N,H,W,3)."""
        settings = self.settings
        planes = planes_of(image)
        full = (planes.shape[-2], planes.shape[-1])
        small = averaged(planes, *size_at_work(planes, settings.working)).clamp(0, 1)
        maps = looks(self.network, small, settings.cuts)
        if self.second is not None:
            other = looks(self.second, small, settings.cuts)
            pooled = torch.lerp(maps, other, settings.second.share)
            maps = torch.cat([pooled[:, :EGO], maps[:, EGO:]], 1)
        ego = ego_columns(maps[:, EGO])
        layout, road, _ = continued_down(maps, ego).split([CLASSES, 1, 1], 1)
        odds = log_odds(road[:, 0])
        likelihood = calibrated(odds, settings.calibration)
        free = likelihood.masked_fill(ego, 0)
        before = averaged(free[:, None], *full)[:, 0]
        fine = followed_by_all(free, small, planes)
        same = (fine >= settings.threshold) == (before >= settings.threshold)
        hidden = nearest(ego, *full)
        fine = torch.where(same, before, fine).masked_fill(hidden, 0)
        mask = nearest(fine >= settings.threshold, *small.shape[-2:])
        seed = seed_cells(odds, settings.seed_area.share)
        trust = trust_of(likelihood, mask, ego, mean_over(road[:, 0], seed))
        areas = (area.to(fine.dtype) for area in (hidden, nearest(seed, *full)))
        return fine, averaged(layout, *full), *areas, trust


class EveryPixel(nn.Module):
    """``layout:cnn-7`` for bytes: likelihood, layout."""

    outputs = ("likelihood", "layout")

    def __init__(self, network: PatchNetwork, working: WorkingSize) -> None:
        super().__init__()
        self.network = network
        self.working = working

    def forward(self, image: Tensor) -> tuple[Tensor, Tensor]:
        """Maps (N,H,W) and (N,3,H,W) of pictures uint8 (N,H,W,3) RGB."""
        planes = planes_of(image)
        small = averaged(planes, *size_at_work(planes, self.working)).clamp(0, 1)
        found = self.network.dense(normalised(small, self.network.settings.normalisation))
        layout = averaged(found, planes.shape[-2], planes.shape[-1])
        return layout[:, HORIZONTAL], layout


Graph = FusedRoad | EveryPixel
"""A module that can be exported; ``outputs`` are the names of what it gives."""


# --- before and behind the network ------------------------------------------------------


def potentials(network: WholePictureNetwork, images: Tensor) -> Tensor:
    """Potentials (N,5,h,w) of images (N,3,H,W) in [0,1], at the size at which the network sees."""
    settings = network.settings
    seen = averaged(images, settings.height, settings.width).clamp(0, 1)
    return potentials_of(network(normalised(seen, settings.normalisation)))


def looks(network: WholePictureNetwork, images: Tensor, cuts: Sequence[float]) -> Tensor:
    """``fusion.seen_closer`` of images (N,3,H,W) in [0,1]: potentials (N,5,H,W)."""
    height, width = images.shape[-2], images.shape[-1]
    maps = averaged(potentials(network, images), height, width).clamp(0, 1)
    count = torch.ones(height, 1)
    for cut in cuts:
        rows = _length(torch.scalar_tensor(height, dtype=torch.float64) * (1 - cut), 1)
        place = torch.arange(height) - (height - rows)
        lower = images.index_select(2, torch.arange(rows) + (height - rows))
        seen = averaged(potentials(network, lower), rows, width).clamp(0, 1)
        there = (place >= 0).to(maps.dtype)[:, None]
        maps = maps + seen.index_select(2, place.clamp(min=0)) * there
        count = count + there
    return maps / count


def planes_of(image: Tensor) -> Tensor:
    """Pictures uint8 (N,H,W,3) as float32 (N,3,H,W) in [0,1]."""
    return image.permute(0, 3, 1, 2).to(torch.float32) / 255


def averaged(maps: Tensor, height: int, width: int) -> Tensor:
    """Maps (N,C,H,W) at another size, as ``working_size.resized``: averaged or bilinear."""
    rows = averaging(maps.shape[-2], height)
    columns = averaging(maps.shape[-1], width)
    return rows @ maps @ columns.mT


def averaging(before: int, after: int) -> Tensor:
    """The matrix (after, before) that resizes a column of pixels.

    Each row is a triangle over its sum, around the place of its pixel and two pixels wide, old or
    new ones, whichever are wider: Pillow's and torch's antialiased bilinear filter.
    """
    scale = torch.scalar_tensor(before) / torch.scalar_tensor(after)
    centre = (torch.arange(after) + 0.5) * scale
    away = (torch.arange(before) + 0.5 - centre[:, None]).abs()
    triangle = (1 - away / scale.clamp(min=1.0)).clamp(min=0.0)
    return triangle / triangle.sum(1, keepdim=True)


def size_at_work(planes: Tensor, working: WorkingSize) -> tuple[int, int]:
    """``working_size.working_size`` of pictures (N,3,H,W) whose size is known only at run time."""
    height, width = (torch.scalar_tensor(side, dtype=torch.float64) for side in planes.shape[-2:])
    scale = (working.pixels / (height * width)).sqrt().clamp(max=1.0)
    return _length(height * scale), _length(width * scale)


def _length(side: Tensor, least: int = SHORTEST) -> int:
    """A side, a scalar, in whole pixels, whose bounds a graph knows."""
    length: Any = side.round().clamp(min=least).to(torch.int64).item()
    torch._check(length >= least)
    torch._check(length <= MAX_SIDE)
    return length


def normalised(images: Tensor, normalisation: Normalisation) -> Tensor:
    """``normalisation.normalise`` for images (N,3,H,W) in [0,1]."""
    if normalisation.kind == "none":
        return images
    if normalisation.kind.startswith("brightened"):
        images = brightened_alike(images, normalisation.exposure)
    if normalisation.kind.endswith("picture"):
        apart = images - images.mean((2, 3), keepdim=True)
        deviation = apart.square().mean((1, 2, 3), keepdim=True).sqrt()
        return apart / deviation.clamp(min=MIN_DEVIATION)
    return (images - FIXED_MEAN) * FIXED_GAIN


def brightened_alike(images: Tensor, exposure: Exposure) -> Tensor:
    """``exposure.brightened`` for images (N,3,H,W) in [0,1], each by its own exponent."""
    lower = images[:, :, images.shape[-2] * 11 // 20 :].mean(1).flatten(1)
    grey = lower.sort(1).values[:, (lower.shape[1] - 1) // 2].clamp(0.01, 0.99)
    exponent = (math.log(exposure.ground) / grey.log()).clamp(STRONGEST, 1.0)[:, None, None, None]
    return torch.where(exponent == 1, images, images.clamp(min=DARKEST) ** exponent)


# --- what fusion does with the network's maps -------------------------------------------


def ego_columns(potential: Tensor) -> Tensor:
    """``ego_found`` of potentials (N,h,w): bool (N,h,w)."""
    height, width = potential.shape[-2:]
    ego = potential > 0.5
    below = ego.to(torch.float32).flip(1).cumsum(1).flip(1)
    left = torch.arange(height, 0, -1)[:, None]
    car = (ego & (below >= SOLID * left)).to(torch.float32).cumsum(1) > 0
    weights = car.to(potential.dtype)
    size = weights.sum((1, 2))
    share = size / (height * width)
    mean = (potential * weights).sum((1, 2)) / size.clamp(min=1)
    there = (share <= 1 - MIN_FREE) & (mean >= MIN_MEAN + PER_SHARE * share)
    return car & there[:, None, None]


def continued_down(maps: Tensor, ego: Tensor) -> Tensor:
    """``continued`` of maps (N,C,h,w) over an ego car (N,h,w) that goes down to the lower edge."""
    height = maps.shape[-2]
    rows = torch.arange(height)[:, None]
    first = height - ego.to(torch.int64).sum(1, keepdim=True)
    strip = (torch.scalar_tensor(height) * STRIP).round().to(torch.int64).clamp(min=1)
    run = first.minimum(strip).clamp(min=1)
    step = (rows - first).clamp(min=0) % (2 * run)
    source = (first - 1 - step.minimum(2 * run - 1 - step)).clamp(min=0)
    source = torch.where(ego, source, rows)
    return maps.gather(2, source[:, None].expand(-1, maps.shape[1], -1, -1))


def followed_by_all(likelihood: Tensor, small: Tensor, planes: Tensor) -> Tensor:
    """``outlines.followed`` of likelihoods (N,h,w), images (N,3,h,w) and (N,3,H,W): (N,H,W)."""
    both = averaged(torch.cat([likelihood[:, None], small], 1), *_shorter(likelihood, SUBSAMPLING))
    likelihood, small = both[:, 0], both[:, 1:]
    cells = _shorter(likelihood, CELL)
    first, second = SIX
    mean, square = averaged(
        torch.cat([small, small[:, first] * small[:, second]], 1), *cells
    ).split([3, 6], 1)
    inverse = inverted(square - mean[:, first] * mean[:, second])
    for picture in [*[small] * (PASSES - 1), planes]:
        road, joint = averaged(
            torch.cat([likelihood[:, None], small * likelihood[:, None]], 1), *cells
        ).split([1, 3], 1)
        shared = joint - mean * road
        slope = torch.stack([(row * shared).sum(1) for row in inverse], 1)
        offset = road - (slope * mean).sum(1, keepdim=True)
        wide = averaged(torch.cat([slope, offset], 1), *picture.shape[-2:])
        likelihood = ((wide[:, :3] * picture).sum(1) + wide[:, 3]).clamp(0, 1)
    return likelihood


SIX = [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]
"""Places in a symmetric matrix of three rows: its upper triangle."""


def inverted(spread: Tensor) -> list[Tensor]:
    """Rows (N,3,…) of the inverse of a covariance (N,6,…) of colours, plus ``RIDGE``: by minors."""
    a, b, c, d, e, f = spread.unbind(1)
    a, d, f = a + RIDGE, d + RIDGE, f + RIDGE
    first, second, third = d * f - e * e, c * e - b * f, b * e - c * d
    determinant = a * first + b * second + c * third
    middle, corner, last = a * f - c * c, b * c - a * e, a * d - b * b
    rows = ((first, second, third), (second, middle, corner), (third, corner, last))
    return [torch.stack([cell / determinant for cell in row], 1) for row in rows]


def _shorter(maps: Tensor, times: int) -> tuple[int, int]:
    """So many times less on each side than maps (…,H,W), and two at least."""
    height, width = (torch.scalar_tensor(side, dtype=torch.float64) for side in maps.shape[-2:])
    return _length(height / times, 2), _length(width / times, 2)


def nearest(area: Tensor, height: int, width: int) -> Tensor:
    """Areas bool (N,H,W) at another size, as ``at_picture_size``."""
    rows = torch.arange(height) * area.shape[-2] // height
    columns = torch.arange(width) * area.shape[-1] // width
    return area.index_select(1, rows).index_select(2, columns)


def seed_cells(odds: Tensor, share: float) -> Tensor:
    """``likely_seed_area`` bool (N,h,w) of log odds (N,h,w)."""
    height, width = (torch.scalar_tensor(side, dtype=torch.float64) for side in odds.shape[-2:])
    rows, columns = _length((height / SEED_CELL).ceil(), 2), _length((width / SEED_CELL).ceil(), 2)
    row = ((torch.arange(rows) + 0.5) / rows)[:, None]
    score = averaged(odds[:, None], rows, columns)[:, 0] + NEARNESS * row - UPPER_HALF * (row < 0.5)
    best = score.flatten(1).sort(1, descending=True).values
    before = torch.arange(rows * columns) / (rows * columns)
    least = torch.where(before < share, best, torch.inf).amin(1)
    return nearest(score >= least[:, None, None], odds.shape[-2], odds.shape[-1])


def mean_over(values: Tensor, area: Tensor) -> Tensor:
    """Means (N,) of values (N,h,w) in areas bool (N,h,w) that are nowhere empty."""
    return (values * area).sum((1, 2)) / area.sum((1, 2))


def trust_of(likelihood: Tensor, mask: Tensor, ego: Tensor, seed: Tensor) -> Tensor:
    """``trust.judgement`` (N,); likelihoods, masks, ego cars (N,h,w); seed: its road (N,)."""

    def total(values: Tensor) -> Tensor:
        return values.to(torch.float32).sum((1, 2))

    low, high = (total((likelihood > level) & ~ego) for level in LOW_AND_HIGH)
    inside = mask & ~ego
    road, right = total(likelihood * ~ego), total(likelihood * inside)
    steady = high / low.clamp(min=1)
    expected = 2 * right / (total(inside) + road).clamp(min=1)
    vague = total(entropy(likelihood) * ~ego) / total(~ego)
    weighted = zip(WEIGHTS, (steady, expected, seed, vague), strict=True)
    sure = CONSTANT + torch.stack([weight * sign for weight, sign in weighted]).sum(0)
    there = ((ROAD_THERE + ROAD_STEADY * steady + ROAD_VAGUE * vague).sigmoid() / ENOUGH).clamp(
        max=1
    )
    return torch.where(mask.any(2).any(1), there * sure.clamp(0, 1), 0.0)
