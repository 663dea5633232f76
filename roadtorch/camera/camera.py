"""Camera file: ego car, horizon and seed row, which all images of one camera share."""

import os
import re
from collections.abc import Sequence
from itertools import product
from pathlib import Path
from textwrap import fill
from typing import Annotated, Any

import tomli_w
import torch
from pydantic import Field, model_validator
from torch import Tensor
from torch.nn import functional as F

from roadtorch.base.atomic import write_text
from roadtorch.base.errors import ConfigError, InputError
from roadtorch.base.image import ORANGE, SKY_BLUE, tint_mask, to_pixels
from roadtorch.base.settings import (
    Settings,
    build_settings,
    find_settings_group,
    read_settings_file,
)
from roadtorch.camera.gradients import (
    GradientStatistics,
    small_grey,
    small_size,
    sobel_gradient,
    soft_normalize,
)
from roadtorch.camera.ground import Lens, pitch_from_horizon
from roadtorch.camera.ground_grid import GridSettings
from roadtorch.imaging.resize import resize_maps
from roadtorch.road.ego import Ego, ego_car, has_ego_car

# --- template of the ego car ----------------------------------------------------------

TEMPLATE_POINTS = 160  # enough for a reliable match, few enough for a file that people read
EDGE_ROWS = 2  # rows above the ego car over which its edge is blurred, at a width of 320 pixels
MAX_SHIFT = 1  # pixels by which scaling may displace an image, through rounding
MAX_SIMILARITY, MIN_SIMILARITY = 0.5, 0.2  # bounds of the threshold; other cameras reach about .1

_Fractions = Annotated[tuple[Annotated[float, Field(ge=0, le=1)], ...], Field(strict=False)]
_Components = Annotated[tuple[Annotated[float, Field(ge=-1, le=1)], ...], Field(strict=False)]


class EgoTemplate(Settings):
    """Gradient template of the ego car at some points; empty without an ego car."""

    min_similarity: float = Field(
        default=MIN_SIMILARITY, ge=-1, le=1, description="least cosine similarity of its images"
    )
    rows: _Fractions = Field(default=(), description="rows of points, fractions of the height")
    columns: _Fractions = Field(default=(), description="their columns, fractions of the width")
    gradient_x: _Components = Field(default=(), description="mean gradients to the right")
    gradient_y: _Components = Field(default=(), description="mean gradients downwards")

    @model_validator(mode="after")
    def _check_lengths(self) -> "EgoTemplate":
        if len({len(self.rows), len(self.columns), len(self.gradient_x), len(self.gradient_y)}) > 1:
            raise ValueError("Give as many rows, columns, gradient_x and gradient_y")
        return self


