"""Ground points of an image's pixels: what a depth camera measures, for flat ground. Ours.

Nav2's semantic segmentation layer (kiwicampus/semantic_segmentation_layer, "Required Topics and
Message Types") marks the cell below the point of each mask pixel. Here only pixels whose ground the
grid knows have a point: what stands upright would be smeared over the cells behind it.
"""

from functools import lru_cache

import numpy as np

from roadtorch.camera.ground import GroundCamera, Lens, visible_rays
from roadtorch.camera.ground_grid import UNKNOWN, Grid

MIN_SLOPE = 1e-6  # descent of a ray per metre along the optical axis that meets the ground


def ground_points(camera: GroundCamera, grid: Grid) -> np.ndarray:
    """Return the ground point of each pixel, as far as the grid of the same image knows it.

    Returns:
        Points in the camera's frame (x right, y down, z along the optical axis), metres, float32,
        shape (H, W, 3); NaN above the horizon, beyond the grid and in its unknown cells. The first
        pixel that is no road along a ray keeps its point.
    """
    # Frozen settings have a hash.
    points, cells = _pixel_points(camera, grid.resolution, tuple(grid.cells.shape))  # type: ignore[arg-type]
    visible = np.append(grid.occupancy.numpy() != UNKNOWN, False)[cells]
    return np.where(visible[..., None], points, np.float32(np.nan))


@lru_cache(maxsize=4)  # some 6 MB each at 640×480: the cameras of a robot
def _pixel_points(
    camera: GroundCamera, size: float, shape: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """Return points (H, W, 3) in the camera's frame, and flat indices of cells, int64 (H, W).

    size: side of a cell, metres; shape: rows and columns of the grid. The cell of a pixel is that
    at the near end of the ground which it covers, and half a cell nearer: with the pixel's centre a
    far obstacle, whose cell is shorter than a pixel, would lose its point. -1: no cell.
    """
    rays = _lens_rays(camera.lens)  # type: ignore[arg-type]  # as above
    directions = rays @ np.array(camera.pose.axes, np.float32)
    height = camera.pose.position[2]
    slope = -directions[..., 2]
    length = height / np.where(slope > MIN_SLOPE, slope, np.nan)
    ground = directions[..., :2] * length[..., None]
    distance = np.hypot(ground[..., 0], ground[..., 1])
    # A pixel sees 1 / focal length radians, and on the ground d(h / tan a) = (h² + distance²) / h.
    half = (height**2 + distance**2) / (2 * height * camera.lens.focal_y)
    scale = np.maximum(0, 1 - (half + size / 2) / np.maximum(distance, size))
    x, y = ground[..., 0] / size, ground[..., 1] / size
    inside = (x >= 0) & (x < shape[1]) & (np.abs(y) < shape[0] / 2)
    index = np.floor(y * scale + shape[0] / 2) * shape[1] + np.floor(x * scale)
    cells = np.where(inside, index, -1).astype(np.int64)
    return rays * length[..., None], cells


@lru_cache(maxsize=4)  # 4 MB each at 640×480; undistorted once, whatever the pitch
def _lens_rays(lens: Lens) -> np.ndarray:
    """Return the rays of all pixels, float32, shape (H, W, 3); NaN where the lens sees nothing."""
    pixels = np.stack(np.meshgrid(np.arange(lens.width), np.arange(lens.height)), -1)
    rays, visible = visible_rays(lens, pixels.reshape(-1, 2).astype(np.float64))
    rays = np.where(visible[:, None], rays, np.nan).astype(np.float32)
    return rays.reshape(lens.height, lens.width, 3)
