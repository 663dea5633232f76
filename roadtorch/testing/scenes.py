"""Rendered street scenes with exact ground truth, seen from a camera in a car.

A scene is painted back to front on a canvas of twice the size: sky, ground (every pixel below the
horizon is projected to the road plane, in metres), houses and trees, cars, one unknown object. The
same strokes paint the image and the class map, so the truth is exact to half a pixel. Class numbers
are CamVid's.

``python -m roadtorch.testing.scenes --out DIR --count 6`` writes sample images.
"""

import argparse
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import torch
from torch import Tensor

from roadtorch.base.image import write_rgb
from roadtorch.layout import classes as layout

SCENE_SKY, BUILDING, ROAD, PAVEMENT, TREE, CAR, VOID = 0, 1, 3, 4, 5, 8, 11

LAYOUT_OF_CLASS = np.full(12, layout.VERTICAL, np.uint8)
LAYOUT_OF_CLASS[[SCENE_SKY, ROAD, PAVEMENT]] = layout.SKY, layout.HORIZONTAL, layout.HORIZONTAL
CAMERA_HEIGHT = 1.35  # metres above the road
MAX_DISTANCE = 90.0  # metres: nothing upright stands farther away


@dataclass(frozen=True, eq=False)
class RenderedScene:
    """A rendered image and its ground truth."""

    image: Tensor  # float32 (3,H,W) in [0,1], sRGB
    road: Tensor  # bool (H,W)
    layout: Tensor  # uint8 (H,W): 0 sky, 1 vertical, 2 horizontal
    void: Tensor  # bool (H,W): the unknown object
    classes: Tensor  # uint8 (H,W): CamVid's class numbers


@dataclass(frozen=True)
class RenderedStreet:
    """Parameters of a street; lengths in metres, light in [0, 1]."""

    horizon: float  # fraction of the height above the horizon
    curvature: float  # lateral metres per squared metre ahead
    heading: float  # lateral metres per metre ahead
    road_width: float
    pavement: float  # width of each pavement
    offset: float  # of the camera from the road's middle
    shadows: float  # number of shadow bands
    cars: float  # number of cars
    dusk: float  # 0 noon, 1 late dusk
    noise: float  # standard deviation of the sensor's noise

    def middle(self, ahead: np.ndarray | float) -> np.ndarray | float:
        """Return the lateral position of the road's middle, metres to the right of the camera."""
        return self.heading * ahead + self.curvature * ahead**2 - self.offset