def build_ego_template(statistics: GradientStatistics, rows: Tensor) -> EgoTemplate:
    """Return the template of the ego car below rows (w,) int64, at the most reliable points.

    Points lie apart (each is the best of 3×3 pixels), so that one long edge does not dominate.
    """
    height, width = statistics.mean_length.shape
    is_ego = (torch.arange(height)[:, None] >= rows - EDGE_ROWS) & (rows < height)
    reliability = statistics.agreement * statistics.coherence * is_ego
    is_peak = reliability == F.max_pool2d(reliability[None, None], 3, 1, 1)[0, 0]
    peaks = torch.where(is_peak, reliability, 0).reshape(-1)
    best = peaks.sort(descending=True, stable=True).indices[:TEMPLATE_POINTS]
    best = best[peaks[best] > 0].sort().values
    gradient_x, gradient_y = statistics.mean.flatten(1)[:, best]
    return EgoTemplate(
        rows=to_floats((best // width + 0.5) / height, 4),
        columns=to_floats((best % width + 0.5) / width, 4),
        gradient_x=to_floats(gradient_x, 3),
        gradient_y=to_floats(gradient_y, 3),
    )


def to_floats(values: Tensor, decimals: int) -> tuple[float, ...]:
    """Return values (n,) as floats rounded to a number of decimals, for a file."""
    return tuple(round(value, decimals) for value in values.tolist())


def template_similarities(template: EgoTemplate, gradients: Sequence[Tensor]) -> Tensor:
    """Return the similarity (n,) of a template to each of n gradients (2, h, w) of small images."""
    return torch.tensor([template_similarity(template, gradient) for gradient in gradients])


def template_similarity(template: EgoTemplate, gradient: Tensor) -> float:
    """Return the similarity of a template to the gradient (2, h, w) of a small image, from -1 to 1.

    The cosine similarity, maximised over small shifts; about .1 for other cameras.
    """
    height, width = gradient.shape[1:]
    rows = (torch.tensor(template.rows) * height).long()
    columns = (torch.tensor(template.columns) * width).long()
    expected = torch.tensor([template.gradient_x, template.gradient_y]).reshape(-1)
    unit, best = soft_normalize(gradient), -1.0
    for down, right in product(range(-MAX_SHIFT, MAX_SHIFT + 1), repeat=2):
        shifted = (rows + down).clamp(0, height - 1), (columns + right).clamp(0, width - 1)
        points = unit[:, *shifted].reshape(-1)
        best = max(best, float(F.cosine_similarity(points, expected, 0)))
    return best


# --- the camera ------------------------------------------------------------------------

MAX_ASPECT_CHANGE = 1.06  # ratio of aspect ratios of one camera's images: crops, rounding
WRONG_CAMERA_HINT = "give images of this file's camera, or make a file for theirs"


class Camera(Settings):
    """A camera as estimated from its footage; rows are fractions of the height from the top.

    >>> from roadtorch import Camera
    >>> camera = Camera(width=640, height=480, frames=12, horizon=0.4, seed_row=0.9)
    >>> camera.write("camera.toml")
    >>> Camera.read("camera.toml") == camera
    True
    """

    width: int = Field(ge=1, description="width of the footage in pixels")
    height: int = Field(ge=1, description="height of the footage in pixels; images may be scaled")
    frames: int = Field(ge=1, description="number of frames that it was estimated from")
    horizon: float | None = Field(
        default=None, ge=0, le=1, description="vanishing point's row, fraction of the height"
    )
    seed_row: float = Field(ge=0, le=1, description="top of the ego car in the middle, or 1")
    invariant_angle: float | None = Field(
        default=None, ge=0, lt=180, description="direction of equal log chromaticity in degrees"
    )
    lens: Lens | None = Field(
        default=None, description="calibration; images are rectified if it has distortion"
    )
    grid: GridSettings = Field(
        default=GridSettings(), description="the camera over the ground, and its grid"
    )
    ego: Ego = Field(default=Ego(), description="the vehicle that carries the camera")
    template: EgoTemplate = Field(default=EgoTemplate(), description="gradients of the ego car")

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> "Camera":
        """Read a camera's file.

        Raises:
            ConfigError, InputError: naming the file when it is not one.
        """
        values = read_settings_file(Path(path))
        try:
            return build_settings(cls, values)
        except ConfigError as error:
            problem = f"is not a camera file: {error.where}: {error.problem}"
            raise ConfigError(path, problem, "make one with roadtorch camera") from None

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write the file that ``read`` reads, its outlines in lines of many numbers."""
        text = tomli_w.dumps(self.model_dump(exclude_defaults=True))

        def wrap(rows: re.Match[str]) -> str:
            return fill(" ".join(rows[0].split()), 96, initial_indent="    ") + "\n"

        write_text(path, re.sub(r"(?: {4}[-+.\de]+,\n)+", wrap, text))

    def check(self, image: Tensor) -> None:
        """Check that an image (3, H, W) can be of this camera; InputError when it cannot.

        Compared are the aspect ratio, and the ego car if the camera has one.
        """
        height, width = image.shape[-2:]
        ratio = width / height / (self.width / self.height)
        if not 1 / MAX_ASPECT_CHANGE <= ratio <= MAX_ASPECT_CHANGE:
            problem = f"is {width}×{height} pixels, the camera's footage {self.width}×{self.height}"
            raise InputError("image", problem, WRONG_CAMERA_HINT)
        if self.template.rows:
            gradient = sobel_gradient(small_grey(image, small_size([image])))
            if template_similarity(self.template, gradient) < self.template.min_similarity:
                raise InputError("image", "does not show this camera's ego car", WRONG_CAMERA_HINT)

    def settings_for(self, settings_class: type[Settings]) -> dict[str, Any]:
        """Return the values, nested, that a detector's settings take from this camera.

        Every detector takes the ego car and a lens with distortion, those with a labeller the
        horizon, and illuminant-invariant the invariant angle.
        """
        values: dict[str, Any] = {}
        if "invariant_angle" in settings_class.model_fields and self.invariant_angle is not None:
            values["invariant_angle"] = self.invariant_angle
        if has_ego_car(self.ego):
            values["ego"] = self.ego.model_dump(exclude_defaults=True)
        if self.lens is not None and self.lens.coefficients:
            lens = self.lens.model_dump(exclude_defaults=True)
            pitch = self.grid.pitch
            if pitch is None and self.horizon is not None:
                pitch = pitch_from_horizon(self.lens, self.horizon)
            values["rectification"] = {"lens": lens, "pitch": pitch or 0.0}
        labeller = find_settings_group(settings_class, ["labeller"])
        has_horizon = labeller is not settings_class and "horizon" in labeller.model_fields
        if has_horizon and self.horizon is not None:
            values["labeller"] = {"horizon": self.horizon}
        return values


# --- image to check the file ----------------------------------------------------------

CHECK_WIDTH = 640  # pixels of each half
SEED_SIDES = (3 / 8, 5 / 8)  # fractions of the width between which the seed row is drawn


def draw_check_image(camera: Camera, frames: Sequence[Tensor]) -> Tensor:
    """Draw the mean and the middle one of frames (3, H, W) side by side, (3, h, 1280) in [0, 1].

    The ego car is tinted and outlined; the horizon is a blue line, the seed row an orange one.
    """
    size = round(CHECK_WIDTH * camera.height / camera.width), CHECK_WIDTH
    small = [resize_maps(frame, size).clamp(0, 1) for frame in frames]
    left, right = (round(side * CHECK_WIDTH) for side in SEED_SIDES)
    lines = ((camera.horizon, slice(None), SKY_BLUE), (camera.seed_row, slice(left, right), ORANGE))
    halves = []
    for image in (torch.stack(small).mean(0), small[len(small) // 2]):
        pixels = to_pixels(image)
        if has_ego_car(camera.ego):
            pixels = tint_mask(pixels, ego_car(image, camera.ego).numpy())
        for row, columns, colour in lines:
            if row is None:
                continue
            top = min(round(row * size[0]), size[0] - 2)
            pixels[top : top + 2, columns] = colour
        halves.append(torch.from_numpy(pixels).permute(2, 0, 1) / 255)
    return torch.cat(halves, 2)
