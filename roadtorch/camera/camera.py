"""What all images of one camera share, as a file: ego car, horizon, seed row."""

import os
from collections.abc import Sequence
from itertools import product
from pathlib import Path
from typing import Annotated, Any

import tomli_w
import torch
from pydantic import Field, model_validator
from torch import Tensor
from torch.nn import functional as F

from roadtorch.base.atomic import write_text
from roadtorch.base.errors import ConfigError, InputError
from roadtorch.base.image import ORANGE, SKY_BLUE, tint_mask, to_pixels
from roadtorch.base.settings import Settings, build_settings, group_at, read_settings_file
from roadtorch.camera.gradients import Stillness, gradient_of, small_grey, small_size, softened
from roadtorch.imaging.resize import resized
from roadtorch.road.ego import Ego, ego_car, is_given

# --- the look of the ego car ----------------------------------------------------------


POINTS = 160  # points of a look: enough for a sure answer, few enough for a file that people read
EDGE_ROWS = 2  # rows above the ego car that its edge is spread over, of an image 320 pixels wide
SHIFT = 1  # pixels by which an image may be displaced, as rounding does when images are scaled

MAX_LIKENESS, MIN_LIKENESS = 0.5, 0.2
"""Bounds of the required similarity: other cameras reach about .1, and hardly ever .5."""

Shares = tuple[Annotated[float, Field(ge=0, le=1)], ...]
Parts = tuple[Annotated[float, Field(ge=-1, le=1)], ...]


class EgoLook(Settings):
    """Gradient template of the ego car at some points; empty without an ego car."""

    least: float = Field(
        default=MIN_LIKENESS, ge=-1, le=1, description="likeness of its own images"
    )
    rows: Shares = Field(default=(), strict=False, description="points, shares of the height")
    columns: Shares = Field(default=(), strict=False, description="shares of the width")
    across: Parts = Field(default=(), strict=False, description="mean gradient to the right")
    down: Parts = Field(default=(), strict=False, description="mean gradient downwards")

    @model_validator(mode="after")
    def _has_all_of_each_point(self) -> "EgoLook":
        if len({len(self.rows), len(self.columns), len(self.across), len(self.down)}) > 1:
            raise ValueError("Give as many rows, columns, across and down")
        return self


