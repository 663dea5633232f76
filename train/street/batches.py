"""Augmented batches of a pack, on any device: ``roadtorch.train.augmentation`` in batches.

An effect changes adjacent images of a batch, which is in random order: no indices are copied to the
device, which would have to wait for it.
"""

import math
import random
from collections import Counter
from functools import lru_cache
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional as F

from roadtorch.imaging.resize import spatial_size
from roadtorch.layout.classes import HORIZONTAL, NUM_CLASSES, SKY
from roadtorch.layout.image_network import count_upper_rows, resize_rows
from roadtorch.train import augmentation
from roadtorch.train.recordings import recording_name
from roadtorch.train.teachers import MIN_EGO_AREA, MIN_EGO_WIDTH, TARGET_PLANES, Targets
from train.street.pack import HELD_GROUP, REAL, SIZE, Pack
from train.street.recipes import Recipe

ROAD_MAP, EGO_MAP = NUM_CLASSES, NUM_CLASSES + 1
"""Planes of a pack's maps after the layout."""

MARGIN = 0.2
"""Least lead of the best class for a machine-labelled pixel's layout to count."""

BALANCE = 0.2
"""A recording of n real images has the sampling weight n^(1 - balance)."""

WORLD_BALANCE = 0.5
"""The same for kinds of worlds, most of which are towns."""

GEOMETRY = augmentation.GeometryAugmentation(
    scale=0.35, stretch=0.25, rotation=5.0, translation=0.12, crop_probability=0.25
)
SETTINGS = augmentation.Augmentation(
    geometry=GEOMETRY,
    surface=augmentation.SurfaceAugmentation(probability=0.2),
    shadow=augmentation.ShadowAugmentation(probability=0.2),
    night=augmentation.NightAugmentation(probability=0.1),
    weather=augmentation.WeatherAugmentation(probability=0.25),
    ego_car=augmentation.EgoCarAugmentation(probability=0.15, growth=0.4),
)
"""Augmentation of configs/backbone-free.toml."""

DIM = (math.log(0.05), math.log(0.2))
"""Logarithms of the least and the largest mean of underexposed images (night in many/: .11)."""

MIN_MEAN = 0.04
"""Least mean of an image: darker ones are exposed longer, as a camera would."""

BLURRED = 0.1
"""Fraction of a batch that is blurred."""


class Batch(NamedTuple):
    """Images (n, 3, H, W) in [0, 1], their stacked ``Targets`` (n, 8, H, W), and which are exact.

    exact: 1 for a renderer's truth, 0 for machine labels, (n, 1, 1, 1).
    """

    images: Tensor
    planes: Tensor
    exact: Tensor


def make_planes(maps: Tensor, known: Tensor, margin: float) -> Tensor:
    """Stack the ``Targets`` (n, 8, H, W) of maps (n, 5, H, W) in [0, 1] and where they are known.

    Pixels whose best class leads by less than ``MARGIN``, or whose road is less certain than
    ``margin``, do not count. On the ego car there is no road.
    """
    layout, road, ego = maps.split([NUM_CLASSES, 1, 1], 1)
    layout_known, road_known, ego_known = known.split(1, 1)
    best = layout.topk(2, 1).values
    is_clear = best[:, :1] - best[:, 1:] >= MARGIN
    is_car = ego_known & (ego > 0.75)
    is_certain = (2 * road - 1).abs() >= margin
    weights = [layout_known & is_clear & ~is_car, road_known & (is_certain | is_car), ego_known]
    layout_weight, road_weight, ego_weight = (weight.to(road) for weight in weights)
    parts = layout, layout_weight, road * ~is_car, road_weight, ego, ego_weight
    return torch.cat(parts, 1)


