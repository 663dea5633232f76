"""How whole images are varied: frame, light, ground, shadows, nights, ego cars. Ours.

Brightness curve and colour are torchvision's. Frames are one affine map and one look-up by hand:
torchvision's affine map stretches no width and repeats no border, and black corners would move
the levels by which an image is brightened; with ``pad``, ``perspective`` and ``center_crop`` it
takes four times as long (2.2 ms against 0.6 ms for 120×160 with its targets, one thread).

Ego cars are cut and pasted after Dwibedi et al., "Cut, Paste and Learn", 2017: a network that has
seen few bonnets learns what one is from many streets with one of them below.
"""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, NamedTuple

import torch
from pydantic import Field
from torch import Tensor
from torch.nn import functional as F

from roadtorch.base.settings import Settings
from roadtorch.base.vision import import_torchvision
from roadtorch.layout.classes import CLASSES
from roadtorch.run.memo import read_arrays
from roadtorch.train.prepared import from_bytes

GRAIN_CELLS = (4, 12, 40)
"""Cells across the image, of which grain is made: stones and ruts, near and far."""

SHADOW_END = 0.02
"""Share of the height over which a shadow ends at the horizon."""

MAX_SHADOW_LEVEL = 0.7
"""Levels in the faintest shadow, of those in the light."""

MAX_LAMP = 4.0
"""Peak of the brightest lamp at night, in levels: it outshines what it is seen before."""

EGO_TINT = 0.2
"""Share of the variation of an ego car's light that each colour has alone."""


# --- settings ---------------------------------------------------------------------------

Fraction = Annotated[float, Field(ge=0, le=1)]
GreyLevels = Annotated[float, Field(ge=0, le=255)]
Exponent = Annotated[float, Field(ge=0, le=3)]
"""Of e: a factor between its inverse and itself is drawn, every exponent as likely."""


class LightAugmentation(Settings):
    """How the light of whole images is varied."""

    gamma: Exponent = Field(default=0.7, description="exponents from 1/e^gamma to e^gamma")
    gain: Exponent = Field(default=0.4, description="brightness by e^-gain to e^gain")
    tint: Exponent = Field(default=0.15, description="the same for each colour alone")
    saturation: Fraction = Field(default=0.6, description="by which colour may fade or grow")
    noise: GreyLevels = Field(
        default=6.0, description="deviation of the noise at most, grey levels of 255"
    )


class GeometryAugmentation(Settings):
    """How the frame of whole images is varied; every second image is mirrored."""

    scale: float = Field(
        default=0.25, ge=0, le=2, description="magnification by e^-scale to e^scale"
    )
    stretch: float = Field(default=0.1, ge=0, le=2, description="the same for the width alone")
    rotation: float = Field(default=4.0, ge=0, le=90, description="degrees to either side")
    move: Fraction = Field(default=0.1, description="by this share of the size to either side")
    lower: Fraction = Field(
        default=0.0,
        description="share of the images of which only a lower part is seen: a road uphill",
    )
    cut: float = Field(
        default=0.5, ge=0, le=0.9, description="share of their height that is cut off at most"
    )


class SurfaceAugmentation(Settings):
    """How road and other ground get other colours and grain, each its own: asphalt, gravel, sand.

    On the road that the teacher sees, and on the rest of its ground.
    """

    share: Fraction = Field(default=0.0, description="of the images")
    gain: Exponent = Field(default=0.45, description="brightness by e^-gain to e^gain")
    tint: Exponent = Field(default=0.2, description="the same for each colour alone")
    grain: Fraction = Field(
        default=0.15, description="deviation of the grain at most, share of the level"
    )


class ShadowAugmentation(Settings):
    """How hard shadows fall across images: bands with straight edges, below the horizon."""

    share: Fraction = Field(default=0.0, description="of the images")
    darkest: float = Field(
        default=0.25, gt=0, le=0.7, description="levels in the shadow, of those in the light"
    )
    widest: float = Field(
        default=0.5, gt=0, le=2, description="half the width of a band, share of the image"
    )


class NightAugmentation(Settings):
    """How day becomes night: dark but for what headlights reach, a few lamps, warmer light."""

    share: Fraction = Field(default=0.0, description="of the images")
    darkest: float = Field(
        default=0.03, gt=0, le=1, description="levels where no headlight reaches, of those by day"
    )
    lamps: int = Field(default=6, ge=0, le=100, description="lamps at most, above the road")


