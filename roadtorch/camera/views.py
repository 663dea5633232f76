"""Rectified views of a wide lens: a detector sees them, and its maps are brought back. Ours.

Detectors learn most from images without distortion. So an image of a lens with distortion is also
sampled as pinhole lenses see it: one up to ``MAX_WIDTH``, else three, two of which look aside.
"""

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import torch
from pydantic import Field
from torch import Tensor
from torch.nn import functional as F

from roadtorch.base.errors import ConfigError
from roadtorch.base.settings import Settings
from roadtorch.camera.ground import (
    MAX_PITCH,
    MIN_PITCH,
    Lens,
    camera_pose,
    pixel_rays,
    project_rays,
    visible_rays,
)
from roadtorch.imaging.resize import SHORTEST

MAX_WIDTH = 110.0  # degrees from side to side that a view shows, as the widest rendered worlds
MAX_VIEW_ANGLE = 75.0  # degrees from the axis of a single view; farther out it is stretched
TOP, BOTTOM = 15.0, 85.0  # degrees above and below the horizon that three views show
MIN_HEIGHT = 20.0  # degrees from the upper to the lower side of three views
FAR_GROUND = 60.0  # degrees below the horizon, down to which three views look in all directions
MAX_YAW = 80.0  # degrees by which a view looks aside
MESH_POINTS = 129  # columns and rows of pixels whose rays bound what a lens sees
SLOPE_AHEAD = math.tan(math.radians(MAX_WIDTH / 2))  # of the rays at the sides of ``view_ahead``
CACHED_LENSES = 4  # cameras of a process whose views need no new computation
OUTSIDE = 2.0  # position, where the image extends from -1 to 1, of what no lens sees


class Rectification(Settings):
    """Lens and pitch by which images are rectified before they are analysed."""

    lens: Lens
    pitch: float = Field(
        default=0.0,
        ge=MIN_PITCH,
        le=MAX_PITCH,
        description="degrees by which the optical axis points below the horizon",
    )


class View(NamedTuple):
    """Rectified view: its x, y and z axis in the frame of the camera, and its pinhole lens."""

    axes: tuple[tuple[float, ...], ...]
    lens: Lens


def rectified_views(lens: Lens, pitch: float) -> tuple[View, ...]:
    """Return the views that show what a lens sees, each with about as many pixels as the image.

    A single view has the axes of the camera. Three are upright, whatever the camera's pitch, and
    show the ground from just above the horizon to the camera's foot.

    lens: of the images, at their size. pitch: degrees by which the optical axis points below the
    horizon. Raises ConfigError for a lens that sees nothing in its images.
    """
    return _plan_views(lens, pitch)  # type: ignore[arg-type]  # frozen: it has a hash


@lru_cache(maxsize=CACHED_LENSES)
def _plan_views(lens: Lens, pitch: float) -> tuple[View, ...]:
    sides = (np.linspace(-0.499, end - 0.501, MESH_POINTS) for end in (lens.width, lens.height))
    rays, visible = visible_rays(lens, np.stack(np.meshgrid(*sides), -1).reshape(-1, 2))
    if not visible.any():
        raise ConfigError("lens", "sees nothing", "check its focal lengths and its centre")
    rays = rays[visible] / np.linalg.norm(rays[visible], axis=1, keepdims=True)
    (left, top, _), (right, bottom, _) = np.degrees(np.arcsin([rays.min(0), rays.max(0)]))
    if right - left <= MAX_WIDTH:
        plane = rays[:, :2] / np.maximum(rays[:, 2:], math.cos(math.radians(MAX_VIEW_ANGLE)))
        return (_make_view(np.eye(3), plane.min(0), plane.max(0), lens),)
    low = min(BOTTOM, pitch + bottom)
    height = max(low + min(TOP, -top - pitch), MIN_HEIGHT)
    tilt = low - height / 2
    side, top, bottom = np.tan(np.radians([MAX_WIDTH / 2, height / 2, BOTTOM - tilt]))
    camera, upright = (np.array(camera_pose(1, degrees).axes) for degrees in (pitch, tilt))
    ahead, aside, up = (rays @ camera).T
    is_far_ground = (up < 0) & (up > -math.sin(math.radians(FAR_GROUND)))
    azimuths = np.degrees(np.arctan2(-aside, ahead))[is_far_ground if is_far_ground.any() else ...]
    max_azimuth = MAX_YAW + MAX_WIDTH / 2
    left, right = np.clip([azimuths.min(), azimuths.max()], -max_azimuth, max_azimuth)
    views = []
    for yaw in np.radians([0, left + MAX_WIDTH / 2, right - MAX_WIDTH / 2]):
        cosine, sine = math.cos(yaw), math.sin(yaw)
        to_right = np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1]])
        axes = upright @ to_right @ camera.T
        x, y, z = (rays @ axes.T).T
        floor = (y / z)[(z > 0) & (np.abs(x) < side / 2 * z)].max(initial=0)
        bounds = np.array([-side, -top]), np.array([side, min(floor, bottom)])
        views.append(_make_view(axes, *bounds, lens))
    return tuple(views)


def view_itself(lens: Lens) -> View:
    """Return the view that is the image of a lens."""
    return View(tuple(map(tuple, np.eye(3).tolist())), lens)


def view_ahead(lens: Lens) -> View:
    """Return a view along the axis of a lens, ``MAX_WIDTH`` from side to side and up and down."""
    corner = np.full(2, SLOPE_AHEAD)
    return _make_view(np.eye(3), -corner, corner, lens)


