"""Effects of light and weather on whole images: surfaces, shadows, night, fog, snow, rain. Ours.

Images are (n, 3, H, W) in [0, 1]; every image gets random values of its own, on the device of the
generator, which is that of the images.
"""

import math
from collections.abc import Sequence

import torch
from torch import Tensor
from torch.nn import functional as F

from roadtorch.base.vision import import_torchvision
from roadtorch.train.targets import Targets

LIGHT_GAMMA, LIGHT_GAIN, LIGHT_TINT = 0.7, 0.4, 0.15
"""Exponents x of light: gamma, brightness and channel factors are from e^-x to e^x."""

SATURATION, MAX_NOISE = 0.6, 6 / 255
"""Largest change of the saturation, and largest deviation of noise."""

SURFACE_GAIN, SURFACE_TINT, MAX_GRAIN = 0.45, 0.2, 0.15
"""Exponents of a surface's brightness and channel factors; its largest grain."""

GRAIN_CELLS = (4, 12, 40)
"""Numbers of cells across the image of the noise layers that are summed to grain."""

SHADOW_LEVEL = (0.25, 0.7)
"""Factor on the brightness in the darkest and in the faintest shadow."""

SHADOW_HALF_WIDTH = (0.05, 0.5)
"""Half width of a shadow, fraction of the image."""

SHADOW_END = 0.02
"""Fraction of the height over which a shadow fades in below the horizon."""

NIGHT_LEVEL = (0.03, 0.3)
"""Brightness without headlights, 1 being day."""

MAX_LAMPS, LAMP_LEVEL = 6, (0.3, 4.0)
"""End of the range of lamps at night; their brightness, where 1 is white: surroundings saturate."""

FOG_DENSITY = (0.02, 0.15)
"""Densities of fog: 37 % of the contrast remains on ground this fraction of the height below the
horizon."""

SNOW_OPACITY, REFLECTANCE, STREAKS = (0.3, 0.9), (0.15, 0.6), (0, 0.02)
"""Opacity of snow, reflectance of a wet road, streaks of rain a pixel."""

# --- random numbers ---------------------------------------------------------------------


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


# --- light ---------------------------------------------------------------------------


def jitter_light(image: Tensor, rng: torch.Generator) -> Tensor:
    """Apply random gamma, gain, tint, saturation and noise to images."""
    adjust, count = import_torchvision().transforms.v2.functional, len(image)
    powers = sample(rng, count, (-LIGHT_GAMMA, LIGHT_GAMMA), (-LIGHT_GAIN, LIGHT_GAIN))
    gamma, gain = (power.exp() for power in powers)
    tint = sample_colour(rng, count, LIGHT_TINT)
    colour, noise = sample(rng, count, (1 - SATURATION, 1 + SATURATION), (0, MAX_NOISE))
    image = image.clamp(0, 1).pow(gamma)  # of a negative rounding error a power is not a number
    image = torch.lerp(adjust.rgb_to_grayscale(image), image, colour).clamp(0, 1)
    grain = torch.randn(image.shape, generator=rng, device=rng.device)
    return (image * gain * tint + noise * grain).clamp(0, 1)


def retexture_ground(image: Tensor, targets: Targets, rng: torch.Generator) -> Tensor:
    """Change colour and grain of road and other ground separately: asphalt, gravel, sand.

    Only colour and grain change, so that the network cannot rely on grey.
    """
    count = len(image)
    for mask in (targets.road, targets.ground * (1 - targets.road)):
        colour = sample_colour(rng, count, SURFACE_TINT)
        gain, depth = sample(rng, count, (-SURFACE_GAIN, SURFACE_GAIN), (0, MAX_GRAIN))
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


def add_shadow(image: Tensor, _: Targets, rng: torch.Generator) -> Tensor:
    """Darken a band with straight edges at a random angle, below the horizon."""
    down, along = pixel_grid(image, -0.5, 0.5)
    ranges = (0, math.pi), (-0.3, 0.3), SHADOW_HALF_WIDTH, (0.002, 0.03), (0.3, 0.6)
    angle, offset, half, edge, horizon = sample(rng, len(image), *ranges)
    distance = along * angle.cos() + (down - 0.65) * angle.sin() - offset
    inside = ((half - distance.abs()) / edge).sigmoid() * ((down - horizon) / SHADOW_END).sigmoid()
    (brightness,) = sample(rng, len(image), SHADOW_LEVEL)
    return image * (1 - (1 - brightness) * inside)


def darken_to_night(image: Tensor, targets: Targets, rng: torch.Generator) -> Tensor:
    """Darken images to a night lit by headlights and a few lamps, in warmer light.

    The beam starts below the horizon, widens towards the camera and peaks a little way ahead; it
    reaches neither sky nor ego car.
    """
    unlit = (targets.sky + targets.ego).clamp_max(1)
    count, (down, across) = len(image), pixel_grid(image, -0.5, 0.5)
    ranges = (0.35, 0.55), (-0.1, 0.1), (0.4, 1.5), (0.15, 0.35)
    horizon, offset, spread, nearest = sample(rng, count, *ranges)
    below = (down - horizon).clamp_min(0)
    beam = torch.exp(-(((across - offset) / (0.06 + spread * below)) ** 2))
    intensity = (below / nearest) * torch.exp(1 - below / nearest)
    darkest, brightest = map(math.log, NIGHT_LEVEL)
    power, warmth = sample(rng, count, (darkest, brightest), (0, 0.3))
    ambient = power.exp()
    light = ambient + (1 - ambient) * beam * intensity * (1 - unlit)
    tint = torch.cat([1 + warmth, torch.ones_like(warmth), 1 - warmth], 1)
    (lit,) = sample(rng, count, (0, MAX_LAMPS))
    lamps = torch.zeros_like(unlit)
    for number in range(1, MAX_LAMPS):
        lamps = lamps + (lit >= number) * render_lamps(image, horizon, rng)
    return (image * light * tint + lamps * tint).clamp(0, 1)


