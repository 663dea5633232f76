"""Metric grid of the road on flat ground: free, occupied or unknown cells. Ours.

On flat ground, upright things smear over the cells behind them. So cells are classified along
rays from the camera's foot: free up to the first cell that is no road, which is occupied, and
unknown behind it.
"""

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated

import cv2
import numpy as np
import torch
from pydantic import Field, ValidationInfo, field_validator
from torch import Tensor

from roadtorch.base.errors import InputError
from roadtorch.base.settings import Settings
from roadtorch.camera.ground import MAX_PITCH, MAX_ROLL, MIN_PITCH, GroundCamera

FREE, OCCUPIED, UNKNOWN = 0, 100, -1  # values of cells, those of nav_msgs/OccupancyGrid
SAMPLES_ALONG = 2  # samples per cell along a ray
SAMPLES_ACROSS = 4  # rays per cell at the largest distance
MIN_CELLS, MAX_CELLS = 4, 2000  # cells ahead of the camera
MAX_SAMPLES = 2**24  # of all rays: some seconds, and a gigabyte
MIN_VISIBLE_FRACTION = 0.5  # fraction of a cell's samples that are visible
MAX_GAP_CELLS = 4  # cells between the ends of neighbouring rays that form one edge
GAP_POINTS = 8  # points inserted between those ends
MAX_HALVINGS = 8  # of the image, for cells that cover many of its pixels
EGO_MARGIN = 0.03  # of the height, by which an ego car's estimated outline may be too low
BORDER_SAMPLES = 64  # pixels of each side of the image whose rays bound the view

_Metres = Annotated[float, Field(gt=0, le=1000)]
_Height = Annotated[float, Field(ge=0.01, le=1000)]
_Pitch = Annotated[float, Field(ge=MIN_PITCH, le=MAX_PITCH)]
_Roll = Annotated[float, Field(ge=-MAX_ROLL, le=MAX_ROLL)]
_Angle = Annotated[float, Field(ge=1, le=170)]
_Position = Annotated[float, Field(ge=-1000, le=1000)]


class GridSettings(Settings):
    """The camera over the ground, and the cells of its grid."""

    height: _Height | None = Field(
        default=None, description="metres of the camera above the ground"
    )
    pitch: _Pitch | None = Field(
        default=None,
        description="degrees, positive downwards; unset: of the camera file or the images",
    )
    roll: _Roll = Field(default=0.0, description="degrees, positive if the right side is lower")
    fov: _Angle | None = Field(
        default=None,
        description="degrees from side to side; unset: lens of the camera file or camera_info",
    )
    x: _Position = Field(
        default=0.0, description="metres of the camera ahead of the robot's origin"
    )
    y: _Position = Field(default=0.0, description="metres of the camera to the left of it")
    frame: str = Field(default="base_link", description="TF frame of the robot")
    cell: float = Field(default=0.1, ge=0.005, le=10, description="side of a cell, metres")
    range: _Metres = Field(default=30.0, description="metres ahead of the camera")
    side: _Metres = Field(default=15.0, description="metres to each side of the camera")
    max_cells_per_pixel: float = Field(
        default=10.0,
        gt=0,
        le=1000,
        description="most cells that a pixel covers; others are unknown",
    )

    @field_validator("range")
    @classmethod
    def _check_cells(cls, value: float, info: ValidationInfo) -> float:
        cells = value / info.data.get("cell", 0.1)
        if not MIN_CELLS <= cells <= MAX_CELLS:
            raise ValueError(f"give {MIN_CELLS} to {MAX_CELLS} times the cell")
        return value


@dataclass(frozen=True, eq=False)
class Grid:
    """Metric map of the ground in the robot's frame (REP 103): x forward, y left.

    Attributes:
        cells: int8, shape (rows along y, columns along x): 0 free, 100 no road, -1 unknown; cell
            (0, 0) has the least x and y.
        likelihood: mean road likelihood, float32, of the same shape; NaN in unknown cells.
        resolution: side of a cell, metres.
        origin: outer corner of cell (0, 0), metres.
        blocked: fraction of the visible road's area that lies behind what is no road.
    """

    cells: Tensor
    likelihood: Tensor
    resolution: float
    origin: tuple[float, float]
    blocked: float = 0.0

    @property
    def occupancy(self) -> Tensor:
        """int8, shape (rows · columns,), in nav_msgs/OccupancyGrid's order, x running fastest."""
        return self.cells.reshape(-1)