def _make_view(axes: np.ndarray, low: np.ndarray, high: np.ndarray, lens: Lens) -> View:
    """Return a view of the plane one metre ahead between two corners (x, y)."""
    focal = math.sqrt(lens.width * lens.height / np.prod(high - low))
    width, height = (max(SHORTEST, round(side * focal)) for side in (high - low).tolist())
    focal_x, focal_y = ((width, height) / (high - low)).tolist()
    pinhole = Lens(
        width=width,
        height=height,
        focal_x=focal_x,
        focal_y=focal_y,
        centre_x=-low[0] * focal_x - 0.5,
        centre_y=-low[1] * focal_y - 0.5,
    )
    return View(tuple(map(tuple, axes.tolist())), pinhole)


def sample_view(image: Tensor, lens: Lens, view: View) -> Tensor:
    """Sample a view (3, h, w) of an image (3, H, W), bilinearly; its border goes on outside."""
    grid = _view_grid(lens, view)  # type: ignore[arg-type]  # frozen: it has a hash
    return _sample_map(image, grid.to(image.device))


def merge_views(
    maps: Sequence[Tensor],
    lens: Lens,
    views: Sequence[View],
    size: tuple[int, int],
    weights: Sequence[float],
) -> Tensor:
    """Bring maps of views back to the image, and merge them where views overlap.

    Args:
        maps: of each view, shape (h, w) or (C, h, w); views may differ in size.
        lens: of the image.
        views: of ``rectified_views``, or ``view_itself``.
        size: height and width of the result.
        weights: of the views, above 0.

    Returns:
        Weighted means of values, unions of masks, labels of the view of the largest weight that
        shows a pixel, of shape (H, W) or (C, H, W); 0 where no view shows it.
    """
    grids = [_image_grid(lens, view, size) for view in views]  # type: ignore[arg-type]  # as above
    device = maps[0].device
    positions, visible = ([part.to(device) for part in parts] for parts in zip(*grids, strict=True))
    sampled = list(map(_sample_map, maps, positions))
    if maps[0].dtype == torch.bool:
        return torch.stack(list(map(torch.logical_and, sampled, visible))).any(0)
    if maps[0].is_floating_point():
        scaled = [mask * weight for mask, weight in zip(visible, weights, strict=True)]
        total = torch.stack(list(map(torch.mul, sampled, scaled)))
        return total.sum(0) / torch.stack(scaled).sum(0).clamp(min=min(weights))
    merged = torch.zeros_like(sampled[0])
    for number in sorted(range(len(maps)), key=weights.__getitem__):  # the heaviest comes last
        merged = torch.where(visible[number], sampled[number], merged)
    return merged.to(maps[0].dtype)


def _sample_map(values: Tensor, grid: Tensor) -> Tensor:
    """Sample a map (…, h, w) at a grid (1, H, W, 2): values bilinearly, labels the nearest."""
    mode = "bilinear" if values.is_floating_point() else "nearest"
    dtype = values.dtype if values.is_floating_point() else torch.float64
    batch = values.reshape(1, -1, *values.shape[-2:]).to(dtype)
    sampled = F.grid_sample(batch, grid.to(dtype), mode, "border", align_corners=False)
    return sampled.reshape(*values.shape[:-2], *grid.shape[1:3])


@lru_cache(maxsize=3 * CACHED_LENSES)
def _view_grid(lens: Lens, view: View) -> Tensor:
    """Return the positions in the image of the pixels of a view, (1, h, w, 2)."""
    rays = pixel_rays(view.lens, _pixel_centres(view.lens, view.lens.height, view.lens.width))
    pixels, _ = project_rays(lens, rays @ np.array(view.axes))
    grid = _to_grid(lens, pixels, np.ones(len(pixels), bool))
    return grid.reshape(1, view.lens.height, view.lens.width, 2)


@lru_cache(maxsize=4 * 2 * CACHED_LENSES)  # views and the image itself, small and large
def _image_grid(lens: Lens, view: View, size: tuple[int, int]) -> tuple[Tensor, Tensor]:
    """Return where a view shows an image of a size: positions (1, H, W, 2) and a mask (H, W)."""
    rays, visible = visible_rays(lens, _pixel_centres(lens, *size))
    pixels, inside = project_rays(view.lens, rays @ np.array(view.axes).T)
    grid = _to_grid(view.lens, pixels, inside & visible).reshape(1, *size, 2)
    return grid, (grid[0] < OUTSIDE).all(-1)


def _pixel_centres(lens: Lens, height: int, width: int) -> np.ndarray:
    """Return the centres (n, 2), in the lens's pixels, of the pixels of an image of a size."""
    columns = (np.arange(width) + 0.5) * (lens.width / width) - 0.5
    rows = (np.arange(height) + 0.5) * (lens.height / height) - 0.5
    return np.stack(np.meshgrid(columns, rows), -1).reshape(-1, 2)


def _to_grid(lens: Lens, pixels: np.ndarray, visible: np.ndarray) -> Tensor:
    """Return pixels (n, 2) as positions of ``grid_sample``, from -1 to 1, or ``OUTSIDE``."""
    positions = (pixels + 0.5) * 2 / (lens.width, lens.height) - 1
    return torch.from_numpy(np.where(visible[:, None], positions, OUTSIDE)).float()
