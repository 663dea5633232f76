"""Augmentation of whole images: geometry, light, surfaces, shadows, night, weather, ego cars. Ours.

Images are (n, 3, H, W) in [0, 1] and masks (n, 1, H, W); every image gets random values of its own,
on the device of the generator, which is that of the images. Geometry is one affine map and one
``grid_sample``: torchvision's affine map neither stretches the width nor repeats the border, and
black corners would change the levels by which an image is brightened; with ``pad``,
``perspective`` and ``center_crop`` it takes four times as long (2.2 ms against 0.6 ms for 120×160
with its targets, one thread).

Ego cars are cut out and pasted after Dwibedi et al., "Cut, Paste and Learn", 2017, so that few
ego cars suffice to learn what one looks like.
"""

import math
import random
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, NamedTuple

import torch
from pydantic import Field
from torch import Tensor
from torch.nn import functional as F

from roadtorch.base.settings import Settings
from roadtorch.base.vision import import_torchvision
from roadtorch.layout.classes import NUM_CLASSES
from roadtorch.run.memo import read_arrays
from roadtorch.train.prepared import from_uint8

GRAIN_CELLS = (4, 12, 40)
"""Numbers of cells across the image of the noise layers that are summed to grain."""

SHADOW_END = 0.02
"""Fraction of the height over which a shadow fades in below the horizon."""

MAX_SHADOW_LEVEL = 0.7
"""Factor on the brightness in the faintest shadow."""

MAX_LAMP = 4.0
"""Peak brightness of a lamp at night, where 1 is white: its surroundings saturate."""

EGO_TINT = 0.2
"""Exponent of an ego car's random channel factors: its colour changes less than its gain."""


# --- settings ---------------------------------------------------------------------------

Fraction = Annotated[float, Field(ge=0, le=1)]
GreyLevels = Annotated[float, Field(ge=0, le=255)]
Exponent = Annotated[float, Field(ge=0, le=3)]
"""Exponent x of e: a factor is sampled from e^-x to e^x, uniformly in its logarithm."""


class LightAugmentation(Settings):
    """Random light of whole images."""

    gamma: Exponent = Field(default=0.7, description="gamma from e^-gamma to e^gamma")
    gain: Exponent = Field(default=0.4, description="brightness factor from e^-gain to e^gain")
    tint: Exponent = Field(default=0.15, description="channel factors from e^-tint to e^tint")
    saturation: Fraction = Field(default=0.6, description="largest change of saturation, fraction")
    noise: GreyLevels = Field(default=6.0, description="largest noise deviation, of 255 levels")


class GeometryAugmentation(Settings):
    """Random geometry of whole images."""

    mirror: Fraction = Field(default=0.5, description="fraction of the images that are mirrored")
    scale: float = Field(default=0.25, ge=0, le=2, description="zoom from e^-scale to e^scale")
    stretch: float = Field(
        default=0.1, ge=0, le=2, description="stretch of the width from e^-stretch to e^stretch"
    )
    rotation: float = Field(default=4.0, ge=0, le=90, description="largest rotation, degrees")
    translation: Fraction = Field(default=0.1, description="largest shift, fraction of the size")
    crop_probability: Fraction = Field(
        default=0.0, description="fraction of images cropped at the top: the horizon is higher"
    )
    max_crop: float = Field(
        default=0.5, ge=0, le=0.9, description="largest fraction of the height cropped at the top"
    )


class SurfaceAugmentation(Settings):
    """Random colour and grain, for road and other ground separately: asphalt, gravel, sand."""

    probability: Fraction = Field(default=0.0, description="fraction of images retextured")
    gain: Exponent = Field(default=0.45, description="brightness factor from e^-gain to e^gain")
    tint: Exponent = Field(default=0.2, description="channel factors from e^-tint to e^tint")
    grain: Fraction = Field(default=0.15, description="largest grain, fraction of the brightness")