class WeatherAugmentation(Settings):
    """How fine days become foul: fog, snow beside the road, a wet road or rain, each as likely."""

    share: Fraction = Field(default=0.0, description="of the images")
    thickest: float = Field(
        default=0.15,
        gt=0,
        le=1,
        description="fog: ground at this depth below the horizon, as "
        "share of the height, is seen by 37 % in the thickest",
    )
    snow: Fraction = Field(default=0.9, description="share of snow's white, at most")
    mirror: Fraction = Field(default=0.6, description="share of a wet road's mirror, at most")
    streaks: Fraction = Field(default=0.02, description="of pixels where a streak begins, at most")


class EgoCarAugmentation(Settings):
    """Ego cars that footage shows, cut out and laid over the lower edge of other images."""

    share: Fraction = Field(default=0.0, description="of the images that get one")
    tallest: Exponent = Field(default=0.7, description="grown in height by at most e to this")
    flattest: Exponent = Field(default=0.3, description="or shrunk by e to this")
    widest: Exponent = Field(default=0.25, description="grown in width likewise")
    light: Exponent = Field(default=0.5, description="gamma and gain by e to this")


class Augmentation(Settings):
    """How whole images are varied."""

    light: LightAugmentation = LightAugmentation()
    geometry: GeometryAugmentation = GeometryAugmentation()
    surface: SurfaceAugmentation = SurfaceAugmentation()
    shadow: ShadowAugmentation = ShadowAugmentation()
    night: NightAugmentation = NightAugmentation()
    weather: WeatherAugmentation = WeatherAugmentation()
    ego_car: EgoCarAugmentation = EgoCarAugmentation()


# --- frame ------------------------------------------------------------------------------


def uniform(generator: torch.Generator, count: int, low: float, high: float) -> Tensor:
    """``count`` numbers between low and high, (count,)."""
    return low + (high - low) * torch.rand(count, generator=generator)


def drawn(generator: torch.Generator, *bounds: tuple[float, float]) -> list[float]:
    """A number between each pair of bounds."""
    return [float(uniform(generator, 1, low, high)) for low, high in bounds]


def draw_frames(
    count: int, size: tuple[int, int], geometry: GeometryAugmentation, at: torch.Generator
) -> Tensor:
    """Affine maps (n,2,3) from a varied frame to the image's, both from -1 to 1.

    Of the whole image: mirrored, nearer, stretched, turned, moved. Or of a lower part of it,
    mirrored, less narrowed than cut.
    """
    mirror = _mirrors(count, at)
    zoom = torch.exp(uniform(at, count, -geometry.scale, geometry.scale))
    width = zoom * torch.exp(uniform(at, count, -geometry.stretch, geometry.stretch))
    angle = uniform(at, count, -geometry.rotation, geometry.rotation) * (math.pi / 180)
    move = [uniform(at, count, -2 * geometry.move, 2 * geometry.move) for _ in range(2)]
    cos, sin, aspect = angle.cos(), angle.sin(), size[1] / size[0]
    across = torch.stack([mirror * cos / width, -sin / (zoom * aspect), move[0]], 1)
    down = torch.stack([mirror * sin * aspect / width, cos / zoom, move[1]], 1)
    whole = torch.stack([across, down], 1)
    is_lower = torch.rand(count, generator=at) < geometry.lower
    mirror = _mirrors(count, at)
    cut = uniform(at, count, 0, geometry.cut)
    width = 1 - cut * uniform(at, count, 0.3, 1)
    aside = (1 - width) * uniform(at, count, -1, 1)
    none = torch.zeros(count)
    across = torch.stack([mirror * width, none, aside], 1)
    lower = torch.stack([across, torch.stack([none, 1 - cut, cut], 1)], 1)
    return torch.where(is_lower[:, None, None], lower, whole)


def _mirrors(count: int, at: torch.Generator) -> Tensor:
    return torch.randint(2, (count,), generator=at) * 2 - 1


