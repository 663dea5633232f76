"""Grids of the ground as robots load them: PGM and YAML for map_server, NumPy, and in bags.

Values and keys are those that nav2_map_server's map_saver writes (map_io.cpp): 254 free, 0
occupied, 205 unknown, and occupied from .65 of (255 - value) / 255. Its default free_thresh of
.25 would read 205, which is .196, as free; .196 keeps unknown unknown, in ROS 1 as well.
"""

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import torch
from torch import Tensor

from roadtorch.base.atomic import atomic, write_text
from roadtorch.base.errors import RoadtorchError, fault
from roadtorch.base.image import tint_mask, to_pixels, write_jpeg, write_npy
from roadtorch.camera.ground_grid import FREE, OCCUPIED, Grid, GridSettings, ground_grid
from roadtorch.camera.mounting import Placing
from roadtorch.detectors.detection import Detection
from roadtorch.inputs.item import Item
from roadtorch.run.ledger import DONE, DOUBTFUL
from roadtorch.run.writers.bag import BagWriter

SUFFIXES = {
    "pgm": ".grid.pgm",
    "yaml": ".grid.yaml",
    "npy": ".grid.npy",
    "likelihood": ".grid.likelihood.npy",
    "image": ".grid.jpg",
}

UNSURE = 2.0
"""Degrees of spread of a pitch from which a grid is called doubtful."""

FREE_GREY, OCCUPIED_GREY, UNKNOWN_GREY = 254, 0, 205

OCCUPIED_FROM, FREE_UP_TO = 0.65, 0.196


def map_image(grid: Grid) -> np.ndarray:
    """A grid as map_server's image, uint8: x to the right, y upwards, the first row on top."""
    cells = grid.cells.cpu().numpy()
    grey = np.full(cells.shape, UNKNOWN_GREY, np.uint8)
    grey[cells == FREE] = FREE_GREY
    grey[cells == OCCUPIED] = OCCUPIED_GREY
    return grey[::-1].copy()


def write_grid(stem: str | os.PathLike[str], grid: Grid, comment: str = "") -> None:
    """Write STEM.grid.pgm, STEM.grid.yaml and STEM.grid.npy (int8, y by x); folders must exist.

    comment: one line for the YAML. Raises InputError when one cannot be written.
    """
    stem = Path(stem)
    grey, image = map_image(grid), stem.with_name(stem.name + ".grid.pgm")
    with atomic(image) as temporary:
        head = f"P5\n{grey.shape[1]} {grey.shape[0]}\n255\n"
        temporary.write_bytes(head.encode() + grey.tobytes())
    write_npy(stem.with_name(stem.name + ".grid.npy"), grid.cells)
    lines = [f"# {comment}"] if comment else []
    lines += [
        f"image: {json.dumps(image.name)}",
        "mode: trinary",
        f"resolution: {grid.resolution:g}",
        f"origin: [{grid.origin[0]:g}, {grid.origin[1]:g}, 0]",
        "negate: 0",
        f"occupied_thresh: {OCCUPIED_FROM}",
        f"free_thresh: {FREE_UP_TO}",
        "",
    ]
    write_text(stem.with_name(stem.name + ".grid.yaml"), "\n".join(lines))


@dataclass(frozen=True)
class Grids:
    """The grid of each image, and the same in a bag where there is one.

    placing: where the camera is. kinds: of files, see ``SUFFIXES``. frame_id: of the robot.
    """

    folder: Path
    placing: Placing
    settings: GridSettings
    kinds: Sequence[str]
    bag: BagWriter | None = None
    frame_id: str = "base_link"

    @property
    def suffixes(self) -> Sequence[str]:
        """How the names of its files end."""
        return [SUFFIXES[kind] for kind in self.kinds]

    def write(self, item: Item, detection: Detection) -> Mapping[str, str]:
        """Write the grid of an image; its road share is that of free cells.

        Raises what ``placing`` and ``ground_grid`` raise.
        """
        try:
            grid, doubt = self._written(item, detection)
        except RoadtorchError as error:
            raise fault(item.origin, error) from None
        if self.bag is not None:
            cells, (x, y) = grid.cells.cpu().numpy(), grid.origin
            self.bag.write_grid(cells, grid.resolution, (x, y), item.nanoseconds, self.frame_id)
        doubts = ", ".join(filter(None, (detection.doubt, doubt)))
        share = float((grid.cells == FREE).double().mean())
        return {
            "road_share": f"{share:.4f}",
            "status": f"{DOUBTFUL}: {doubts}" if doubts else DONE,
        }

    def close(self) -> None:
        """End the bag."""
        if self.bag is not None:
            self.bag.close()

    def _written(self, item: Item, detection: Detection) -> tuple[Grid, str]:
        """The grid, its files written, and why it should not be trusted."""
        image = detection.image
        assert image is not None
        camera, pitch = self.placing(image, detection.cues.get("layout"))
        # Regions that the mask dropped are none; the threshold parts what is between pixels, too.
        likelihood, threshold = detection.likelihood, self.settings.threshold
        road = likelihood * (detection.mask | (likelihood < threshold))
        grid = ground_grid(road, camera, self.settings, detection.cues.get("ego"))
        stem = self.folder / item.name
        write_grid(stem, grid, f"pitch {pitch.degrees:.2f} degrees, {pitch.reason}")
        if "likelihood" in self.kinds:
            write_npy(stem.with_name(stem.name + SUFFIXES["likelihood"]), grid.likelihood)
        if "image" in self.kinds:
            both = beside(image, detection.mask, grid)
            write_jpeg(stem.with_name(stem.name + SUFFIXES["image"]), both)
        return grid, f"pitch unsure by {pitch.spread:.1f} degrees" if pitch.spread > UNSURE else ""


def beside(image: Tensor, mask: Tensor, grid: Grid) -> Tensor:
    """The image with its road tinted and the grid, x upwards, at its right: (3,h,w) in [0,1]."""
    tinted = tint_mask(to_pixels(image), mask.cpu().numpy())
    upright = cv2.rotate(map_image(grid), cv2.ROTATE_90_COUNTERCLOCKWISE)
    height = tinted.shape[0]
    width = max(1, round(upright.shape[1] * height / upright.shape[0]))
    upright = cv2.resize(upright, (width, height), interpolation=cv2.INTER_AREA)
    both = np.hstack([tinted, np.repeat(upright[..., None], 3, 2)])
    return torch.from_numpy(both).permute(2, 0, 1) / 255