def sample_street(generator: np.random.Generator, **options: float) -> RenderedStreet:
    """Sample a random street; any field of RenderedStreet can be fixed by name."""
    parameters: dict[str, float] = {
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
    return RenderedStreet(**{**parameters, **options})  # an unknown option is a TypeError


class Canvas:
    """An image and its class map, painted together."""

    def __init__(self, height: int, width: int, street: RenderedStreet) -> None:
        self.height, self.width = height, width
        self.street = street
        self.focal = 0.95 * max(width, height * 4 / 3)  # pixels
        self.horizon = street.horizon * height
        self.rgb = np.zeros((height, width, 3), np.float32)
        self.classes = np.full((height, width), SCENE_SKY, np.uint8)

    def project(self, right: float, up: float, ahead: float) -> tuple[float, float]:
        """Project a point, in metres from the camera's foot on the road, to a pixel (x, y)."""
        x = self.width / 2 + self.focal * right / ahead
        return x, self.horizon + self.focal * (CAMERA_HEIGHT - up) / ahead

    def polygon(self, points: Iterable[tuple[float, float]], colour: np.ndarray, code: int) -> None:
        """Fill a polygon of pixel points with a colour (3,) or an image (H, W, 3)."""
        mask = np.zeros((self.height, self.width), np.uint8)
        corners = np.clip(np.array(list(points)) * 16, -3e5, 3e5)  # 4 fractional bits
        cv2.fillPoly(mask, [np.round(corners).astype(np.int32)], 1, shift=4)
        box = bounding_box(corners / 16)
        inside = mask[box].astype(bool)
        self.rgb[box][inside] = colour[box][inside] if np.ndim(colour) == 3 else colour
        self.classes[box][inside] = code

    def fill(self, mask: np.ndarray, colour: np.ndarray, code: int) -> None:
        """Fill the pixels of a mask with a colour and a class."""
        self.rgb[mask] = colour
        self.classes[mask] = code


def bounding_box(corners: np.ndarray) -> tuple[slice, slice]:
    """Return rows and columns of a box around a polygon of pixel points (n, 2), with a margin."""
    first = np.maximum(np.floor(corners.min(0)).astype(int) - 1, 0)
    last = np.maximum(np.ceil(corners.max(0)).astype(int) + 2, 0)
    return slice(first[1], last[1]), slice(first[0], last[0])


def fractal_noise(generator: np.random.Generator, size: int = 256, octaves: int = 5) -> np.ndarray:
    """Generate tileable fractal noise (size, size) with mean 0 and standard deviation 1."""
    total = np.zeros((size, size), np.float32)
    for octave in range(octaves):
        cells = 2 ** (octave + 3)
        coarse = generator.standard_normal((cells, cells)).astype(np.float32)
        tiled = np.pad(coarse, 2, mode="wrap")
        scale = size // cells
        smooth = cv2.resize(tiled, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
        total += 0.75**octave * smooth[2 * scale : -2 * scale, 2 * scale : -2 * scale]
    return (total - total.mean()) / total.std()


def expose(canvas: Canvas, generator: np.random.Generator) -> RenderedScene:
    """Simulate the camera: half the canvas's size, with light, lens blur, noise and eight bits."""
    dusk = canvas.street.dusk
    light = np.array([1.0, 1 - 0.08 * dusk, 1 - 0.05 * dusk]) * (1 - 0.5 * dusk)
    rgb = canvas.rgb * light
    if dusk:  # the sky stays brighter than the street
        rgb = np.where(
            (canvas.classes == SCENE_SKY)[..., None], canvas.rgb * (1 - 0.25 * dusk), rgb
        )
    rgb = cv2.GaussianBlur(rgb, (0, 0), 1.1)
    rgb = rgb.reshape(canvas.height // 2, 2, canvas.width // 2, 2, 3).mean((1, 3))
    rgb = rgb + generator.normal(0, canvas.street.noise, rgb.shape) * (0.4 + np.sqrt(np.abs(rgb)))
    levels = np.round(np.clip(rgb, 0, 1) * 255).astype(np.uint8)
    classes = canvas.classes[::2, ::2].copy()
    return RenderedScene(
        image=torch.from_numpy(levels.transpose(2, 0, 1).astype(np.float32) / 255),
        road=torch.from_numpy(classes == ROAD),
        layout=torch.from_numpy(LAYOUT_OF_CLASS[classes]),
        void=torch.from_numpy(classes == VOID),
        classes=torch.from_numpy(classes),
    )


# --- painting ------------------------------------------------------------------------------


def paint_sky(canvas: Canvas, generator: np.random.Generator) -> None:
    """Paint a gradient, pale at the horizon, with soft clouds."""
    dusk = canvas.street.dusk
    zenith = np.array([0.36, 0.55, 0.86]) * (1 - dusk) + dusk * np.array([0.34, 0.38, 0.52])
    pale = np.array([0.86, 0.88, 0.92]) - dusk * np.array([0.1, 0.2, 0.22])
    depth = np.clip(np.arange(canvas.height) / canvas.horizon, 0, 1)[:, None, None]
    canvas.rgb[:] = zenith + (pale - zenith) * depth**0.8
    clouds = cv2.resize(fractal_noise(generator, octaves=3), (canvas.width, canvas.height))
    cover = np.clip(0.35 * clouds - generator.uniform(-0.3, 0.3), 0, 0.8)[..., None]
    canvas.rgb[:] = canvas.rgb * (1 - cover) + cover * (pale * 1.04)


def paint_ground(canvas: Canvas, generator: np.random.Generator) -> None:
    """Paint road with lane marks, kerbs, pavements, verges and shadows on the road plane.

    Every pixel below the horizon has a position there: metres to the right of the camera and ahead
    of it, and across the road, to the right of its middle.
    """
    street = canvas.street
    rows = np.arange(canvas.height)[:, None] + 0.5
    columns = np.arange(canvas.width)[None, :] + 0.5
    ground = np.broadcast_to(rows > canvas.horizon, canvas.classes.shape)
    below = np.maximum(rows - canvas.horizon, 1e-3)
    ahead = np.broadcast_to(canvas.focal * CAMERA_HEIGHT / below, canvas.classes.shape)
    right = (columns - canvas.width / 2) * ahead / canvas.focal
    across = right - street.middle(ahead)
    grain = sample_texture(fractal_noise(generator), right * 23, ahead * 23) * np.clip(
        8 / ahead, 0.15, 1
    )
    patches = sample_texture(fractal_noise(generator, octaves=3), right * 5, ahead * 5)
    margin = np.abs(across) - street.road_width / 2
    colours = ground_colours(generator)
    for colour, code, where in (
        (colours["verge"], PAVEMENT, ground),
        (colours["pavement"], PAVEMENT, ground & (margin < street.pavement)),
        (colours["kerb"], PAVEMENT, ground & (margin < 0.22)),
        (colours["road"], ROAD, ground & (margin < 0)),
    ):
        canvas.fill(where, colour, code)
    slabs = ground & (margin > 0.22) & (margin < street.pavement)
    joints = ((across / 0.75) % 1 < 0.05) | ((ahead / 0.75) % 1 < 0.07)
    canvas.rgb[slabs & joints & (ahead < 25)] *= 0.86
    canvas.rgb[ground] *= (1 + 0.05 * grain + 0.04 * patches)[ground][:, None]
    marks = np.abs(across) < 0.07 + ahead / 700
    marks &= (ahead + generator.uniform(0, 7)) % 7 < 3.2
    marks |= np.abs(margin + 0.35) < 0.06
    canvas.rgb[ground & marks] = colours["mark"] * (1 + 0.05 * patches[ground & marks][:, None])
    shade = sample_shadows(generator, street, across, ahead)
    canvas.rgb[ground] *= shade[ground][:, None] ** np.array([1.08, 1.0, 0.88])  # bluish


def ground_colours(generator: np.random.Generator) -> dict[str, np.ndarray]:
    """Sample colours of the ground's parts: greys that differ in lightness and a little in hue."""
    base = generator.uniform(0.3, 0.46)
    tint = generator.normal(0, 0.008, 3)
    paving = np.array([1.0, 0.95, 0.87]) * min(base + generator.uniform(0.14, 0.26), 0.75)
    grass = np.array([0.34, 0.44, 0.2]) * generator.uniform(0.8, 1.2)
    return {
        "road": np.array([1.0, 1.0, 1.02]) * base + tint,
        "pavement": paving,
        "kerb": paving * 1.12,
        "verge": grass if generator.random() < 0.5 else paving * 0.9,
        "mark": np.array([0.86, 0.86, 0.82]),
    }


def sample_texture(texture: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Look up a tileable texture at (x, y), nearest cell."""
    size = texture.shape[0]
    return texture[y.astype(np.int64) % size, x.astype(np.int64) % size]


def sample_shadows(
    generator: np.random.Generator, street: RenderedStreet, across: np.ndarray, ahead: np.ndarray
) -> np.ndarray:
    """Sample the light on the ground, (H, W) in (0, 1]: shadow bands across the road."""
    light = np.ones_like(across)
    for _ in range(int(street.shadows)):
        near = generator.uniform(4.5, 22)
        length = generator.uniform(1.5, 6.0)
        slope = generator.uniform(-0.6, 0.6)
        end = generator.uniform(-2.0, 2.0)
        side = generator.choice([-1.0, 1.0])
        wobble = 0.3 * np.sin(across * generator.uniform(1, 3))
        inside = np.abs(ahead - near - slope * across + wobble) < length / 2
        inside &= side * across < end + street.road_width / 2
        light[inside] = np.minimum(light[inside], generator.uniform(0.4, 0.65))
    return light


def paint_side(canvas: Canvas, side: float, generator: np.random.Generator) -> None:
    """Paint houses and trees along one side of the street, the farthest first."""
    street = canvas.street
    begin = MAX_DISTANCE
    gap = street.road_width / 2 + street.pavement
    while begin > 5:
        depth = generator.uniform(5, 13)
        back = generator.uniform(0.2, 3)
        if generator.random() < 0.68:
            near = max(begin - depth, 2.5)
            paint_house(canvas, side, gap + back, (near, begin), generator)
        else:
            paint_tree(canvas, side * (gap + back * 0.5), begin - depth / 2, generator)
        begin -= depth * generator.uniform(0.8, 1.1)


def paint_house(
    canvas: Canvas,
    side: float,
    distance: float,
    span: tuple[float, float],
    generator: np.random.Generator,
) -> None:
    """Paint a house: the wall along the street, with dark panes, and its front wall."""
    near, far = span
    height = generator.uniform(4, 12)
    palette = [(0.62, 0.42, 0.34), (0.78, 0.74, 0.66), (0.55, 0.5, 0.45), (0.7, 0.66, 0.62)]
    colour = np.array(palette[generator.integers(len(palette))]) * generator.uniform(0.75, 1.1)
    start = float(canvas.street.middle(near)) + side * distance
    end = float(canvas.street.middle(far)) + side * distance
    out = start + side * 14
    front = [(start, 0, near), (out, 0, near), (out, height, near), (start, height, near)]
    wall = [(start, 0, near), (end, 0, far), (end, height, far), (start, height, near)]
    for points, light in ((front, 0.8), (wall, 1.0 if side > 0 else 0.72)):
        canvas.polygon((canvas.project(*p) for p in points), colour * light, BUILDING)
    pane = np.array([0.2, 0.24, 0.3])
    lamp = (0.25 if canvas.street.dusk > 0.5 else 0.0) * np.array([1.0, 0.8, 0.3])
    for floor in np.arange(1.0, height - 1.6, 2.7):
        for ahead in np.arange(near + 0.8, far - 1.2, 2.2):
            left, right = (
                start + (end - start) * ((edge - near) / (far - near))
                for edge in (float(ahead), float(ahead) + 1.1)
            )
            corners = [(left, floor, ahead), (right, floor, ahead + 1.1)]
            corners += [(right, floor + 1.4, ahead + 1.1), (left, floor + 1.4, ahead)]
            glass = pane + lamp * (int(ahead * 7 + floor) % 3 == 0)
            canvas.polygon((canvas.project(*p) for p in corners), glass, BUILDING)


def paint_tree(canvas: Canvas, across: float, ahead: float, generator: np.random.Generator) -> None:
    """Paint a trunk under a crown of leafy blobs."""
    ahead = max(ahead, 4.0)
    right = float(canvas.street.middle(ahead)) + across
    corners = [(-0.15, 0), (0.15, 0), (0.12, 3), (-0.12, 3)]
    trunk = [canvas.project(right + dx, up, ahead) for dx, up in corners]
    canvas.polygon(trunk, np.array([0.27, 0.2, 0.14]), TREE)
    green = np.array([0.22, 0.34, 0.13]) * generator.uniform(0.7, 1.2)
    leaves = cv2.resize(fractal_noise(generator, 128, 4), (canvas.width, canvas.height))
    image = (green * (1 + 0.25 * leaves[..., None])).astype(np.float32)
    turn = np.linspace(0, 2 * np.pi, 15)[:-1]
    for _ in range(7):
        middle = right + generator.normal(0, 0.9), 4 + generator.normal(0, 0.8)
        radius = generator.uniform(0.8, 1.5) * (1 + 0.15 * generator.standard_normal(turn.size))
        x, y = middle[0] + radius * np.cos(turn), middle[1] + radius * np.sin(turn)
        ring = [canvas.project(*point, ahead) for point in zip(x, y, strict=True)]
        canvas.polygon(ring, image, TREE)


def paint_cars(canvas: Canvas, generator: np.random.Generator) -> None:
    """Paint moving and parked cars, the farthest first, each with its shadow on the road."""
    half = canvas.street.road_width / 2
    lanes = [-half / 2, half / 2, half - 1.0, -half + 1.0]
    for ahead in sorted(generator.uniform(9, 32, int(canvas.street.cars)), reverse=True):
        across = lanes[generator.integers(len(lanes))]
        paint_car(canvas, float(canvas.street.middle(ahead)) + across, ahead, generator)


def paint_car(canvas: Canvas, right: float, ahead: float, generator: np.random.Generator) -> None:
    """Paint the back of a car: wheels, body, cabin, rear window and lamps."""
    palette = [(0.7, 0.12, 0.1), (0.12, 0.2, 0.45), (0.82, 0.82, 0.84), (0.1, 0.1, 0.11)]
    colour = np.array(palette[generator.integers(len(palette))])
    shade = [(-0.95, -0.35), (0.95, -0.35), (0.95, 4), (-0.95, 4)]
    mask = np.zeros(canvas.classes.shape, np.uint8)
    corners = [canvas.project(right + x, 0, ahead + z) for x, z in shade]
    cv2.fillPoly(mask, [np.round(corners).astype(np.int32)], 1)
    canvas.rgb[(mask > 0) & (canvas.classes == ROAD)] *= 0.35  # a shadow: still road
    boxes: list[tuple[tuple[float, ...], tuple[float, float], float, np.ndarray]] = [
        ((-0.85, -0.6, -0.6, -0.85), (0.0, 0.4), 0.0, np.full(3, 0.06)),
        ((0.6, 0.85, 0.85, 0.6), (0.0, 0.4), 0.0, np.full(3, 0.06)),
        ((-0.8, 0.8, 0.62, -0.62), (0.9, 1.5), 1.2, colour * 0.8),
        ((-0.88, 0.88, 0.88, -0.88), (0.25, 0.95), 0.0, colour),
        ((-0.66, 0.66, 0.56, -0.56), (0.98, 1.4), 0.6, np.array([0.16, 0.19, 0.24])),
        ((-0.86, -0.66, -0.66, -0.86), (0.7, 0.85), 0.0, np.array([0.8, 0.1, 0.08])),
        ((0.66, 0.86, 0.86, 0.66), (0.7, 0.85), 0.0, np.array([0.8, 0.1, 0.08])),
    ]
    for xs, (low, high), behind, tone in boxes:
        corners = zip(xs, (low, low, high, high), strict=True)
        canvas.polygon(
            [canvas.project(right + x, u, ahead + behind) for x, u in corners], tone, CAR
        )


def paint_unknown(canvas: Canvas, generator: np.random.Generator) -> None:
    """Paint an object of no class on the pavement: the void of the truth."""
    street = canvas.street
    ahead = generator.uniform(14, 22)
    side = generator.choice([-1.0, 1.0])
    right = float(street.middle(ahead)) + side * (street.road_width / 2 + 0.9)
    corners = [(-0.35, 0), (0.35, 0), (0.4, 1.1), (-0.4, 1.1)]
    points = [canvas.project(right + x, up, ahead) for x, up in corners]
    canvas.polygon(points, np.array([0.25, 0.3, 0.22]), VOID)


def render_scene(seed: int, height: int = 240, width: int = 320, **options: float) -> RenderedScene:
    """Render the scene of a seed; RenderedStreet's fields can be fixed by name (dusk=0.8)."""
    generator = np.random.default_rng(seed)
    street = sample_street(generator, **options)
    canvas = Canvas(2 * height, 2 * width, street)
    # A generator for each part: fixing one part leaves the others as they were.
    sky, ground, *sides, cars, unknown, camera = generator.spawn(7)
    paint_sky(canvas, sky)
    paint_ground(canvas, ground)
    for side, houses in zip((-1.0, 1.0), sides, strict=True):
        paint_side(canvas, side, houses)
    paint_unknown(canvas, unknown)
    paint_cars(canvas, cars)
    return expose(canvas, camera)


def write_image(path: Path, scene: RenderedScene) -> None:
    """Write the scene's image as PNG."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_rgb(path, scene.image)


def write_scenes() -> None:
    """Write scenes as PNG files."""
    parser = argparse.ArgumentParser(description="Write rendered street scenes as PNG files.")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--count", type=int, default=6)
    options = parser.parse_args()
    for seed in range(options.count):
        write_image(options.out / f"scene_{seed:02d}.png", render_scene(seed))


if __name__ == "__main__":
    write_scenes()
