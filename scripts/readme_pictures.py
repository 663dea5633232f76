"""The pictures of README: what `fusion` makes of free pictures and of a free drive.

    python scripts/readme_pictures.py DATA    # docs/pictures: steps.jpg, drive.gif, made.json

DATA holds unlabelled_free/ and clips/. docs/pictures/sources.csv says where they are from, and
made.json has the hashes of the weights and settings that made them, to which a test holds them.
"""

import argparse
import json
from dataclasses import replace
from hashlib import sha256
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from roadtorch import detect_stream, load_detector, read_image
from roadtorch.base.atomic import digest_of
from roadtorch.base.image import to_pixels
from roadtorch.detectors.detector import Detection, Detector
from roadtorch.evaluation.report.montage import TILE_WIDTH, captioned, cue_tiles, heat
from roadtorch.layout.weights import FOR_PICTURES, shipped_weights

CHOSEN = ("udadv_test5.jpg", "mcubes_h07.jpg", "comma10k_0008.jpg", "cat_v11.jpg")
"""A motorway under trees, a street, a bonnet in view, a track: one of each recording."""

DRIVE, DRIVE_SECONDS, DRIVE_WIDTH = "california_tree_shadows.mp4", (3.0, 6.0), 320

EVERY, DURATION, COLOURS = 2, 133, 64  # of 15 frames a second; milliseconds; of the palette

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


def write_drive(clip: Path, path: Path) -> None:
    """A few seconds of a drive, steadied."""
    start, end = DRIVE_SECONDS
    frames = [
        Image.fromarray(small(detection.overlay())).quantize(COLOURS, dither=Image.Dither.NONE)
        for detection in detect_stream(clip, load_detector("fusion"))
        if detection.seconds is not None and start <= detection.seconds < end
    ][::EVERY]
    frames[0].save(path, save_all=True, append_images=frames[1:], duration=DURATION, loop=0)


def small(pixels: np.ndarray) -> np.ndarray:
    """Pixels (H,W,3) at the width of the drive."""
    height = round(pixels.shape[0] * DRIVE_WIDTH / pixels.shape[1])
    return cv2.resize(pixels, (DRIVE_WIDTH, height), interpolation=cv2.INTER_AREA)


def made_with() -> dict[str, str]:
    """Hashes of the weights and settings of `fusion`."""
    settings = load_detector("fusion").settings.model_dump_json()
    return {
        "weights": digest_of(shipped_weights(FOR_PICTURES)),
        "settings": sha256(settings.encode()).hexdigest(),
    }


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="The pictures of README.")
    parser.add_argument("data", type=Path)
    data = parser.parse_args().data
    write_steps(data / "unlabelled_free", OUT / "steps.jpg")
    write_drive(data / "clips" / DRIVE, OUT / "drive.gif")
    (OUT / "made.json").write_text(f"{json.dumps(made_with(), indent=0)}\n", encoding="utf-8")
