"""Fisheye lenses by Kannala and Brandt's model, and their parameters for Blender. Needs no Blender.

A ray at an angle θ from the axis meets the image at a radius of
f (θ + k1 θ³ + k2 θ⁵ + k3 θ⁷ + k4 θ⁹), as in OpenCV and ROS (Kannala and Brandt, IEEE PAMI
28(8), 2006). If all k are 0 it is equidistant.
"""

from math import hypot, radians
from random import Random
from typing import NamedTuple

import numpy as np

SHAPES = (4 / 3, 4 / 3, 1.6, 16 / 9, 1.0)
"""Aspect ratios (width / height) of fisheye cameras' own images, before they are squeezed."""

SENSOR = 36.0
"""Width of the sensor in Blender, in millimetres."""


class Fisheye(NamedTuple):
    """A fisheye lens, in pixels; view: full field of view in degrees, black outside."""

    width: int
    height: int
    focal_x: float
    focal_y: float
    centre_x: float
    centre_y: float
    coefficients: tuple[float, float, float, float]
    view: float

    @property
    def shape(self) -> float:
        """Aspect ratio (width / height) of the camera's own image, whose pixels are square."""
        return self.width / self.focal_x * self.focal_y / self.height


def bend_rays(angle: np.ndarray, coefficients: tuple[float, ...]) -> np.ndarray:
    """Return the radius, over the focal length, of rays at angles in radians."""
    powers = [angle ** (2 * k + 3) for k in range(len(coefficients))]
    return angle + sum(c * power for c, power in zip(coefficients, powers, strict=True))


def sample_fisheye(rng: Random, width: int, height: int) -> Fisheye:
    """Sample a lens of 120 to 190 degrees whose circle is inside, across or outside the image."""
    view = rng.uniform(120, 190)
    bent = (rng.uniform(-0.05, 0.02), rng.uniform(-0.006, 0.004), 0.0, 0.0)
    coefficients = bent if rng.random() < 0.65 else (0.0, 0.0, 0.0, 0.0)
    shape = rng.choice(SHAPES)
    # radius of the circle in halves of the image's height: whole in it, across it, around it
    reach = rng.choice([rng.uniform(0.93, 1.0), rng.uniform(0.95, 1.05) * shape, hypot(1, shape)])
    end = float(bend_rays(np.array(radians(view / 2)), coefficients))
    focal_y = reach * height / 2 / end
    focal_x = focal_y * (width / height) / shape
    middle = ((width - 1) / 2, (height - 1) / 2)
    return Fisheye(width, height, focal_x, focal_y, middle[0], middle[1], coefficients, view)


def angle_polynomial(lens: Fisheye) -> list[float]:
    """Fit angles by a polynomial of the radius on the sensor in millimetres; five coefficients."""
    angles = np.linspace(0, radians(lens.view / 2), 400)
    radii = bend_rays(angles, lens.coefficients) * lens.focal_x / lens.width * SENSOR
    scale = radii[-1]
    table = (radii / scale)[:, None] ** np.arange(5)
    weights = np.linalg.lstsq(table, angles, rcond=None)[0]
    return [float(weight / scale**k) for k, weight in enumerate(weights)]


def image_circle(lens: Fisheye) -> np.ndarray:
    """Return the pixels that the lens sees, bool (H, W)."""
    y, x = np.mgrid[0 : lens.height, 0 : lens.width]
    radius = np.hypot((x - lens.centre_x) / lens.focal_x, (y - lens.centre_y) / lens.focal_y)
    return radius <= bend_rays(np.array(radians(lens.view / 2)), lens.coefficients)


def write_lens(lens: Fisheye, mount: dict[str, float]) -> str:
    """Return the TOML text of a lens for a camera file, with its mount."""
    rows = [f"{name} = {getattr(lens, name)!r}" for name in lens._fields[:6]]
    rows += ['model = "equidistant"', f"coefficients = {list(lens.coefficients)}"]
    rows += ["", "[mount]", f"view = {lens.view:.2f}"]
    return "\n".join([*rows, *(f"{name} = {value:.3f}" for name, value in mount.items())]) + "\n"
