"""Augmentation of batches of whole images, on any device. Ours.

An effect changes adjacent images of a batch, whose order is random: no indices are copied to the
device, which would have to wait for it. It is three times as fast as image by image.
"""

import math
import random
from collections.abc import Callable

import torch
from torch import Tensor
from torch.nn import functional as F

from roadtorch.imaging.resize import spatial_size
from roadtorch.layout.classes import HORIZONTAL, SKY
from roadtorch.train import augmentation
from roadtorch.train.augmentation import Augmentation, EgoCar, SceneMasks
from roadtorch.train.teachers import TARGET_PLANES, Targets

UNDEREXPOSED = (math.log(0.05), math.log(0.2))
"""Logarithms of the least and the largest mean of underexposed images."""

MIN_EXPOSURE = 0.04
"""Least mean of an image: darker ones are exposed longer, as a camera would."""

InputResize = Callable[[Tensor], Tensor]
"""Resizes maps (n, C, H, W) to the network's input."""

CarSource = Callable[[int, random.Random], EgoCar]
"""Samples so many ego cars, of the size of the images before they are resized."""


def split_targets(planes: Tensor) -> Targets:
    """Split stacked ``Targets`` (n, 8, H, W)."""
    return Targets(*planes.split(TARGET_PLANES, 1))


def sample_part(count: int, fraction: float, choice: random.Random) -> slice:
    """Sample adjacent images of a batch of ``count``: a fraction of them in the mean."""
    chosen = min(count, int(fraction * count + choice.random()))
    start = choice.randrange(count - chosen + 1)
    return slice(start, start + chosen)


def augment_batch(
    images: Tensor,
    planes: Tensor,
    settings: Augmentation,
    resize: InputResize,
    cars: CarSource | None,
    seed: torch.Generator,
) -> tuple[Tensor, Tensor]:
    """Augment images (n, 3, H, W) in [0, 1] and their stacked ``Targets`` (n, 8, H, W).

    Both are warped and resized, then each effect changes its part of the batch. cars: None for no
    ego cars to paste. seed: generator on the CPU, which seeds all random numbers.
    """
    numbers = torch.randint(2**62, (2,), generator=seed).tolist()
    rng, choice = torch.Generator(images.device).manual_seed(numbers[0]), random.Random(numbers[1])
    frames = augmentation.sample_affine(len(images), spatial_size(images), settings.geometry, rng)
    images = resize(augmentation.warp_affine(images, frames, "border")).clamp(0, 1)
    planes = resize(augmentation.warp_affine(planes, frames, "zeros")).clamp_min(0)

    def change_surface(part: slice) -> None:
        targets = split_targets(planes[part])
        ground = targets.layout[:, HORIZONTAL : HORIZONTAL + 1] * (1 - targets.road)
        images[part] = augmentation.retexture_road(
            images[part], targets.road, ground, settings.surface, rng
        )

    def shade(part: slice) -> None:
        images[part] = augmentation.add_shadow(images[part], settings.shadow, rng)

    def paste_cars(part: slice) -> None:
        if cars is None:
            return
        sampled = cars(part.stop - part.start, choice)
        car = EgoCar(*(maps.to(images.device) for maps in sampled))
        car = augmentation.jitter_ego_car(car, settings.ego_car, rng)
        car = EgoCar(*(resize(maps).clamp(0, 1) for maps in car))
        images[part], planes[part] = augmentation.paste_ego_car(images[part], planes[part], car)

    def change_weather(part: slice) -> None:
        targets = split_targets(planes[part])
        sky, ground = (targets.layout[:, k : k + 1] for k in (SKY, HORIZONTAL))
        scene = SceneMasks(sky, ground, targets.road, targets.ego * targets.ego_weight)
        images[part] = augmentation.add_weather(images[part], scene, settings.weather, rng)

    def darken(part: slice) -> None:
        targets = split_targets(planes[part])
        unlit = (targets.layout[:, SKY : SKY + 1] + targets.ego).clamp_max(1)
        images[part] = augmentation.darken_to_night(images[part], unlit, settings.night, rng)

    def underexpose(part: slice) -> None:
        (exposure,) = augmentation.sample(rng, part.stop - part.start, UNDEREXPOSED)
        mean = augmentation.mean_brightness(images[part]).clamp_min(1e-3)
        images[part] *= (exposure.exp() / mean).clamp_max(1)

    def blur(part: slice) -> None:
        images[part] = F.avg_pool2d(images[part], 3, 1, 1, count_include_pad=False)

    for fraction, effect in (
        (settings.surface.probability, change_surface),
        (settings.shadow.probability, shade),
        (settings.ego_car.probability, paste_cars),
        (settings.weather.probability, change_weather),
        (settings.night.probability, darken),
        (settings.underexposed, underexpose),
        (settings.blurred, blur),
    ):
        part = sample_part(len(images), fraction, choice)
        if part.stop > part.start:
            effect(part)
    images = augmentation.jitter_light(images, settings.light, rng)
    gain = (MIN_EXPOSURE / augmentation.mean_brightness(images).clamp_min(1e-3)).clamp_min(1)
    return (images * gain).clamp(0, 1), planes
