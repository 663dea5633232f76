"""What rendered scenes are painted on: a canvas of twice the size, and the camera above the road.

A stroke paints the picture and the class map alike, so that the truth is exact to half a pixel.
Class numbers are CamVid's.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import cv2
import numpy as np
import torch
from torch import Tensor

from roadtorch.layout import classes as layout

SKY, BUILDING, ROAD, PAVEMENT, TREE, CAR, VOID = 0, 1, 3, 4, 5, 8, 11

LAYOUT_OF_CLASS = np.full(12, layout.VERTICAL, np.uint8)
LAYOUT_OF_CLASS[[SKY, ROAD, PAVEMENT]] = layout.SKY, layout.HORIZONTAL, layout.HORIZONTAL
CAMERA_HEIGHT = 1.35  # metres above the road


@dataclass(frozen=True)
class RenderedScene:
    """A picture and everything that is true about it."""

    image: Tensor  # float32 (3,H,W) in [0,1], sRGB
    road: Tensor  # bool (H,W)
    layout: Tensor  # uint8 (H,W): 0 sky, 1 vertical, 2 horizontal
    void: Tensor  # bool (H,W): the unknown object
    classes: Tensor  # uint8 (H,W): CamVid's class numbers


@dataclass(frozen=True)
class RenderedStreet:
    """What is being looked at; lengths in metres, light in [0, 1]."""

    horizon: float  # share of the height above the horizon
    curvature: float  # lateral metres per squared metre ahead
    heading: float  # lateral metres per metre ahead
    road_width: float
    pavement: float  # width of each pavement
    offset: float  # of the camera from the road's middle
    shadows: float  # how many bands
    cars: float  # how many
    dusk: float  # 0 noon, 1 late dusk
    noise: float  # standard deviation of the sensor's noise

    def middle(self, ahead: np.ndarray | float) -> np.ndarray | float:
        """Lateral place of the road's middle, metres to the right of the camera."""
        return self.heading * ahead + self.curvature * ahead**2 - self.offset


def draw_street(generator: np.random.Generator, **options: float) -> RenderedStreet:
    """A random street; any field of RenderedStreet can be fixed by name."""
    chosen: dict[str, float] = {
        "horizon": generator.uniform(0.36, 0.56),
        "curvature": generator.uniform(-0.005, 0.005),
        "heading": generator.uniform(-0.03, 0.03),
        "road_width": generator.uniform(6.0, 9.5),
        "pavement": generator.uniform(1.6, 3.2),
        "offset": generator.uniform(-1.8, 0.6),
        "shadows": int(generator.integers(0, 4)),
        "cars": int(generator.integers(0, 4)),
        "dusk": float(generator.choice([0.0, 0.15, 0.3, 0.8])),
        "noise": generator.uniform(0.004, 0.02),
    }
    return RenderedStreet(**{**chosen, **options})  # an unknown option is a TypeError


class Canvas:
    """A picture and its class map, painted together."""

    def __init__(self, height: int, width: int, street: RenderedStreet) -> None:
        self.height, self.width = height, width
        self.street = street
        self.focal = 0.95 * max(width, height * 4 / 3)  # pixels
        self.horizon = street.horizon * height
        self.rgb = np.zeros((height, width, 3), np.float32)
        self.classes = np.full((height, width), SKY, np.uint8)

    def project(self, right: float, up: float, ahead: float) -> tuple[float, float]:
        """The pixel (x, y) of a point in metres from the camera's foot on the road."""
        x = self.width / 2 + self.focal * right / ahead
        return x, self.horizon + self.focal * (CAMERA_HEIGHT - up) / ahead

    def polygon(self, points: Iterable[tuple[float, float]], colour: np.ndarray, kind: int) -> None:
        """Fill a polygon of pixel points with a colour (3,) or a picture (H,W,3)."""
        mask = np.zeros((self.height, self.width), np.uint8)
        corners = np.clip(np.array(list(points)) * 16, -3e5, 3e5)  # 4 fractional bits
        cv2.fillPoly(mask, [np.round(corners).astype(np.int32)], 1, shift=4)
        inside = around(corners / 16)
        chosen = mask[inside].astype(bool)
        self.rgb[inside][chosen] = colour[inside][chosen] if np.ndim(colour) == 3 else colour
        self.classes[inside][chosen] = kind

    def fill(self, mask: np.ndarray, colour: np.ndarray, kind: int) -> None:
        """Give the pixels of a mask a colour and a class."""
        self.rgb[mask] = colour[mask] if np.ndim(colour) == 3 else colour
        self.classes[mask] = kind


