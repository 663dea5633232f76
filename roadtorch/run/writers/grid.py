"""Files of ground grids: PGM and YAML for map_server, NumPy arrays, and messages in bags.

Values and keys are those of nav2_map_server's map_saver (map_io.cpp): 254 free, 0 occupied, 205
unknown, and occupied from .65 of (255 - value) / 255. Its default free_thresh of .25 would read
205, which is .196, as free; .196 keeps unknown cells unknown, in ROS 1 as well.
"""

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from torch import Tensor

from roadtorch.base.atomic import atomic_write, write_text
from roadtorch.base.errors import RoadtorchError, to_input_error
from roadtorch.base.image import tint_mask, to_pixels, write_npy, write_pixels
from roadtorch.camera.ground_grid import FREE, OCCUPIED, Grid, GridSettings, ground_grid
from roadtorch.camera.mounting import CameraPlacement
from roadtorch.detectors.detection import Detection
from roadtorch.inputs.item import Item
from roadtorch.run.ledger import DONE, DOUBTFUL
from roadtorch.run.writers.bag import BagWriter

GRID_SUFFIXES = {
    "pgm": ".grid.pgm",
    "yaml": ".grid.yaml",
    "npy": ".grid.npy",
    "likelihood": ".grid.likelihood.npy",
    "image": ".grid.jpg",
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
    # YAML does not join the two halves of a letter beyond 16 bits, which JSON escapes apart.
    name = "".join(
        letter if ord(letter) > 0xFFFF else json.dumps(letter)[1:-1] for letter in image.name
    )
    lines = [f"# {comment}"] if comment else []
    lines += [
        f'image: "{name}"',
        "mode: trinary",
        f"resolution: {grid.resolution:g}",
        f"origin: [{grid.origin[0]:g}, {grid.origin[1]:g}, 0]",
        "negate: 0",
        f"occupied_thresh: {OCCUPIED_THRESHOLD}",
        f"free_thresh: {FREE_THRESHOLD}",
        "",
    ]
    write_text(stem.with_name(stem.name + ".grid.yaml"), "\n".join(lines))


@dataclass(frozen=True)
class GridWriter:
    """A writer of a ground grid for each image, and optionally into a bag."""

    folder: Path
    placement: CameraPlacement
    settings: GridSettings
    kinds: Sequence[str]  # see ``GRID_SUFFIXES``
    bag: BagWriter | None = None
    frame_id: str = "base_link"  # of the robot, in which grids are written

    @property
    def suffixes(self) -> Sequence[str]:
        """Suffixes of its files."""
        return [GRID_SUFFIXES[kind] for kind in self.kinds]

    def write(self, item: Item, detection: Detection) -> Mapping[str, str]:
        """Write the grid of an image; its road share in index.csv is the fraction of free cells.

        Raises:
            InputError: where the pitch is unknown, or a file cannot be written.
        """
        try:
            grid, doubt = self._write_files(item, detection)
        except RoadtorchError as error:
            raise to_input_error(item.origin, error) from None
        if self.bag is not None:
            self.bag.write_grid(item, grid)
        doubts = ", ".join(filter(None, (detection.doubt, doubt)))
        free = float((grid.cells == FREE).double().mean())
        return {"road_share": f"{free:.4f}", "status": f"{DOUBTFUL}: {doubts}" if doubts else DONE}

    def close(self) -> None:
        """Close the bag."""
        if self.bag is not None:
            self.bag.close()

    def _write_files(self, item: Item, detection: Detection) -> tuple[Grid, str]:
        """Compute a grid and write its files; return it with a reason for doubt, or ""."""
        image = detection.image
        assert image is not None
        camera, pitch = self.placement(image, detection.cues.get("layout"))
        # Zeroed where the mask excludes likely road, but kept below the threshold, so that cells
        # between pixels interpolate it.
        likelihood, threshold = detection.likelihood, self.settings.threshold
        road = likelihood * (detection.mask | (likelihood < threshold))
        grid = ground_grid(road, camera, self.settings, detection.cues.get("ego"))
        stem = self.folder / item.name
        write_grid(stem, grid, f"pitch {pitch.degrees:.2f} degrees, {pitch.reason}")
        if "likelihood" in self.kinds:
            write_npy(stem.with_name(stem.name + GRID_SUFFIXES["likelihood"]), grid.likelihood)
        if "image" in self.kinds:
            drawing = _draw_beside(image, detection.mask, grid)
            write_pixels(stem.with_name(stem.name + GRID_SUFFIXES["image"]), drawing)
        doubts = [f"{100 * grid.blocked:.0f} % of the road lies behind obstacles"]
        doubts = doubts if grid.blocked > DOUBTFUL_BLOCKED else []
        if pitch.deviation > DOUBTFUL_SPREAD:
            doubts.append(f"pitch unsure by {pitch.deviation:.1f} degrees")
        return grid, ", ".join(doubts)


def _draw_beside(image: Tensor, mask: Tensor, grid: Grid) -> np.ndarray:
    """Draw an image (3, H, W) with its road tinted, and the grid to its right, x upwards: RGB."""
    tinted = tint_mask(to_pixels(image), mask.cpu().numpy())
    upright = cv2.rotate(_draw_grid(grid), cv2.ROTATE_90_COUNTERCLOCKWISE)
    height = tinted.shape[0]
    width = max(1, round(upright.shape[1] * height / upright.shape[0]))
    upright = cv2.resize(upright, (width, height), interpolation=cv2.INTER_AREA)
    return np.hstack([tinted, np.repeat(upright[..., None], 3, 2)])
