"""Make the images of README: what `fusion` makes of free images and of a free drive.

    python scripts/readme_pictures.py DATA    # docs/pictures: its images and made.json

DATA holds unlabelled_free/ and clips/. docs/pictures/sources.csv and, for the gallery,
train/street_images.csv say where they are from; made.json has the hashes of the weights and
settings that made them, to which a test holds them.
"""

import csv
import json
from argparse import ArgumentParser, RawDescriptionHelpFormatter
from collections.abc import Sequence
from dataclasses import replace
from hashlib import sha256
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from roadtorch import detect_stream, load_detector, read_image
from roadtorch.base.atomic import file_digest
from roadtorch.base.image import to_pixels
from roadtorch.evaluation.report.montage import TILE_WIDTH, apply_colormap, caption_tile, cue_tiles
from roadtorch.inputs.item import evenly_spaced
from roadtorch.layout import weights
from roadtorch.layout.network_cues import count_upper_rows, resize_rows

CHOSEN = ("udadv_test5.jpg", "mcubes_h07.jpg", "comma10k_0008.jpg", "cat_v11.jpg")
"""A motorway beside trees, a street, a bonnet in view, a track: one of each recording."""

STEPWISE = "comma10k_0008.jpg"
"""A road with a bonnet in view."""

FAILED = ("walkrobot_jp_005", "offroad_fr_13", "vineyard_it_013", "pothole8_004")
"""A pavement, a verge, a vineyard without road, a dashboard before a road half in shadow."""

READ = ("rseg_0103", "sc_0123", "aura_0002", "walkrobot_jp_009", "pothole8_004", "mcnight_0007")
"""A country road, a track; a plaza, a pavement; a road half in shadow, a tunnel at night."""

DRIVE, DRIVE_SECONDS, DRIVE_WIDTH = "california_tree_shadows.mp4", (3.0, 6.0), 256

EVERY, DURATION, COLOURS = 3, 200, 32  # of 15 frames a second; milliseconds; of the palette

QUALITY, STEPS_QUALITY = 70, 85  # of JPEG; tests analyse the images of steps.jpg
OUT = Path(__file__).resolve().parents[1] / "docs/pictures"
STREET_IMAGES = OUT.parents[1] / "train/street_images.csv"