class ShadowAugmentation(Settings):
    """Random hard shadows: bands with straight edges, below the horizon."""

    probability: Fraction = Field(default=0.0, description="fraction of images that get a shadow")
    min_brightness: float = Field(
        default=0.25, gt=0, le=0.7, description="brightness in the darkest shadow, 1 outside"
    )
    max_half_width: float = Field(
        default=0.5, gt=0, le=2, description="largest half width of a band, fraction of the image"
    )


class NightAugmentation(Settings):
    """Day turned into night: dark but for headlights and a few lamps, in warmer light."""

    probability: Fraction = Field(default=0.0, description="fraction of images turned into night")
    min_brightness: float = Field(
        default=0.03, gt=0, le=1, description="least brightness without headlights, 1 being day"
    )
    lamps: int = Field(default=6, ge=0, le=100, description="largest number of lamps")


class WeatherAugmentation(Settings):
    """Weather: fog, snow beside the road, a wet road or rain, equally likely."""

    probability: Fraction = Field(default=0.0, description="fraction of images that get weather")
    fog: float = Field(
        default=0.15,
        gt=0,
        le=1,
        description="densest fog: 37 % of the contrast remains on ground this fraction of the "
        "height below the horizon",
    )
    snow: Fraction = Field(default=0.9, description="largest opacity of snow")
    reflection: Fraction = Field(default=0.6, description="largest reflectance of a wet road")
    streaks: Fraction = Field(default=0.02, description="largest density of rain, streaks a pixel")


class EgoCarAugmentation(Settings):
    """Ego cars cut out of footage and pasted over the lower edge of other images."""

    probability: Fraction = Field(default=0.0, description="fraction of images that get a car")
    growth: Exponent = Field(default=0.7, description="height is scaled by up to e^growth")
    shrinkage: Exponent = Field(default=0.3, description="height is scaled by down to e^-shrinkage")
    widening: Exponent = Field(default=0.25, description="width is scaled by up to e^widening")
    light: Exponent = Field(default=0.5, description="gamma and gain from e^-light to e^light")


class Augmentation(Settings):
    """Augmentation of whole images."""

    light: LightAugmentation = LightAugmentation()
    geometry: GeometryAugmentation = GeometryAugmentation()
    surface: SurfaceAugmentation = SurfaceAugmentation()
    shadow: ShadowAugmentation = ShadowAugmentation()
    night: NightAugmentation = NightAugmentation()
    weather: WeatherAugmentation = WeatherAugmentation()
    ego_car: EgoCarAugmentation = EgoCarAugmentation()
    underexposed: Fraction = Field(
        default=0.0, description="fraction of images darkened to a mean of 0.05 to 0.2"
    )
    blurred: Fraction = Field(default=0.0, description="fraction of images blurred over 3×3 pixels")


# --- geometry ---------------------------------------------------------------------------


def uniform(generator: torch.Generator, count: int, low: float, high: float) -> Tensor:
    """Sample ``count`` numbers uniformly between low and high, shape (count,)."""
    numbers = torch.rand(count, generator=generator, device=generator.device)
    return low + (high - low) * numbers


def sample(generator: torch.Generator, count: int, *bounds: tuple[float, float]) -> list[Tensor]:
    """Sample numbers (count, 1, 1, 1) between each pair of bounds."""
    return [uniform(generator, count, *pair).reshape(-1, 1, 1, 1) for pair in bounds]


def sample_colour(generator: torch.Generator, count: int, exponent: float) -> Tensor:
    """Sample channel factors (count, 3, 1, 1) from e^-exponent to e^exponent."""
    return uniform(generator, 3 * count, -exponent, exponent).exp().reshape(-1, 3, 1, 1)


def pixel_grid(image: Tensor, left: float, right: float) -> tuple[Tensor, Tensor]:
    """Return rows (H, 1) from 0 to 1 and columns (W,) from left to right of images (…, H, W)."""
    height, width = image.shape[-2:]
    down = torch.linspace(0, 1, height, device=image.device)[:, None]
    return down, torch.linspace(left, right, width, device=image.device)