def render_lamps(image: Tensor, horizon: Tensor, rng: torch.Generator) -> Tensor:
    """Render the light (n, 1, H, W) of a lamp, or of another car, above each image's horizon.

    horizon: (n, 1, 1, 1), fractions of the height.
    """
    row, column, radius, peak = sample(rng, len(image), (0, 1), (0, 1), (0.003, 0.02), LAMP_LEVEL)
    row = 0.1 + row * (horizon - 0.08)
    (down, along), aspect = pixel_grid(image, 0, 1), image.shape[-2] / image.shape[-1]
    squares = ((down - row) * aspect) ** 2 + (along - column) ** 2
    return peak * torch.exp(-squares / radius**2)


# --- weather -------------------------------------------------------------------------


def add_weather(image: Tensor, targets: Targets, rng: torch.Generator) -> Tensor:
    """Add fog, snow, rain or a wet road, the same to all images but on ego cars."""
    number = int(torch.randint(4, (), generator=rng, device=rng.device))
    add = (add_fog, add_snow, wet_road, add_rain)[number]
    scene = targets._replace(ego=targets.ego * targets.ego_weight)
    street = add(image, scene, rng).clamp(0, 1)
    return torch.lerp(street, image, scene.ego)


def ground_horizon(scene: Targets) -> Tensor:
    """Return the fraction of the height at which the ground begins, averaged over columns.

    Shape (n, 1, 1, 1).
    """
    return 1 - (scene.ground + scene.ego).clamp_max(1).mean((1, 2, 3), keepdim=True)


def mean_brightness(image: Tensor) -> Tensor:
    """Return the mean (n, 1, 1, 1) of images (n, 3, H, W)."""
    return image.mean((1, 2, 3), keepdim=True)


def add_fog(image: Tensor, scene: Targets, rng: torch.Generator) -> Tensor:
    """Add fog: transmission falls exponentially with distance.

    Ground d below the horizon has the distance 1/d; other pixels have that of the farthest ground
    below them in their column. The sky is hidden.
    """
    down, _ = pixel_grid(image, 0, 1)
    distance = scene.ground / (down - ground_horizon(scene) + 0.05).clamp_min(0.02)
    distance = distance.flip(-2).cummax(-2).values.flip(-2)
    radius = image.shape[-1] // 8  # haze has no edges
    distance = F.avg_pool2d(distance, (1, 2 * radius + 1), 1, (0, radius), count_include_pad=False)
    density, airlight = sample(rng, len(image), FOG_DENSITY, (1, 2))
    airlight = (airlight * mean_brightness(image)).clamp_max(0.9)
    transmission = torch.exp(-density * distance) * (1 - scene.sky)
    tint = 1 + uniform(rng, 3 * len(image), -0.05, 0.05).reshape(-1, 3, 1, 1)
    return torch.lerp((airlight * tint).expand_as(image), image, transmission)


def add_snow(image: Tensor, scene: Targets, rng: torch.Generator) -> Tensor:
    """Add patches of snow to the ground beside the road, sometimes to the road as well."""
    ranges = (-0.6, 0.4), SNOW_OPACITY, (0.5, 1.0), (-0.5, 2)
    on_road, amount, brightness, cover = sample(rng, len(image), *ranges)
    ground = scene.ground * (1 - scene.road) + scene.road * on_road.clamp_min(0)
    patches = (2 * sample_grain(len(image), image.shape[-2:], rng) + 2 * cover).sigmoid()
    return torch.lerp(image, brightness.expand_as(image), amount * ground * patches)


def wet_road(image: Tensor, scene: Targets, rng: torch.Generator) -> Tensor:
    """Darken patches of the road and mirror the image at the horizon in them."""
    height = image.shape[-2]
    above = 2 * ground_horizon(scene) * height
    rows = above - torch.arange(height, device=image.device)[:, None]
    mirrored = image.gather(2, rows.round().long().clamp(0, height - 1).expand_as(image))
    ranges = REFLECTANCE, (0.5, 1.0), (-2, 3)
    reflection, brightness, cover = sample(rng, len(image), *ranges)
    puddles = (3 * sample_grain(len(image), image.shape[-2:], rng) + cover).sigmoid()
    wet = scene.road * puddles
    return torch.lerp(image * (1 - wet * (1 - brightness)), mirrored, reflection * wet)


def add_rain(image: Tensor, scene: Targets, rng: torch.Generator) -> Tensor:
    """Add streaks, drops that show the image blurred and upside down, and a uniform veil.

    All streaks are equally long.
    """
    density, veil, drops = sample(rng, len(image), STREAKS, (0, 0.3), (0, 0.02))
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
