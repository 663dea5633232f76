"""The pictures of README: what `fusion` makes of free pictures."""

import csv
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from roadtorch import load_detector, read_image
from roadtorch.detector import Detection, Detector
from roadtorch.io.image import to_pixels
from roadtorch.report.montage import TILE_WIDTH, captioned, cue_tiles, heat

CHOSEN = ("udadv_test5.jpg", "mcubes_h07.jpg", "comma10k_0008.jpg", "cat_v11.jpg")
"""A motorway under trees, a street, a bonnet in view, a track: one of each recording."""

QUALITY = 85  # of JPEG


def make(data: Path, out: Path) -> None:
    """Write steps.jpg and sources.csv."""
    out.mkdir(parents=True, exist_ok=True)
    folder = data / "unlabelled_free"
    write_steps(folder, out / "steps.jpg")
    write_sources(folder, out / "sources.csv")
    for path in sorted(out.iterdir()):
        print(f"{path.name}: {path.stat().st_size:,} bytes")


def write_steps(folder: Path, path: Path) -> None:
    """A row a picture: input, layout, texture, likelihood, mask."""
    detector = load_detector("fusion")
    rows = [steps(detector, folder / name) for name in CHOSEN]
    options = [cv2.IMWRITE_JPEG_QUALITY, QUALITY]
    cv2.imwrite(str(path), np.ascontiguousarray(np.concatenate(rows)[..., ::-1]), options)


def steps(detector: Detector, path: Path) -> np.ndarray:
    """One row uint8 (h,w,3) RGB."""
    image = read_image(path)
    found = detector.detect(image)
    tiles = tiles_of(to_pixels(image), found)
    height = round(image.shape[1] * TILE_WIDTH / image.shape[2])
    return np.concatenate([captioned(tile, text, height) for text, tile in tiles.items()], axis=1)


def tiles_of(pixels: np.ndarray, found: Detection) -> dict[str, np.ndarray]:
    cues = cue_tiles(found)
    return {
        "input": pixels,
        "layout: sky, vertical, ground": cues["layout"],
        "texture: how even": cues["uniformity"],
        "likelihood of road": heat(found.likelihood),
        f"mask, {found.caption}": replace(found, trust=None).overlay(),
    }


def write_sources(folder: Path, path: Path) -> None:
    """Repository, path and licence of the chosen pictures."""
    with (folder / "pictures.csv").open(newline="", encoding="utf-8") as file:
        rows = [row for row in csv.reader(file)]
    with path.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file, lineterminator="\n").writerows(
            [rows[0], *(r for r in rows if r[0] in CHOSEN)]
        )