def ground_grid(
    road: Tensor,
    camera: GroundCamera,
    settings: GridSettings,
    ego: Tensor | None = None,
    threshold: float = 0.5,
) -> Grid:
    """Project a mask or likelihood onto the ground.

    Args:
        road: mask, bool, or likelihood in [0, 1], shape (H, W).
        camera: the camera that took the image.
        settings: extent and size of the cells.
        ego: the ego car, bool, shape (H, W); unknown in the grid, with what touches it.
        threshold: mean likelihood from which a cell is road.

    Raises:
        InputError: for a size other than the lens's, and when no ground within range is visible.
    """
    lens, size = camera.lens, settings.cell
    if tuple(road.shape) != (lens.height, lens.width):
        problem = f"is {road.shape[1]}×{road.shape[0]} pixels, the lens {lens.width}×{lens.height}"
        hint = "give a map of the lens's size, or lens.at(width, height)"
        raise InputError("road", problem, hint)
    rays = sample_rays(camera, settings)  # type: ignore[arg-type]  # frozen: it has a hash
    likelihood = _sample_bilinear(road.float(), rays)
    visible = rays.inside
    if ego is not None and ego.any():
        hidden = ego | (_near_ego(ego) & (road < threshold))
        visible = visible & (_sample_bilinear(hidden.float(), rays) < 0.5)
    likelihood, visible = _cell_means(likelihood, visible, rays)
    distance = (rays.distance[1:] + rays.distance[:-1]) / 2
    ends = visible & (likelihood < threshold)
    free = distance[ends.int().argmax(0)] - size / (2 * SAMPLES_ALONG)
    free = torch.where(ends.any(0), free, math.inf)  # start of a ray's first cell without road
    area = distance[:, None] * (visible & (likelihood >= threshold))
    blocked = float((area * (distance[:, None] > free)).sum() / area.sum().clamp_min(1e-9))
    index, ray, inside = rays.index, rays.ray, rays.visible
    is_free = inside & visible[index, ray] & (rays.radius < free[ray])
    cells = torch.where(is_free, FREE, UNKNOWN).to(torch.int8)
    edge = _edge_cells(free, rays.azimuth, size, cells.shape)
    cells[edge] = OCCUPIED
    foot = camera.pose.position
    origin = (foot[0], foot[1] - len(cells) / 2 * size)
    likelihood = likelihood[index, ray].where(is_free | (edge & inside), math.nan)
    return Grid(cells, likelihood, size, origin, blocked)


def _near_ego(ego: Tensor) -> Tensor:
    """Return the pixels, bool (H, W), that a bonnet whose outline is slightly off may cover.

    Where one touches the ego area and is no road, it is the bonnet's edge rather than an obstacle.
    """
    side = 2 * math.ceil(EGO_MARGIN * ego.shape[0]) + 1
    near = cv2.dilate(ego.cpu().numpy().astype(np.uint8), np.ones((side, side), np.uint8))
    return torch.from_numpy(near > 0).to(ego.device)


# --- rays in the image ----------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class RaySamples:
    """Pixels of the samples of all rays. Cached: do not change them.

    azimuth (B,), radians, and distance (K+1,), metres, of samples. columns, rows: float32 (K+1, B).
    halvings: (K+1,), how often the image is halved for them, so that no pixel between them is left
    out. inside: bool (K+1, B), in the image and fine enough. start, end: rays of a cell's width,
    (K+1, B). Of each cell of the grid, (R, C): radius, metres, index of the distance (0 to K-1),
    ray, and whether both are among those sampled.
    """

    azimuth: Tensor
    distance: Tensor
    columns: np.ndarray
    rows: np.ndarray
    halvings: np.ndarray
    inside: Tensor
    start: Tensor
    end: Tensor
    radius: Tensor
    index: Tensor
    ray: Tensor
    visible: Tensor