def reframed(maps: Tensor, frames: Tensor, outside: str) -> Tensor:
    """Maps (n,C,H,W) seen in other frames (n,2,3); outside: "border" or "zeros"."""
    grid = F.affine_grid(frames, list(maps.shape), align_corners=False)
    return F.grid_sample(maps, grid, padding_mode=outside, align_corners=False)


# --- light ------------------------------------------------------------------------------


def relit(image: Tensor, light: LightAugmentation, at: torch.Generator) -> Tensor:
    """An image (1,3,H,W) in [0,1] in another light, as another sensor would see it."""
    adjust = import_torchvision().transforms.v2.functional
    gamma, gain = (math.exp(drawn(at, (-top, top))[0]) for top in (light.gamma, light.gain))
    tint = torch.exp(uniform(at, 3, -light.tint, light.tint)).reshape(1, 3, 1, 1)
    colour, noise = drawn(at, (1 - light.saturation, 1 + light.saturation), (0, light.noise / 255))
    image = adjust.adjust_saturation(adjust.adjust_gamma(image, gamma), colour)
    return (image * gain * tint + noise * torch.randn(image.shape, generator=at)).clamp(0, 1)


def resurfaced(
    image: Tensor, road: Tensor, ground: Tensor, surface: SurfaceAugmentation, at: torch.Generator
) -> Tensor:
    """An image (1,3,H,W) in [0,1] with other surfaces on its road and its ground.

    road, ground: shares (1,1,H,W) in [0,1], of one another's outside. Colours and grain change
    against one another, shapes stay: what is road does not hang on its being grey.
    """
    for share in (road, ground):
        colour = torch.exp(uniform(at, 3, -surface.tint, surface.tint)).reshape(1, 3, 1, 1)
        gain = torch.exp(uniform(at, 1, -surface.gain, surface.gain))
        depth = uniform(at, 1, 0, surface.grain)
        new = gain * colour * (1 + depth * grain(image.shape[-2:], at))
        image = image * (1 + share * (new - 1))
    return image.clamp(0, 1)


