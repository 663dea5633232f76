"""The picture of README: what `fusion` makes of free pictures, with their sources.

    python scripts/readme_pictures.py DATA    # docs/pictures/steps.jpg and sources.csv

DATA holds unlabelled_free/. How the drive beside it was made is in the history: train/README.md.
"""

import argparse
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
OUT = Path(__file__).resolve().parents[1] / "docs" / "pictures"


def write_steps(folder: Path, path: Path) -> None:
    """A row a picture: input, layout, likelihood, mask."""
    detector = load_detector("fusion")
    rows = [steps(detector, folder / name) for name in CHOSEN]
    options = [cv2.IMWRITE_JPEG_QUALITY, QUALITY]
    cv2.imwrite(str(path), np.ascontiguousarray(np.concatenate(rows)[..., ::-1]), options)


def steps(detector: Detector, path: Path) -> np.ndarray:
    """One row uint8 (h,w,3) RGB."""
    image = read_image(path)
    detection = detector.detect(image)
    tiles = tiles_of(to_pixels(image), detection)
    height = round(image.shape[1] * TILE_WIDTH / image.shape[2])
    return np.concatenate([captioned(tile, text, height) for text, tile in tiles.items()], axis=1)


def tiles_of(pixels: np.ndarray, detection: Detection) -> dict[str, np.ndarray]:
    cues = cue_tiles(detection)
    return {
        "input": pixels,
        "layout: sky, vertical, ground": cues["layout"],
        "likelihood of road": heat(detection.likelihood),
        f"mask, {detection.caption}": replace(detection, trust=None).overlay(),
    }


def write_sources(folder: Path, path: Path) -> None:
    """Repository, path and licence of the chosen pictures."""
    with (folder / "pictures.csv").open(newline="", encoding="utf-8") as file:
        rows = [row for row in csv.reader(file)]
    with path.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file, lineterminator="\n").writerows(
            [rows[0], *(r for r in rows if r[0] in CHOSEN)]
        )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="The picture of README.")
    parser.add_argument("data", type=Path)
    free = parser.parse_args().data / "unlabelled_free"
    write_steps(free, OUT / "steps.jpg")
    write_sources(free, OUT / "sources.csv")
