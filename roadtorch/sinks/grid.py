"""Grids of the ground as robots load them: PGM and YAML for map_server, and NumPy.

Values and keys are those that nav2_map_server's map_saver writes (map_io.cpp): 254 free, 0
occupied, 205 unknown, and occupied from .65 of (255 - value) / 255. Its default free_thresh of
.25 would read 205, which is .196, as free; .196 keeps unknown unknown, in ROS 1 as well.
"""

import json
import os
from pathlib import Path

import numpy as np

from roadtorch.camera.ground_grid import FREE, OCCUPIED, Grid
from roadtorch.io.atomic import atomic, write_text
from roadtorch.io.image import write_npy

FREE_GREY, OCCUPIED_GREY, UNKNOWN_GREY = 254, 0, 205

OCCUPIED_FROM, FREE_UP_TO = 0.65, 0.196


def map_picture(grid: Grid) -> np.ndarray:
    """A grid as map_server's picture, uint8: x to the right, y upwards, the first row on top."""
    cells = grid.cells.cpu().numpy()
    grey = np.full(cells.shape, UNKNOWN_GREY, np.uint8)
    grey[cells == FREE] = FREE_GREY
    grey[cells == OCCUPIED] = OCCUPIED_GREY
    return grey[::-1].copy()


def write_grid(stem: str | os.PathLike[str], grid: Grid, told: str = "") -> None:
    """Write STEM.grid.pgm, STEM.grid.yaml and STEM.grid.npy (int8, y by x); folders must exist.

    told: a comment, one line, for the YAML. Raises InputError when one cannot be written.
    """
    stem = Path(stem)
    grey, picture = map_picture(grid), stem.with_name(stem.name + ".grid.pgm")
    with atomic(picture) as temporary:
        head = f"P5\n{grey.shape[1]} {grey.shape[0]}\n255\n"
        temporary.write_bytes(head.encode() + grey.tobytes())
    write_npy(stem.with_name(stem.name + ".grid.npy"), grid.cells)
    lines = [f"# {told}"] if told else []
    lines += [
        f"image: {json.dumps(picture.name)}",
        "mode: trinary",
        f"resolution: {grid.resolution:g}",
        f"origin: [{grid.origin[0]:g}, {grid.origin[1]:g}, 0]",
        "negate: 0",
        f"occupied_thresh: {OCCUPIED_FROM}",
        f"free_thresh: {FREE_UP_TO}",
        "",
    ]
    write_text(stem.with_name(stem.name + ".grid.yaml"), "\n".join(lines))