def grain(size: Sequence[int], at: torch.Generator) -> Tensor:
    """Noise (1,1,H,W) of several widths, of about unit deviation."""
    layers = [
        F.interpolate(
            torch.randn(1, 1, max(2, across * size[0] // size[1]), across, generator=at),
            size=(size[0], size[1]),
            mode="bilinear",
        )
        for across in GRAIN_CELLS
    ]
    return torch.stack(layers).sum(0)


def shaded(image: Tensor, shadow: ShadowAugmentation, at: torch.Generator) -> Tensor:
    """An image (1,3,H,W) in [0,1] with a hard shadow across its lower part.

    A band at any angle: of a bridge or a wall across the road, of a row of houses along it.
    """
    height, width = image.shape[-2:]
    down = torch.linspace(0, 1, height)[:, None]
    along = torch.linspace(-0.5, 0.5, width)
    angle, aside, half = drawn(at, (0, math.pi), (-0.3, 0.3), (0.05, shadow.widest))
    edge, horizon = drawn(at, (0.002, 0.03), (0.3, 0.6))
    off = along * math.cos(angle) + (down - 0.65) * math.sin(angle) - aside
    inside = ((half - off.abs()) / edge).sigmoid() * ((down - horizon) / SHADOW_END).sigmoid()
    (level,) = drawn(at, (shadow.darkest, MAX_SHADOW_LEVEL))
    return image * (1 - (1 - level) * inside)


def at_night(image: Tensor, unlit: Tensor, night: NightAugmentation, at: torch.Generator) -> Tensor:
    """An image (1,3,H,W) in [0,1] at night, as headlights and a few lamps show it.

    unlit: shares (1,1,H,W) in [0,1] that the headlights leave dark: the ego car and the sky. The
    light begins below the horizon, widens towards the camera and is strongest a little way ahead.
    """
    height, width = image.shape[-2:]
    down = torch.linspace(0, 1, height)[:, None]
    across = torch.linspace(-0.5, 0.5, width)
    ranges = (0.35, 0.55), (-0.1, 0.1), (0.4, 1.5), (0.15, 0.35)
    horizon, aside, spread, nearest = drawn(at, *ranges)
    below = (down - horizon).clamp_min(0)
    beam = torch.exp(-(((across - aside) / (0.06 + spread * below)) ** 2))
    reach = (below / nearest) * torch.exp(1 - below / nearest)
    dark = float(torch.exp(uniform(at, 1, math.log(night.darkest), math.log(0.3))))
    light = dark + (1 - dark) * beam * reach * (1 - unlit)
    warmth = float(uniform(at, 1, 0, 0.3))
    tint = torch.tensor([1 + warmth, 1, 1 - warmth]).reshape(1, 3, 1, 1)
    lamps = sum(
        (lamp(image.shape[-2:], horizon, at) for _ in range(int(uniform(at, 1, 0, night.lamps)))),
        torch.zeros(1, 1, height, width),
    )
    return (image * light * tint + lamps * tint).clamp(0, 1)


# --- weather ----------------------------------------------------------------------------


class Scene(NamedTuple):
    """What weather lies on, shares (1,1,H,W) in [0,1]: sky, ground with its road, road, ego car."""

    sky: Tensor
    ground: Tensor
    road: Tensor
    ego: Tensor


def in_weather(
    image: Tensor, scene: Scene, weather: WeatherAugmentation, at: torch.Generator
) -> Tensor:
    """An image (1,3,H,W) in [0,1] in fog, snow or rain, or with a wet road."""
    kind = (in_fog, under_snow, wetted, in_rain)[int(torch.randint(4, (), generator=at))]
    street = kind(image, scene, weather, at).clamp(0, 1)
    return torch.lerp(street, image, scene.ego)


def horizon_of(scene: Scene) -> float:
    """Share of the height at which the ground begins in the middle of the image."""
    rows = (scene.ground + scene.ego).clamp_max(1).mean((0, 1, 3))
    return 1 - float(rows.sum()) / len(rows)


def in_fog(
    image: Tensor, scene: Scene, weather: WeatherAugmentation, at: torch.Generator
) -> Tensor:
    """Air that hides what is far: a row of ground is as far as 1 over its depth below the horizon.

    What stands is as far as the ground below it; of the sky nothing is seen.
    """
    height = image.shape[-2]
    down = torch.linspace(0, 1, height)[:, None] - horizon_of(scene) + 0.05
    far = scene.ground * (1 / down.clamp_min(0.02))
    far = far.flip(-2).cummax(-2).values.flip(-2)
    wide = image.shape[-1] // 8  # air has no edges
    far = F.avg_pool2d(far, (1, 2 * wide + 1), 1, (0, wide), count_include_pad=False)
    thick, level = drawn(at, (0.02, weather.thickest), (1, 2))
    level = min(0.9, level * float(image.mean()))
    seen = torch.exp(-thick * far) * (1 - scene.sky)
    tint = 1 + uniform(at, 3, -0.05, 0.05).reshape(1, 3, 1, 1)
    return torch.lerp(level * tint.expand_as(image), image, seen)


def under_snow(
    image: Tensor, scene: Scene, weather: WeatherAugmentation, at: torch.Generator
) -> Tensor:
    """Snow in patches on the ground beside the road, on some days on the road as well."""
    on_road, much, level = drawn(at, (-0.6, 0.4), (0.3, weather.snow), (0.5, 1.0))
    lies = scene.ground * (1 - scene.road) + scene.road * max(on_road, 0)
    patches = (2 * grain(image.shape[-2:], at) + 2 * float(uniform(at, 1, -0.5, 2))).sigmoid()
    return torch.lerp(image, torch.full_like(image, level), much * lies * patches)


def wetted(
    image: Tensor, scene: Scene, weather: WeatherAugmentation, at: torch.Generator
) -> Tensor:
    """A darker road whose puddles mirror what stands beyond it."""
    height, horizon = image.shape[-2], horizon_of(scene)
    rows = 2 * horizon * height - torch.arange(height)
    mirrored = image[..., rows.round().long().clamp(0, height - 1), :]
    shine, dark = drawn(at, (0.15, weather.mirror), (0.5, 1.0))
    puddles = (3 * grain(image.shape[-2:], at) + float(uniform(at, 1, -2, 3))).sigmoid()
    wet = scene.road * puddles
    return torch.lerp(image * (1 - wet * (1 - dark)), mirrored, shine * wet)


def in_rain(
    image: Tensor, scene: Scene, weather: WeatherAugmentation, at: torch.Generator
) -> Tensor:
    """Streaks that fall, drops on the glass that blur what is behind them, and a veil."""
    size, level = image.shape[-2:], float(image.mean()) * 1.3 + 0.1
    share, veil, drops = drawn(at, (0, weather.streaks), (0, 0.3), (0, 0.02))
    starts = (torch.rand(1, 1, *size, generator=at) < share).to(image)
    long = 2 * int(uniform(at, 1, 1, 7)) + 1
    streaks = F.max_pool2d(starts, (long, 1), 1, (long // 2, 0)) * 0.4
    blurred = F.avg_pool2d(image.flip(-2), 9, 1, 4, count_include_pad=False)
    glass = (torch.rand(1, 1, *size, generator=at) < drops / 5).to(image)
    glass = F.avg_pool2d(F.max_pool2d(glass, 7, 1, 3), 3, 1, 1)
    image = torch.lerp(torch.lerp(image, torch.full_like(image, level), streaks), blurred, glass)
    return torch.lerp(image, torch.full_like(image, level), veil)


def lamp(size: Sequence[int], horizon: float, at: torch.Generator) -> Tensor:
    """The light (1,1,H,W) of one lamp or of another car's headlights, not below the horizon."""
    ranges = (0.1, horizon + 0.02), (0, 1), (0.003, 0.02), (0.3, MAX_LAMP)
    row, column, wide, peak = drawn(at, *ranges)
    down = torch.linspace(0, size[0] / size[1], size[0])[:, None] - row * size[0] / size[1]
    across = torch.linspace(0, 1, size[1]) - column
    return (peak * torch.exp(-(down**2 + across**2) / wide**2))[None, None]


# --- ego cars ---------------------------------------------------------------------------


class EgoCar(NamedTuple):
    """A frame (1,3,H,W) in [0,1] and where in it the ego car is, (1,1,H,W), 0 or 1."""

    image: Tensor
    ego: Tensor


def draw_ego_car(
    recordings: Mapping[str, Sequence[Path]], settings: EgoCarAugmentation, at: torch.Generator
) -> EgoCar:
    """A varied ego car: each recording is as likely, and each of its prepared frames."""
    names = sorted(recordings)
    frames = recordings[names[int(torch.randint(len(names), (), generator=at))]]
    path = frames[int(torch.randint(len(frames), (), generator=at))]
    arrays = read_arrays(path, "image", "ego")
    ego = from_bytes(arrays["ego"])[None, None] > 0.75  # 0.5 is unknown
    return varied(EgoCar(from_bytes(arrays["image"])[None], ego.to(torch.float32)), settings, at)


def varied(car: EgoCar, settings: EgoCarAugmentation, at: torch.Generator) -> EgoCar:
    """The ego car larger or smaller, mirrored, in another light; its lower edge stays below."""
    adjust = import_torchvision().transforms.v2.functional
    grown = float(torch.exp(uniform(at, 1, -settings.flattest, settings.tallest)))
    wider = float(torch.exp(uniform(at, 1, 0, settings.widest)))  # no gap at the sides
    mirror = 1 - 2 * int(torch.randint(2, (), generator=at))
    aside = float(uniform(at, 1, -1, 1)) * (1 - 1 / wider)
    frame = torch.tensor([[[mirror / wider, 0, aside], [0, 1 / grown, 1 - 1 / grown]]])
    gamma, gain, *tint = torch.exp(uniform(at, 5, -settings.light, settings.light)).tolist()
    image = adjust.adjust_gamma(reframed(car.image, frame, "border"), gamma) * gain
    colour = torch.tensor(tint).pow(EGO_TINT).reshape(1, 3, 1, 1)
    return EgoCar((image * colour).clamp(0, 1), reframed(car.ego, frame, "border"))


def laid_over(image: Tensor, targets: Tensor, car: EgoCar) -> tuple[Tensor, Tensor]:
    """An image (1,3,H,W) and its targets (1,8,H,W) with the ego car over them.

    On it there is no road and no layout that counts, and the ego car is known.
    """
    over = (car.ego > 0.5).to(targets)
    target = targets.new_tensor([0.0] * CLASSES + [0, 0, 1, 1, 1]).reshape(1, -1, 1, 1)
    return torch.lerp(image, car.image, car.ego), torch.lerp(targets, target, over)