@lru_cache(maxsize=4)  # some 25 MB each: the cameras of a robot
def sample_rays(camera: GroundCamera, settings: GridSettings) -> RaySamples:
    """Return the pixels at which a camera sees its rays' samples; InputError without ground."""
    low, high = _azimuth_range(camera)
    count = math.ceil((high - low) / (settings.cell / settings.range / SAMPLES_ACROSS)) + 2
    azimuth = np.linspace(low, high, count)
    max_distance = math.hypot(settings.range, settings.side)
    step = settings.cell / SAMPLES_ALONG
    distance = (np.arange(math.ceil(max_distance / step) + 1) + 0.5) * step
    if len(distance) * count > MAX_SAMPLES:
        problem = f"{len(distance) * count} samples are too many"
        raise InputError("grid", problem, "give larger cells or a shorter range")
    direction = np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros(count)], 1)
    foot = np.array([*camera.pose.position[:2], 0.0])
    pixels, inside = camera.project((foot + distance[:, None, None] * direction).reshape(-1, 3))
    pixels, inside = pixels.reshape(-1, count, 2), inside.reshape(-1, count)
    spacing = np.linalg.norm(np.diff(pixels, axis=0, append=pixels[-1:]), axis=2)
    inside &= spacing * SAMPLES_ALONG * settings.max_cells_per_pixel >= 1
    if not inside.any():
        problem = f"shows no ground within {settings.range:g} m"
        raise InputError("image", problem, "check height, pitch and field of view")
    mean_spacing = (spacing * inside).sum(1) / np.maximum(inside.sum(1), 1)
    halvings = np.floor(np.log2(np.clip(mean_spacing, 1, 2**MAX_HALVINGS))).astype(int)
    columns, rows = (np.ascontiguousarray(pixels[..., axis], np.float32) for axis in (0, 1))
    samples = torch.from_numpy(azimuth), torch.from_numpy(distance)
    pixels = columns, rows, halvings, torch.from_numpy(inside)
    widths, polar = _ray_widths(*samples, settings), _cells_in_rays(*samples, settings)
    return RaySamples(*samples, *pixels, *widths, *polar)


def _ray_widths(azimuth: Tensor, distance: Tensor, settings: GridSettings) -> tuple[Tensor, Tensor]:
    """Return the first and one past the last ray within a cell's width of each sample, (K+1, B)."""
    turn = float(azimuth[1] - azimuth[0])
    half = (settings.cell / 2 / distance / turn).round().long()[:, None]
    ray = torch.arange(len(azimuth))
    return (ray - half).clamp_min(0), (ray + half + 1).clamp_max(len(azimuth))


