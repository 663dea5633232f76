"""A picture that shows whether a camera's file is right: its ego car, horizon and seed row."""

from collections.abc import Sequence

import torch
from torch import Tensor

from roadtorch.camera.camera import Camera
from roadtorch.imaging.resize import resized
from roadtorch.io.image import ORANGE, SKY_BLUE, tint_mask, to_pixels
from roadtorch.road.ego import ego_car, is_given

WIDTH = 640
"""Pixels of each half."""

SEED_SIDES = (3 / 8, 5 / 8)
"""Shares of the width between which the seed row is drawn."""


def check_picture(camera: Camera, frames: Sequence[Tensor]) -> Tensor:
    """The mean of frames (3,H,W) and their middle one, side by side: an image (3,h,1280) in [0,1].

    The ego car is tinted and outlined; the horizon is a blue line, the seed row an orange one.
    """
    size = round(WIDTH * camera.height / camera.width), WIDTH
    small = [resized(frame, size).clamp(0, 1) for frame in frames]
    halves = (torch.stack(small).mean(0), small[len(small) // 2])
    return torch.cat([_drawn(camera, half) for half in halves], 2)


def _drawn(camera: Camera, image: Tensor) -> Tensor:
    pixels = to_pixels(image)
    if is_given(camera.ego):
        pixels = tint_mask(pixels, ego_car(image, camera.ego).numpy())
    drawn = torch.from_numpy(pixels).permute(2, 0, 1) / 255
    left, right = (round(side * WIDTH) for side in SEED_SIDES)
    _draw_row(drawn, camera.horizon, slice(None), SKY_BLUE)
    _draw_row(drawn, camera.seed_row, slice(left, right), ORANGE)
    return drawn


def _draw_row(image: Tensor, row: float, columns: slice, colour: tuple[int, int, int]) -> None:
    """Draw a line two pixels high into an image (3,H,W), at a share of its height."""
    top = min(round(row * image.shape[1]), image.shape[1] - 2)
    image[:, top : top + 2, columns] = torch.tensor(colour).view(3, 1, 1) / 255
