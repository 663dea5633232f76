"""Files of ground grids: PGM and YAML for map_server, NumPy arrays, and messages in bags.

Values and keys are those of nav2_map_server's map_saver (map_io.cpp): 254 free, 0 occupied, 205
unknown, and occupied from .65 of (255 - value) / 255. Its default free_thresh of .25 would read
205, which is .196, as free; .196 keeps unknown cells unknown, in ROS 1 as well.
"""

import json
import os
from collections.abc import Set
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from torch import Tensor

from roadtorch.base.atomic import atomic_write, write_text
from roadtorch.base.image import tint_mask, to_pixels, write_npy, write_pixels
from roadtorch.camera.ground import GroundCamera
from roadtorch.camera.ground_grid import FREE, OCCUPIED, Grid, ground_grid
from roadtorch.camera.mounting import CameraPlacement, Pitch
from roadtorch.detectors.detection import Detection
from roadtorch.inputs.item import Item
from roadtorch.run.writers.bag import BagWriter

GRID_SUFFIXES = {
    "grid": (".grid.pgm", ".grid.yaml", ".grid.npy"),
    "grid-likelihood": (".grid.likelihood.npy",),
    "grid-image": (".grid.jpg",),
}

DOUBTFUL_SPREAD = 2.0  # standard deviation of a pitch, in degrees, above which a grid is doubtful

DOUBTFUL_BLOCKED = 0.8  # blocked fraction of the road above which a grid is doubtful

FREE_GREY, OCCUPIED_GREY, UNKNOWN_GREY = 254, 0, 205

OCCUPIED_THRESHOLD, FREE_THRESHOLD = 0.65, 0.196


def _draw_grid(grid: Grid) -> np.ndarray:
    """Draw a grid for map_server: grey values, uint8 (H, W), x to the right, y upwards."""
    cells = grid.cells.cpu().numpy()
    grey = np.full(cells.shape, UNKNOWN_GREY, np.uint8)
    grey[cells == FREE] = FREE_GREY
    grey[cells == OCCUPIED] = OCCUPIED_GREY
    return grey[::-1].copy()


def write_grid(stem: str | os.PathLike[str], grid: Grid, comment: str = "") -> None:
    """Write STEM.grid.pgm, STEM.grid.yaml and STEM.grid.npy: int8, rows along y, columns along x.

    stem: path without suffixes; its folder must exist. comment: one line for the YAML. Raises
    InputError when a file cannot be written.
    """
    stem = Path(stem)
    grey, image = _draw_grid(grid), stem.with_name(stem.name + ".grid.pgm")
    with atomic_write(image) as temporary:
        head = f"P5\n{grey.shape[1]} {grey.shape[0]}\n255\n"
        temporary.write_bytes(head.encode() + grey.tobytes())
    write_npy(stem.with_name(stem.name + ".grid.npy"), grid.cells)
    lines = [f"# {comment}"] if comment else []
    lines += [
        f"image: {json.dumps(image.name, ensure_ascii=False)}",
        "mode: trinary",
        f"resolution: {grid.resolution:g}",
        f"origin: [{grid.origin[0]:g}, {grid.origin[1]:g}, 0]",
        "negate: 0",
        f"occupied_thresh: {OCCUPIED_THRESHOLD}",
        f"free_thresh: {FREE_THRESHOLD}",
        "",
    ]
    write_text(stem.with_name(stem.name + ".grid.yaml"), "\n".join(lines))


def make_grid(
    placement: CameraPlacement, detection: Detection, threshold: float
) -> tuple[Grid, GroundCamera, Pitch]:
    """Map a detection onto the ground; return the grid, and the camera that it was seen by.

    threshold: that of the mask. Raises InputError where the pitch is unknown.
    """
    assert detection.image is not None
    camera, pitch = placement(detection.image, detection.cues.get("layout"))
    # Zeroed where the mask excludes likely road, but kept below the threshold, so that cells
    # between pixels interpolate it.
    road = detection.likelihood * (detection.mask | (detection.likelihood < threshold))
    ego = detection.cues.get("ego")
    return ground_grid(road, camera, placement.settings, ego, threshold), camera, pitch


@dataclass(frozen=True)
class GridWriter:
    """A writer of a ground grid for each image, and optionally into a bag."""

    placement: CameraPlacement
    threshold: float
    bag: BagWriter | None = None

    def write(self, stem: Path, kinds: Set[str], item: Item, detection: Detection) -> str:
        """Write the files of the kinds of ``GRID_SUFFIXES``; return a reason for doubt, or ""."""
        grid, _, pitch = make_grid(self.placement, detection, self.threshold)
        if "grid" in kinds:
            write_grid(stem, grid, f"pitch {pitch.degrees:.2f} degrees, {pitch.reason}")
        if "grid-likelihood" in kinds:
            write_npy(stem.with_name(stem.name + ".grid.likelihood.npy"), grid.likelihood)
        if "grid-image" in kinds:
            assert detection.image is not None
            drawing = _draw_beside(detection.image, detection.mask, grid)
            write_pixels(stem.with_name(stem.name + ".grid.jpg"), drawing)
        if self.bag is not None:
            self.bag.write_grid(item, grid, self.placement.settings.frame)
        doubts = [f"{100 * grid.blocked:.0f} % of the road lies behind obstacles"]
        doubts = doubts if grid.blocked > DOUBTFUL_BLOCKED else []
        if pitch.deviation > DOUBTFUL_SPREAD:
            doubts.append(f"pitch unsure by {pitch.deviation:.1f} degrees")
        return ", ".join(doubts)


def _draw_beside(image: Tensor, mask: Tensor, grid: Grid) -> np.ndarray:
    """Draw an image (3, H, W) with its road tinted, and the grid to its right, x upwards: RGB."""
    tinted = tint_mask(to_pixels(image), mask.cpu().numpy())
    upright = cv2.rotate(_draw_grid(grid), cv2.ROTATE_90_COUNTERCLOCKWISE)
    height = tinted.shape[0]
    width = max(1, round(upright.shape[1] * height / upright.shape[0]))
    upright = cv2.resize(upright, (width, height), interpolation=cv2.INTER_AREA)
    return np.hstack([tinted, np.repeat(upright[..., None], 3, 2)])