def around(corners: np.ndarray) -> tuple[slice, slice]:
    """Rows and columns of a picture that hold a polygon of pixel points (n,2), and some more."""
    first = np.maximum(np.floor(corners.min(0)).astype(int) - 1, 0)
    last = np.maximum(np.ceil(corners.max(0)).astype(int) + 2, 0)
    return slice(first[1], last[1]), slice(first[0], last[0])


def cloth(generator: np.random.Generator, size: int = 256, octaves: int = 5) -> np.ndarray:
    """Tileable fractal noise (size, size) with mean 0 and standard deviation 1."""
    total = np.zeros((size, size), np.float32)
    for octave in range(octaves):
        cells = 2 ** (octave + 3)
        coarse = generator.standard_normal((cells, cells)).astype(np.float32)
        tiled = np.pad(coarse, 2, mode="wrap")
        scale = size // cells
        smooth = cv2.resize(tiled, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
        total += 0.75**octave * smooth[2 * scale : -2 * scale, 2 * scale : -2 * scale]
    return (total - total.mean()) / total.std()


def seen_ground(canvas: Canvas) -> tuple[np.ndarray, np.ndarray]:
    """Metres to the right and ahead of the camera, (H,W), of every pixel below the horizon."""
    rows = np.arange(canvas.height)[:, None] + 0.5
    below = np.maximum(rows - canvas.horizon, 1e-3)
    ahead = np.broadcast_to(canvas.focal * CAMERA_HEIGHT / below, canvas.classes.shape)
    columns = np.arange(canvas.width)[None, :] + 0.5
    return (columns - canvas.width / 2) * ahead / canvas.focal, ahead


def photograph(canvas: Canvas, generator: np.random.Generator) -> np.ndarray:
    """What the camera makes of it, (H,W,3): light, lens, noise and eight bits."""
    dusk = canvas.street.dusk
    light = np.array([1.0, 1 - 0.08 * dusk, 1 - 0.05 * dusk]) * (1 - 0.5 * dusk)
    rgb = canvas.rgb * light
    if dusk:  # the sky stays brighter than the street
        rgb = np.where((canvas.classes == SKY)[..., None], canvas.rgb * (1 - 0.25 * dusk), rgb)
    rgb = cv2.GaussianBlur(rgb, (0, 0), 1.1)
    rgb = rgb.reshape(canvas.height // 2, 2, canvas.width // 2, 2, 3).mean((1, 3))
    rgb = rgb + generator.normal(0, canvas.street.noise, rgb.shape) * (0.4 + np.sqrt(np.abs(rgb)))
    return np.round(np.clip(rgb, 0, 1) * 255).astype(np.uint8)


def developed(canvas: Canvas, generator: np.random.Generator) -> RenderedScene:
    """The photograph of a canvas, at half its size, with its truth."""
    rgb = photograph(canvas, generator)
    classes = canvas.classes[::2, ::2].copy()
    return RenderedScene(
        image=torch.from_numpy(rgb.transpose(2, 0, 1).astype(np.float32) / 255),
        road=torch.from_numpy(classes == ROAD),
        layout=torch.from_numpy(LAYOUT_OF_CLASS[classes]),
        void=torch.from_numpy(classes == VOID),
        classes=torch.from_numpy(classes),
    )