def ego_look(still: Stillness, rows: Tensor) -> EgoLook:
    """Return the template of the ego car below rows (w,) int64, at the most reliable points.

    Points lie apart (each is the best of 3×3 pixels), so that one long edge does not dominate.
    """
    height, width = still.length.shape
    row = torch.arange(height)[:, None]
    sure = still.common * still.coherence * ((row >= rows - EDGE_ROWS) & (rows < height))
    is_peak = sure == F.max_pool2d(sure[None, None], 3, 1, 1)[0, 0]
    peaks = torch.where(is_peak, sure, 0).reshape(-1)
    best = peaks.sort(descending=True, stable=True).indices[:POINTS]
    best = best[peaks[best] > 0].sort().values
    across, down = still.mean.flatten(1)[:, best]
    return EgoLook(
        rows=rounded((best // width + 0.5) / height, 4),
        columns=rounded((best % width + 0.5) / width, 4),
        across=rounded(across, 3),
        down=rounded(down, 3),
    )


def rounded(values: Tensor, digits: int) -> tuple[float, ...]:
    """Return values (n,) as floats with so many decimals, for a file."""
    return tuple(round(value, digits) for value in values.tolist())


def likenesses(look: EgoLook, gradients: Sequence[Tensor]) -> Tensor:
    """Return the similarity (n,) of a template to each of n gradients (2, h, w) of small images."""
    return torch.tensor([gradient_likeness(look, gradient) for gradient in gradients])


def gradient_likeness(look: EgoLook, gradient: Tensor) -> float:
    """Return the similarity of a template to the gradient (2, h, w) of a small image, from -1 to 1.

    The cosine similarity, maximised over small shifts; about .1 for other cameras.
    """
    height, width = gradient.shape[1:]
    rows = (torch.tensor(look.rows) * height).long()
    columns = (torch.tensor(look.columns) * width).long()
    expected = torch.tensor([look.across, look.down]).reshape(-1)
    unit, best = softened(gradient), -1.0
    for down, right in product(range(-SHIFT, SHIFT + 1), repeat=2):
        shifted = (rows + down).clamp(0, height - 1), (columns + right).clamp(0, width - 1)
        points = unit[:, *shifted].reshape(-1)
        best = max(best, float(F.cosine_similarity(points, expected, 0)))
    return best


# --- the camera ------------------------------------------------------------------------

SAME_SHAPE = 1.06
"""Ratio of two aspect ratios up to which images may be of one camera: crops, rounding."""

HINT = "give images of the camera that the file was made for, or make one for theirs"


class Camera(Settings):
    """A camera as estimated from its footage; rows are fractions of the height from the top.

    >>> from roadtorch import Camera
    >>> camera = Camera(width=640, height=480, frames=12, horizon=0.4, seed_row=0.9)
    >>> camera.write("camera.toml")
    >>> Camera.read("camera.toml") == camera
    True
    """

    width: int = Field(ge=1, description="of the footage, in pixels")
    height: int = Field(ge=1, description="likewise; images may be scaled")
    frames: int = Field(ge=1, description="how many were seen")
    horizon: float = Field(ge=0, le=1, description="row of the vanishing point")
    seed_row: float = Field(
        ge=0, le=1, description="the lowest ground in the middle: where the ego car begins, or 1"
    )
    ego: Ego = Field(default=Ego(), description="the vehicle that carries the camera")
    look: EgoLook = Field(default=EgoLook(), description="how images of another camera are told")

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
            problem = f"is no file of a camera: {error.where}: {error.problem}"
            raise ConfigError(path, problem, "make one with roadtorch camera") from None

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write the file that ``read`` reads."""
        write_text(path, tomli_w.dumps(self.model_dump(exclude_defaults=True)))

    def check(self, image: Tensor) -> None:
        """Check that an image can be of this camera: its aspect ratio, and its ego car if any.

        Args:
            image: sRGB in [0, 1], shape (3, H, W).

        Raises:
            InputError: when it cannot.
        """
        height, width = image.shape[-2:]
        ratio = width / height / (self.width / self.height)
        if not 1 / SAME_SHAPE <= ratio <= SAME_SHAPE:
            problem = f"is {width}×{height} pixels, the camera's footage {self.width}×{self.height}"
            raise InputError("image", problem, HINT)
        if self.look.rows:
            gradient = gradient_of(small_grey(image, small_size([image])))
            if gradient_likeness(self.look, gradient) < self.look.least:
                raise InputError("image", "does not show this camera's ego car", HINT)

    def settings_for(self, kind: type[Settings]) -> dict[str, Any]:
        """Return the values, nested, that a detector's settings of a class take from this camera.

        The ego car for every detector, and the horizon for those with a labeller.
        """
        values: dict[str, Any] = {}
        if is_given(self.ego):
            values["ego"] = self.ego.model_dump(exclude_defaults=True)
        labeller = group_at(kind, ["labeller"])
        if labeller is not kind and "horizon" in labeller.model_fields:
            values["labeller"] = {"horizon": self.horizon}
        return values


# --- the image beside the file ------------------------------------------------------


CHECK_WIDTH = 640  # pixels of each half
SEED_SIDES = (3 / 8, 5 / 8)  # shares of the width between which the seed row is drawn


def check_image(camera: Camera, frames: Sequence[Tensor]) -> Tensor:
    """Draw the mean of frames and their middle frame side by side, to check a camera's file.

    The ego car is tinted and outlined; the horizon is a blue line, the seed row an orange one.

    Args:
        camera: the camera to draw.
        frames: sRGB in [0, 1], shape (3, H, W) each.

    Returns:
        An image in [0, 1], shape (3, h, 1280).
    """
    size = round(CHECK_WIDTH * camera.height / camera.width), CHECK_WIDTH
    small = [resized(frame, size).clamp(0, 1) for frame in frames]
    left, right = (round(side * CHECK_WIDTH) for side in SEED_SIDES)
    lines = ((camera.horizon, slice(None), SKY_BLUE), (camera.seed_row, slice(left, right), ORANGE))
    halves = []
    for image in (torch.stack(small).mean(0), small[len(small) // 2]):
        pixels = to_pixels(image)
        if is_given(camera.ego):
            pixels = tint_mask(pixels, ego_car(image, camera.ego).numpy())
        for row, columns, colour in lines:
            top = min(round(row * size[0]), size[0] - 2)
            pixels[top : top + 2, columns] = colour
        halves.append(torch.from_numpy(pixels).permute(2, 0, 1) / 255)
    return torch.cat(halves, 2)