def _cells_in_rays(
    azimuth: Tensor, distance: Tensor, settings: GridSettings
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Return polar coordinates of the cells' centres around the camera's foot: ``RaySamples``."""
    distance, size = (distance[1:] + distance[:-1]) / 2, settings.cell
    columns, rows = math.ceil(settings.range / size), 2 * math.ceil(settings.side / size)
    x = (torch.arange(columns, dtype=torch.float64) + 0.5) * size
    y = ((torch.arange(rows, dtype=torch.float64) + 0.5 - rows / 2) * size)[:, None]
    radius = torch.hypot(x, y)
    index = ((radius - distance[0]) / (distance[1] - distance[0])).round().long()
    ray = ((torch.atan2(y, x) - azimuth[0]) / (azimuth[1] - azimuth[0])).round().long()
    inside = (index >= 0) & (index < len(distance)) & (ray >= 0) & (ray < len(azimuth))
    index, ray = index.clamp(0, len(distance) - 1), ray.clamp(0, len(azimuth) - 1)
    return radius, index, ray, inside


def _azimuth_range(camera: GroundCamera) -> tuple[float, float]:
    """Return the least and greatest azimuth, radians, of the visible ground, at most ±π/2."""
    width, height = camera.lens.width, camera.lens.height
    foot = np.array([[*camera.pose.position[:2], 0.0]])
    if camera.project(foot)[1].any():
        return -math.pi / 2, math.pi / 2
    x, y = (np.linspace(0, end - 1, BORDER_SAMPLES) for end in (width, height))
    sides = [(x, np.full(BORDER_SAMPLES, end)) for end in (0, height - 1)]
    sides += [(np.full(BORDER_SAMPLES, end), y) for end in (0, width - 1)]
    rays = camera.unproject(np.concatenate([np.column_stack(side) for side in sides]))
    rays = rays[rays[:, 2] < 0]
    azimuth = np.clip(np.arctan2(rays[:, 1], rays[:, 0]), -math.pi / 2, math.pi / 2)
    if azimuth.size == 0 or azimuth.max() - azimuth.min() < 1e-3:
        raise InputError("image", "shows no ground", "check pitch and field of view")
    return float(azimuth.min()), float(azimuth.max())


# --- values along rays ------------------------------------------------------------------


def _sample_bilinear(values: Tensor, rays: RaySamples) -> Tensor:
    """Sample values (H, W) at (K+1, B), bilinearly; near the camera means of many pixels."""
    source = values.detach().cpu().contiguous().numpy()
    height, width = source.shape
    samples = np.empty(rays.columns.shape, np.float32)
    for halvings in range(int(rays.halvings.max()) + 1):
        if halvings:
            size = (math.ceil(source.shape[1] / 2), math.ceil(source.shape[0] / 2))
            source = cv2.resize(source, size, interpolation=cv2.INTER_AREA)
        at = rays.halvings == halvings
        if at.any():
            columns = (rays.columns[at] + 0.5) * (source.shape[1] / width) - 0.5
            rows = (rays.rows[at] + 0.5) * (source.shape[0] / height) - 0.5
            border = cv2.BORDER_REPLICATE
            samples[at] = cv2.remap(source, columns, rows, cv2.INTER_LINEAR, borderMode=border)
    return torch.from_numpy(samples)


def _cell_means(values: Tensor, visible: Tensor, rays: RaySamples) -> tuple[Tensor, Tensor]:
    """Return means of samples (K+1, B) over a cell's length and width, (K, B), and visible ones.

    Near the camera a cell is wide compared with the rays, far off narrower than a pixel.
    """
    weight = visible.double()
    sums = torch.stack([values * weight, weight]).cumsum(2)
    sums = torch.nn.functional.pad(sums, (1, 0))
    total = sums.gather(2, rays.end.expand(2, -1, -1))
    total -= sums.gather(2, rays.start.expand(2, -1, -1))
    total = total[:, 1:] + total[:, :-1]
    width = rays.end - rays.start
    width = width[1:] + width[:-1]
    mean = total[0] / total[1].clamp_min(1e-9)
    return mean.float(), total[1] >= MIN_VISIBLE_FRACTION * width


def _edge_cells(free: Tensor, azimuth: Tensor, size: float, shape: torch.Size) -> Tensor:
    """Return the cells, bool (R, C), in which rays end at the first one without road.

    free, azimuth: (B,). Rays meet a road's side at a slant: points between the ends of neighbouring
    rays close the gaps, but not at a corner, where one end is much nearer and what lies between is
    unknown.
    """
    ends = free + size / (2 * SAMPLES_ALONG)
    joined = (ends[1:] - ends[:-1]).abs() <= MAX_GAP_CELLS * size
    weight = torch.linspace(0, 1, GAP_POINTS, dtype=torch.float64)[:, None]
    radius = torch.cat([ends, torch.lerp(ends[:-1], ends[1:], weight)[:, joined].reshape(-1)])
    angle = torch.lerp(azimuth[:-1], azimuth[1:], weight)[:, joined].reshape(-1)
    angle = torch.cat([azimuth, angle])[radius.isfinite()]
    radius = radius[radius.isfinite()]
    column = (radius * angle.cos() / size).floor().long()
    row = ((radius * angle.sin() + shape[0] / 2 * size) / size).floor().long()
    inside = (row >= 0) & (row < shape[0]) & (column >= 0) & (column < shape[1])
    cells = torch.zeros(shape, dtype=torch.bool)
    cells[row[inside], column[inside]] = True
    return cells