def sample_affine(
    count: int, size: tuple[int, int], geometry: GeometryAugmentation, rng: torch.Generator
) -> Tensor:
    """Sample affine maps (n, 2, 3) from augmented to original coordinates, both in [-1, 1].

    Each shows the whole image zoomed, stretched, rotated and shifted, or a crop at its lower edge;
    some of them are mirrored. size: height and width.
    """
    mirror = _sample_mirrors(count, rng, geometry.mirror)
    zoom = torch.exp(uniform(rng, count, -geometry.scale, geometry.scale))
    width = zoom * torch.exp(uniform(rng, count, -geometry.stretch, geometry.stretch))
    angle = uniform(rng, count, -geometry.rotation, geometry.rotation) * (math.pi / 180)
    max_shift = 2 * geometry.translation
    shift = [uniform(rng, count, -max_shift, max_shift) for _ in range(2)]
    cos, sin, aspect = angle.cos(), angle.sin(), size[1] / size[0]
    across = torch.stack([mirror * cos / width, -sin / (zoom * aspect), shift[0]], 1)
    down = torch.stack([mirror * sin * aspect / width, cos / zoom, shift[1]], 1)
    whole = torch.stack([across, down], 1)
    is_lower = uniform(rng, count, 0, 1) < geometry.crop_probability
    mirror = _sample_mirrors(count, rng, geometry.mirror)
    crop = uniform(rng, count, 0, geometry.max_crop)
    width = 1 - crop * uniform(rng, count, 0.3, 1)
    offset = (1 - width) * uniform(rng, count, -1, 1)
    zero = torch.zeros_like(crop)
    across = torch.stack([mirror * width, zero, offset], 1)
    lower = torch.stack([across, torch.stack([zero, 1 - crop, crop], 1)], 1)
    return torch.where(is_lower[:, None, None], lower, whole)


def _sample_mirrors(count: int, rng: torch.Generator, probability: float = 0.5) -> Tensor:
    """Sample -1, mirrored, or 1: int64 (count,)."""
    return 1 - 2 * (uniform(rng, count, 0, 1) < probability).long()


def warp_affine(maps: Tensor, transforms: Tensor, padding: str) -> Tensor:
    """Warp maps (n, C, H, W) by affine maps (n, 2, 3); padding: "border" or "zeros"."""
    grid = F.affine_grid(transforms, list(maps.shape), align_corners=False)
    return F.grid_sample(maps, grid, padding_mode=padding, align_corners=False)


# --- light ------------------------------------------------------------------------------


def jitter_light(image: Tensor, light: LightAugmentation, rng: torch.Generator) -> Tensor:
    """Apply random gamma, gain, tint, saturation and noise to images (n, 3, H, W) in [0, 1]."""
    adjust, count = import_torchvision().transforms.v2.functional, len(image)
    tops = light.gamma, light.gain
    gamma, gain = (power.exp() for power in sample(rng, count, *((-top, top) for top in tops)))
    tint, change = sample_colour(rng, count, light.tint), light.saturation
    colour, noise = sample(rng, count, (1 - change, 1 + change), (0, light.noise / 255))
    image = image.clamp(0, 1).pow(gamma)  # of a negative rounding error a power is not a number
    image = torch.lerp(adjust.rgb_to_grayscale(image), image, colour).clamp(0, 1)
    grain = torch.randn(image.shape, generator=rng, device=rng.device)
    return (image * gain * tint + noise * grain).clamp(0, 1)


def retexture_road(
    image: Tensor, road: Tensor, ground: Tensor, surface: SurfaceAugmentation, rng: torch.Generator
) -> Tensor:
    """Change colour and grain of road and other ground in images (n, 3, H, W) in [0, 1].

    road, ground: soft masks (n, 1, H, W) in [0, 1]. Only colour and grain change, so that the
    network cannot rely on grey.
    """
    count = len(image)
    for mask in (road, ground):
        colour = sample_colour(rng, count, surface.tint)
        gain, depth = sample(rng, count, (-surface.gain, surface.gain), (0, surface.grain))
        new = gain.exp() * colour * (1 + depth * sample_grain(count, image.shape[-2:], rng))
        image = image * (1 + mask * (new - 1))
    return image.clamp(0, 1)


