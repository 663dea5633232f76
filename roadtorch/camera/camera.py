"""What stays the same in all pictures of one camera, as a file: ego car, horizon, seed row."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import Field
from torch import Tensor

from roadtorch.camera.look import Look, image_likeness
from roadtorch.errors import ConfigError, InputError
from roadtorch.io.atomic import write_text
from roadtorch.road.ego import Ego, is_given
from roadtorch.settings import Settings, build_settings, read_settings_file, toml_lines

SAME_SHAPE = 1.06
"""Ratio of two aspect ratios up to which pictures may come from one camera: crops, rounding."""

REMEDY = "give pictures of the camera that the file was made for, or make one for theirs"


class Camera(Settings):
    """One camera, as its footage shows it. Rows are shares of the height from the top."""

    width: int = Field(ge=1, description="of the footage, in pixels")
    height: int = Field(ge=1, description="likewise; pictures may be scaled")
    frames: int = Field(ge=1, description="how many were seen")
    horizon: float = Field(ge=0, le=1, description="row of the vanishing point")
    seed_row: float = Field(
        ge=0, le=1, description="the lowest ground in the middle: where the ego car begins, or 1"
    )
    ego: Ego = Field(default=Ego(), description="the vehicle that carries the camera")
    look: Look = Field(default=Look(), description="how pictures of another camera are told")

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> "Camera":
        """Read a camera's file; InputError or ConfigError, naming it, when it is not one."""
        values = read_settings_file(Path(path))
        try:
            return build_settings(cls, values)
        except ConfigError as problem:
            what = f"is no file of a camera: {problem.where}: {problem.what}"
            raise ConfigError(path, what, "make one with roadtorch camera") from None

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write the file that ``read`` reads."""
        values = self.model_dump(exclude_defaults=True)
        write_text(path, "\n".join([*toml_lines(values), ""]))

    def check(self, image: Tensor) -> None:
        """Raise InputError when an image (3,H,W) in [0,1] cannot be of this camera: shape, look.

        Without an ego car only the shape can be told.
        """
        height, width = image.shape[-2:]
        ratio = width / height / (self.width / self.height)
        if not 1 / SAME_SHAPE <= ratio <= SAME_SHAPE:
            what = f"is {width}×{height} pixels, the camera's footage {self.width}×{self.height}"
            raise InputError("image", what, REMEDY)
        if self.look.rows and image_likeness(self.look, image) < self.look.least:
            raise InputError("image", "does not show this camera's ego car", REMEDY)

    def settings_for(self, kind: type[Settings]) -> dict[str, Any]:
        """Values for a detector's settings of that kind, nested: what of the camera it can use.

        The ego car, which every detector can, and the horizon for those with a labeller.
        """
        ego = {"ego": self.ego.model_dump(exclude_defaults=True)} if is_given(self.ego) else {}
        place = {"labeller": {"horizon": self.horizon}}
        return {**ego, **(place if _has(kind, place) else {})}


def _has(kind: type[Settings], values: Mapping[str, Any]) -> bool:
    """Whether settings of that kind have the keys of nested values."""
    for key, value in values.items():
        field = kind.model_fields.get(key)
        if field is None:
            return False
        if isinstance(value, Mapping):
            group = field.annotation
            if not (isinstance(group, type) and issubclass(group, Settings) and _has(group, value)):
                return False
    return True