class Sampler:
    """Augmented batches of a pack, on its device."""

    def __init__(self, pack: Pack, recipe: Recipe, batch: int) -> None:
        """Seed the generators, and find the images of each group and those with ego cars."""
        self._pack, self._recipe, self.batch = pack, recipe, batch
        self.device = pack.images.device
        self._rng = torch.Generator(self.device).manual_seed(recipe.seed)
        self._choice = random.Random(recipe.seed)
        self._exact = torch.from_numpy(pack.groups != REAL).float().to(self.device)
        sources = [source_of(*names) for names in zip(pack.groups, pack.names, strict=True)]
        sizes = Counter(sources)
        chances = torch.tensor(
            [sizes[name] ** -(BALANCE if name[0] == REAL else WORLD_BALANCE) for name in sources]
        )
        self._members: list[tuple[Tensor, Tensor, float]] = []
        for group, fraction in recipe.groups.items():
            rows = torch.from_numpy((pack.groups == group).nonzero()[0])
            if len(rows):
                weights = chances[rows].to(self.device)
                self._members.append((rows.to(self.device), weights, fraction))
        ego = (pack.maps[:, EGO_MAP] == 255) & pack.known[:, 2]
        across, area = ego.any(-2).float().mean(-1), ego.float().mean((-2, -1))
        is_held = torch.from_numpy(pack.groups == HELD_GROUP).to(self.device)
        has_car = (across >= MIN_EGO_WIDTH) & (area >= MIN_EGO_AREA) & ~is_held
        self._cars = has_car.nonzero()[:, 0]

    def sample(self, size: tuple[int, int]) -> Batch:
        """Return an augmented batch of a size, with so many upper rows as the recipe says."""
        upper = count_upper_rows(self._choice.choice(self._recipe.upper), size[0])
        pack, rng, members = self._pack, self._rng, self._sample_members()
        maps, known = pack.maps[members] / 255, pack.known[members]
        frames = augmentation.sample_affine(self.batch, SIZE, GEOMETRY, rng)
        images = augmentation.warp_affine(pack.images[members] / 255, frames, "border")
        planes = make_planes(maps, known, self._recipe.margin)
        planes = augmentation.warp_affine(planes, frames, "zeros")
        images, planes = (resize(part, size, upper).clamp(0, 1) for part in (images, planes))
        batch = Batch(images, planes, self._exact[members].reshape(-1, 1, 1, 1))
        self._add_surface(batch)
        self._add_shadow(batch)
        self._add_ego_cars(batch, upper)
        self._add_weather(batch)
        self._add_night(batch)
        self._degrade(batch.images)
        images = augmentation.jitter_light(batch.images, SETTINGS.light, rng)
        gain = (MIN_MEAN / augmentation.mean_brightness(images).clamp_min(1e-3)).clamp_min(1)
        return batch._replace(images=(images * gain).clamp(0, 1))

    def _sample_members(self) -> Tensor:
        """Sample the indices (batch,) of images, in random order, by the groups' fractions."""
        rng, total = self._rng, sum(fraction for *_, fraction in self._members)
        parts = []
        for rows, weights, fraction in self._members:
            count = math.ceil(self.batch * fraction / total)
            parts.append(rows[torch.multinomial(weights, count, True, generator=rng)])
        members = torch.cat(parts)
        order = torch.randperm(len(members), generator=rng, device=self.device)
        return members[order[: self.batch]]

    def _sample_part(self, fraction: float) -> slice:
        """Sample adjacent images of a batch."""
        count = round(fraction * self.batch)
        start = self._choice.randrange(self.batch - count + 1)
        return slice(start, start + count)

    def _add_surface(self, batch: Batch) -> None:
        part = self._sample_part(SETTINGS.surface.probability)
        targets = Targets(*batch.planes[part].split(TARGET_PLANES, 1))
        ground = targets.layout[:, HORIZONTAL : HORIZONTAL + 1] * (1 - targets.road)
        batch.images[part] = augmentation.retexture_road(
            batch.images[part], targets.road, ground, SETTINGS.surface, self._rng
        )

    def _add_shadow(self, batch: Batch) -> None:
        part = self._sample_part(SETTINGS.shadow.probability)
        images = batch.images[part]
        batch.images[part] = augmentation.add_shadow(images, SETTINGS.shadow, self._rng)

    def _add_ego_cars(self, batch: Batch, upper: int) -> None:
        part, rng = self._sample_part(SETTINGS.ego_car.probability), self._rng
        if not len(self._cars):
            return
        shape = (part.stop - part.start,)
        chosen = torch.randint(len(self._cars), shape, generator=rng, device=self.device)
        members = self._cars[chosen]
        ego = (self._pack.maps[members, EGO_MAP:] == 255).float()
        car = augmentation.EgoCar(self._pack.images[members] / 255, ego)
        car = augmentation.jitter_ego_car(car, SETTINGS.ego_car, rng)
        size = spatial_size(batch.images)
        car = augmentation.EgoCar(*(resize(maps, size, upper).clamp(0, 1) for maps in car))
        pasted = augmentation.paste_ego_car(batch.images[part], batch.planes[part], car)
        batch.images[part], batch.planes[part] = pasted

    def _add_weather(self, batch: Batch) -> None:
        part = self._sample_part(SETTINGS.weather.probability)
        targets = Targets(*batch.planes[part].split(TARGET_PLANES, 1))
        sky, ground = (targets.layout[:, k : k + 1] for k in (SKY, HORIZONTAL))
        ego = targets.ego * targets.ego_weight
        scene = augmentation.SceneMasks(sky, ground, targets.road, ego)
        batch.images[part] = augmentation.add_weather(
            batch.images[part], scene, SETTINGS.weather, self._rng
        )

    def _add_night(self, batch: Batch) -> None:
        part = self._sample_part(SETTINGS.night.probability)
        targets = Targets(*batch.planes[part].split(TARGET_PLANES, 1))
        unlit = (targets.layout[:, SKY : SKY + 1] + targets.ego).clamp_max(1)
        batch.images[part] = augmentation.darken_to_night(
            batch.images[part], unlit, SETTINGS.night, self._rng
        )

    def _degrade(self, images: Tensor) -> None:
        """Underexpose a part of the images (n, 3, H, W), and blur another."""
        part = self._sample_part(self._recipe.dim)
        (exposure,) = augmentation.sample(self._rng, part.stop - part.start, DIM)
        mean = augmentation.mean_brightness(images[part]).clamp_min(1e-3)
        images[part] *= (exposure.exp() / mean).clamp_max(1)
        part = self._sample_part(BLURRED)
        images[part] = F.avg_pool2d(images[part], 3, 1, 1, count_include_pad=False)


def source_of(group: object, name: object) -> tuple[str, str]:
    """Return the group of an image of a pack, and its recording or its kind."""
    text = str(name)
    source = text.split("_")[1] if text[0].isdigit() else recording_name(text, "_")
    return str(group), source


def resize(maps: Tensor, size: tuple[int, int], rows: int = 0) -> Tensor:
    """Resize maps (n, C, H, W) as ``resize_rows`` does, on a GPU by matrix products."""
    if maps.device.type == "cpu":
        return resize_rows(maps.float(), size, rows)
    (height, width), (new_height, new_width) = spatial_size(maps), size
    down = resize_weights(height, new_height, rows, maps.device)
    across = resize_weights(width, new_width, 0, maps.device)
    return down @ maps.float() @ across.T


@lru_cache(maxsize=64)
def resize_weights(old: int, new: int, rows: int, device: torch.device) -> Tensor:
    """Return the matrix (new, old) that resizes a side."""
    return resize_rows(torch.eye(old)[None], (new, old), rows)[0].to(device)