def sample_grain(count: int, size: Sequence[int], rng: torch.Generator) -> Tensor:
    """Sample noise (n, 1, H, W) of ``GRAIN_CELLS``, with a standard deviation of about 1."""
    layers = []
    for across in GRAIN_CELLS:
        cells = (count, 1, max(2, across * size[0] // size[1]), across)
        noise = torch.randn(cells, generator=rng, device=rng.device)
        layers.append(F.interpolate(noise, size=(size[0], size[1]), mode="bilinear"))
    return torch.stack(layers).sum(0)


def add_shadow(image: Tensor, shadow: ShadowAugmentation, rng: torch.Generator) -> Tensor:
    """Darken a straight band at a random angle, below the horizon, in images (n, 3, H, W)."""
    down, along = pixel_grid(image, -0.5, 0.5)
    ranges = (0, math.pi), (-0.3, 0.3), (0.05, shadow.max_half_width), (0.002, 0.03), (0.3, 0.6)
    angle, offset, half, edge, horizon = sample(rng, len(image), *ranges)
    distance = along * angle.cos() + (down - 0.65) * angle.sin() - offset
    inside = ((half - distance.abs()) / edge).sigmoid() * ((down - horizon) / SHADOW_END).sigmoid()
    (brightness,) = sample(rng, len(image), (shadow.min_brightness, MAX_SHADOW_LEVEL))
    return image * (1 - (1 - brightness) * inside)


def darken_to_night(
    image: Tensor, unlit: Tensor, night: NightAugmentation, rng: torch.Generator
) -> Tensor:
    """Darken images (n, 3, H, W) in [0, 1] to a night lit by headlights and a few lamps.

    unlit: soft mask (n, 1, H, W) of sky and ego car, which headlights do not reach. The beam
    starts below the horizon, widens towards the camera and peaks a little way ahead.
    """
    count, (down, across) = len(image), pixel_grid(image, -0.5, 0.5)
    ranges = (0.35, 0.55), (-0.1, 0.1), (0.4, 1.5), (0.15, 0.35)
    horizon, offset, spread, nearest = sample(rng, count, *ranges)
    below = (down - horizon).clamp_min(0)
    beam = torch.exp(-(((across - offset) / (0.06 + spread * below)) ** 2))
    intensity = (below / nearest) * torch.exp(1 - below / nearest)
    power, warmth = sample(rng, count, (math.log(night.min_brightness), math.log(0.3)), (0, 0.3))
    ambient = power.exp()
    light = ambient + (1 - ambient) * beam * intensity * (1 - unlit)
    tint = torch.cat([1 + warmth, torch.ones_like(warmth), 1 - warmth], 1)
    (lit,) = sample(rng, count, (0, night.lamps))
    lamps = torch.zeros_like(unlit)
    for number in range(1, night.lamps):
        lamps = lamps + (lit >= number) * render_lamps(image, horizon, rng)
    return (image * light * tint + lamps * tint).clamp(0, 1)


# --- weather ----------------------------------------------------------------------------


class SceneMasks(NamedTuple):
    """Soft masks (n, 1, H, W) in [0, 1] of images: sky, ground including road, road, ego car."""

    sky: Tensor
    ground: Tensor
    road: Tensor
    ego: Tensor


def add_weather(
    image: Tensor, scene: SceneMasks, weather: WeatherAugmentation, rng: torch.Generator
) -> Tensor:
    """Add fog, snow, rain or a wet road, the same to all images (n, 3, H, W) in [0, 1]."""
    number = int(torch.randint(4, (), generator=rng, device=rng.device))
    add = (add_fog, add_snow, wet_road, add_rain)[number]
    street = add(image, scene, weather, rng).clamp(0, 1)
    return torch.lerp(street, image, scene.ego)


def ground_horizon(scene: SceneMasks) -> Tensor:
    """Return the fraction of the height at which the ground begins, averaged over columns.

    Shape (n, 1, 1, 1).
    """
    return 1 - (scene.ground + scene.ego).clamp_max(1).mean((1, 2, 3), keepdim=True)


def mean_brightness(image: Tensor) -> Tensor:
    """Return the mean (n, 1, 1, 1) of images (n, 3, H, W)."""
    return image.mean((1, 2, 3), keepdim=True)


def add_fog(
    image: Tensor, scene: SceneMasks, weather: WeatherAugmentation, rng: torch.Generator
) -> Tensor:
    """Add fog: transmission falls exponentially with distance.

    Ground d below the horizon has the distance 1/d; other pixels have that of the farthest ground
    below them in their column. The sky is hidden.
    """
    down, _ = pixel_grid(image, 0, 1)
    distance = scene.ground / (down - ground_horizon(scene) + 0.05).clamp_min(0.02)
    distance = distance.flip(-2).cummax(-2).values.flip(-2)
    radius = image.shape[-1] // 8  # haze has no edges
    distance = F.avg_pool2d(distance, (1, 2 * radius + 1), 1, (0, radius), count_include_pad=False)
    density, airlight = sample(rng, len(image), (0.02, weather.fog), (1, 2))
    airlight = (airlight * mean_brightness(image)).clamp_max(0.9)
    transmission = torch.exp(-density * distance) * (1 - scene.sky)
    tint = 1 + uniform(rng, 3 * len(image), -0.05, 0.05).reshape(-1, 3, 1, 1)
    return torch.lerp((airlight * tint).expand_as(image), image, transmission)


def add_snow(
    image: Tensor, scene: SceneMasks, weather: WeatherAugmentation, rng: torch.Generator
) -> Tensor:
    """Add patches of snow to the ground beside the road, sometimes to the road as well."""
    ranges = (-0.6, 0.4), (0.3, weather.snow), (0.5, 1.0), (-0.5, 2)
    on_road, amount, brightness, cover = sample(rng, len(image), *ranges)
    ground = scene.ground * (1 - scene.road) + scene.road * on_road.clamp_min(0)
    patches = (2 * sample_grain(len(image), image.shape[-2:], rng) + 2 * cover).sigmoid()
    return torch.lerp(image, brightness.expand_as(image), amount * ground * patches)


def wet_road(
    image: Tensor, scene: SceneMasks, weather: WeatherAugmentation, rng: torch.Generator
) -> Tensor:
    """Darken patches of the road and mirror the image at the horizon in them."""
    height = image.shape[-2]
    above = 2 * ground_horizon(scene) * height
    rows = above - torch.arange(height, device=image.device)[:, None]
    mirrored = image.gather(2, rows.round().long().clamp(0, height - 1).expand_as(image))
    ranges = (0.15, weather.reflection), (0.5, 1.0), (-2, 3)
    reflection, brightness, cover = sample(rng, len(image), *ranges)
    puddles = (3 * sample_grain(len(image), image.shape[-2:], rng) + cover).sigmoid()
    wet = scene.road * puddles
    return torch.lerp(image * (1 - wet * (1 - brightness)), mirrored, reflection * wet)


def add_rain(
    image: Tensor, scene: SceneMasks, weather: WeatherAugmentation, rng: torch.Generator
) -> Tensor:
    """Add streaks, drops that show the image blurred and upside down, and a uniform veil.

    All streaks are equally long.
    """
    ranges = (0, weather.streaks), (0, 0.3), (0, 0.02)
    density, veil, drops = sample(rng, len(image), *ranges)
    brightness = (mean_brightness(image) * 1.3 + 0.1).expand_as(image)

    def scatter(density: Tensor) -> Tensor:
        numbers = uniform(rng, scene.road.numel(), 0, 1).reshape(scene.road.shape)
        return (numbers < density).to(image)

    length = 2 * int(uniform(rng, 1, 1, 7)) + 1
    streaks = F.max_pool2d(scatter(density), (length, 1), 1, (length // 2, 0)) * 0.4
    blurred = F.avg_pool2d(image.flip(-2), 9, 1, 4, count_include_pad=False)
    glass = F.avg_pool2d(F.max_pool2d(scatter(drops / 5), 7, 1, 3), 3, 1, 1)
    image = torch.lerp(torch.lerp(image, brightness, streaks), blurred, glass)
    return torch.lerp(image, brightness, veil)


def render_lamps(image: Tensor, horizon: Tensor, rng: torch.Generator) -> Tensor:
    """Render the light (n, 1, H, W) of a lamp, or of another car, above each image's horizon.

    horizon: (n, 1, 1, 1), fractions of the height.
    """
    ranges = (0, 1), (0, 1), (0.003, 0.02), (0.3, MAX_LAMP)
    row, column, radius, peak = sample(rng, len(image), *ranges)
    row = 0.1 + row * (horizon - 0.08)
    (down, along), aspect = pixel_grid(image, 0, 1), image.shape[-2] / image.shape[-1]
    squares = ((down - row) * aspect) ** 2 + (along - column) ** 2
    return peak * torch.exp(-squares / radius**2)


# --- ego cars ---------------------------------------------------------------------------


class EgoCar(NamedTuple):
    """Frames (n, 3, H, W) in [0, 1] and the masks (n, 1, H, W) of their ego cars, 0 or 1."""

    image: Tensor
    ego: Tensor


def sample_ego_cars(
    recordings: Mapping[str, Sequence[Path]], count: int, choice: random.Random
) -> EgoCar:
    """Sample ego cars: for each a recording uniformly, then one of its prepared frames."""
    names = sorted(recordings)
    frames = [choice.choice(recordings[choice.choice(names)]) for _ in range(count)]
    arrays = [read_arrays(frame, "image", "ego") for frame in frames]
    ego = torch.stack([from_uint8(entry["ego"])[None] for entry in arrays]) > 0.75  # 0.5: unknown
    images = torch.stack([from_uint8(entry["image"]) for entry in arrays])
    return EgoCar(images, ego.to(torch.float32))


def jitter_ego_car(car: EgoCar, settings: EgoCarAugmentation, rng: torch.Generator) -> EgoCar:
    """Scale, mirror and relight ego cars; their lower edges stay at the bottom of the image."""
    count = len(car.image)
    height_scale = uniform(rng, count, -settings.shrinkage, settings.growth).exp()
    width_scale = uniform(rng, count, 0, settings.widening).exp()  # no gap at the sides
    across, zero = _sample_mirrors(count, rng) / width_scale, torch.zeros_like(width_scale)
    offset = uniform(rng, count, -1, 1) * (1 - 1 / width_scale)
    rows = [across, zero, offset, zero, 1 / height_scale, 1 - 1 / height_scale]
    transforms = torch.stack(rows, 1).reshape(-1, 2, 3)
    gamma, gain = (
        power.exp() for power in sample(rng, count, *[(-settings.light, settings.light)] * 2)
    )
    colour = sample_colour(rng, count, settings.light * EGO_TINT)
    image = warp_affine(car.image, transforms, "border").pow(gamma) * gain
    return EgoCar((image * colour).clamp(0, 1), warp_affine(car.ego, transforms, "border"))


def paste_ego_car(image: Tensor, targets: Tensor, car: EgoCar) -> tuple[Tensor, Tensor]:
    """Paste ego cars over images (n, 3, H, W) and their stacked ``Targets`` (n, 8, H, W).

    There road is 0 and ego car 1, both with weight 1, and the layout has weight 0.
    """
    over = (car.ego > 0.5).to(targets)
    target = targets.new_tensor([0.0] * NUM_CLASSES + [0, 0, 1, 1, 1]).reshape(1, -1, 1, 1)
    return torch.lerp(image, car.image, car.ego), torch.lerp(targets, target, over)