def write_jpeg(path: Path, sheet: np.ndarray, scale: float = 1, quality: int = QUALITY) -> None:
    """Write a sheet, uint8 RGB (H, W, 3), at a scale."""
    sheet = cv2.resize(sheet, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    options = [cv2.IMWRITE_JPEG_QUALITY, quality]
    cv2.imwrite(str(path), np.ascontiguousarray(sheet[..., ::-1]), options)


def write_steps(folder: Path, path: Path) -> None:
    """Write a row for each image: input, layout, likelihood, mask."""
    detector, rows = load_detector("fusion"), []
    for name in CHOSEN:
        image = read_image(next(folder.rglob(name)))
        detection = detector.detect(image)
        tiles = {
            "input": to_pixels(image),
            "layout: sky, vertical, ground": cue_tiles(detection)["layout"],
            "likelihood of road": apply_colormap(detection.likelihood),
            f"mask, {detection.caption}": replace(detection, trust=None).overlay(),
        }
        height = round(image.shape[1] * TILE_WIDTH / image.shape[2])
        rows.append(np.hstack([caption_tile(tile, text, height) for text, tile in tiles.items()]))
    write_jpeg(path, np.vstack(rows), quality=STEPS_QUALITY)


def write_fusion(folder: Path, path: Path) -> None:
    """Write the steps of `fusion` on one image, four in a row (docs/how/fusion.md)."""
    detector = load_detector("fusion")
    image = read_image(next(folder.rglob(STEPWISE)))
    detection = detector.detect(image)
    network = weights.load_image_network(weights.WeightsFile(), weights.DEFAULT_WEIGHTS).settings
    rows = count_upper_rows(network.upper_rows, network.height)
    resized = resize_rows(image, (network.height, network.width), rows)
    unrefined = load_detector("fusion", outlines="smooth").detect(image)
    tiles = {
        f"input, {rows} of {network.height} rows above": to_pixels(resized.clamp(0, 1)),
        "layout": cue_tiles(detection)["layout"],
        "ego car": apply_colormap(detection.cues["ego"].float()),
        "road of the network": apply_colormap(detection.cues["learned_road"]),
        "road by appearance": apply_colormap(detection.cues["appearance"]),
        "both, without the ego car": apply_colormap(unrefined.likelihood),
        "refined at edges": apply_colormap(detection.likelihood),
        f"mask, {detection.caption}": replace(detection, trust=None).overlay(),
    }
    height = round(image.shape[1] * TILE_WIDTH / image.shape[2])
    captioned = [caption_tile(tile, text, height) for text, tile in tiles.items()]
    write_jpeg(path, np.vstack([np.hstack(captioned[start : start + 4]) for start in (0, 4)]))


def mask_tiles(path: Path) -> list[np.ndarray]:
    """Return the tiles of an image and of its mask, captioned."""
    image, height = read_image(path), round(TILE_WIDTH * 3 / 5)
    detection = load_detector("fusion").detect(image)
    overlay = replace(detection, trust=None).overlay()
    tiles = {"input": to_pixels(image), f"mask, {detection.caption}": overlay}
    return [caption_tile(tile, text, height) for text, tile in tiles.items()]


def write_masks(folder: Path, names: Sequence[str], path: Path) -> None:
    """Write images side by side, inputs above their masks."""
    columns = [np.vstack(mask_tiles(folder / f"{name}.jpg")) for name in names]
    write_jpeg(path, np.hstack(columns), 0.75)


def write_gallery(folder: Path, path: Path) -> None:
    """Write the masks of 24 images evenly spaced in the list that new networks learn from."""
    with STREET_IMAGES.open(encoding="utf-8", newline="") as file:
        names = evenly_spaced([row["file"] for row in csv.DictReader(file)], 24)
    masks = [mask_tiles(folder / name)[1] for name in names]
    rows = [np.hstack(masks[start : start + 6]) for start in range(0, len(masks), 6)]
    write_jpeg(path, np.vstack(rows), 0.6)


def write_drive(clip: Path, path: Path) -> None:
    """Write a few seconds of a drive, smoothed over time."""
    start, end = DRIVE_SECONDS
    frames = []
    for detection in detect_stream(clip, load_detector("fusion")):
        if detection.seconds is not None and start <= detection.seconds < end:
            pixels = detection.overlay()
            size = DRIVE_WIDTH, round(pixels.shape[0] * DRIVE_WIDTH / pixels.shape[1])
            small = Image.fromarray(cv2.resize(pixels, size, interpolation=cv2.INTER_AREA))
            frames.append(small.quantize(COLOURS, dither=Image.Dither.NONE))
    first, *following = frames[::EVERY]
    first.save(path, save_all=True, append_images=following, duration=DURATION, loop=0)


def made_with() -> dict[str, str]:
    """Return hashes of the weights and settings of `fusion`."""
    settings = load_detector("fusion").settings.model_dump_json()
    return {
        "weights": file_digest(weights.shipped_weights(weights.DEFAULT_WEIGHTS)),
        "settings": sha256(settings.encode()).hexdigest(),
    }


if __name__ == "__main__":
    parser = ArgumentParser(description=__doc__, formatter_class=RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path)
    data = parser.parse_args().data
    write_steps(data / "unlabelled_free", OUT / "steps.jpg")
    write_fusion(data / "unlabelled_free", OUT / "fusion.jpg")
    write_masks(data / "unlabelled_free", FAILED, OUT / "failures.jpg")
    write_masks(data / "unlabelled_free", READ, OUT / "reading.jpg")
    write_gallery(data / "unlabelled_free", OUT / "gallery.jpg")
    write_drive(data / "clips" / DRIVE, OUT / "drive.gif")
    (OUT / "made.json").write_text(f"{json.dumps(made_with(), indent=0)}\n", encoding="utf-8")
