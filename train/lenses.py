"""Score a detector on rendered fisheyes, without and with their lenses: one row a kind.

    python -m train.lenses WORLDS… [--detector fusion] [--limit 20] [--sheet SHEET.png]

WORLDS is a folder of ``train.worlds`` with lenses/. F is the mean over images of what is not void;
the interval is of its difference, with 1,000 draws of images. The sheet shows each image twice, as
found without its lens above, and the true road outlined in red.
"""

import argparse
import tomllib
from itertools import chain, islice
from pathlib import Path

import cv2
import numpy as np
import torch

from roadtorch import Detection, load_detector
from roadtorch.base.image import write_pixels
from roadtorch.evaluation.uncertainty import mean_interval
from train.worlds.reader import read_world

COLUMNS = 6  # of the sheet
ALL = "all"


def read_rectification(path: Path) -> dict[str, object]:
    """Return the setting ``rectification`` of a world's lens and pitch."""
    lens = tomllib.loads(path.read_text(encoding="utf-8"))
    mount = lens.pop("mount")
    return {"lens": {**lens, "field_of_view": mount["view"]}, "pitch": mount["pitch"]}


def outline_truth(detection: Detection, road: torch.Tensor) -> np.ndarray:
    """Draw a mask over its image, and the true road, bool (H, W), in red; uint8 (H, W, 3)."""
    overlay = np.ascontiguousarray(detection.overlay())
    contours = cv2.findContours(
        road.numpy().astype(np.uint8), cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE
    )[0]
    return cv2.drawContours(overlay, contours, -1, (255, 0, 0), 1)


def main() -> None:
    """Print F and trust of each kind of world without and with the lens."""
    parser = argparse.ArgumentParser(description="F of a detector on fisheyes.")
    parser.add_argument("worlds", type=Path, nargs="+")
    parser.add_argument("--detector", default="fusion")
    parser.add_argument("--limit", type=int)
    parser.add_argument("--sheet", type=Path)
    options = parser.parse_args()
    plain = load_detector(options.detector)
    kinds, rows, pairs = [], [], []
    files = chain(*(sorted((root / "lenses").glob("*.toml")) for root in options.worlds))
    for path in islice(files, options.limit):
        image, truth = read_world(path.parents[1] / "images" / f"{path.stem}.jpg")
        rectified = load_detector(options.detector, rectification=read_rectification(path))
        detections = [plain(image), rectified(image)]
        road = truth.road & truth.valid
        masks = [detection.mask & truth.valid for detection in detections]
        scores = [
            2 * (mask & road).sum() / (mask.sum() + road.sum()).clamp(min=1) for mask in masks
        ]
        kinds.append(path.stem.split("_")[1])
        rows.append([*map(float, scores), *(detection.trust or 0.0 for detection in detections)])
        pairs.append(np.vstack([outline_truth(detection, road) for detection in detections]))
    for kind in [*sorted(set(kinds)), ALL]:
        chosen = [row for row, name in zip(rows, kinds, strict=True) if kind in (name, ALL)]
        table = torch.tensor(chosen)
        without, known, *trust = table.mean(0).tolist()
        low, high = mean_interval(table[:, 1] - table[:, 0])
        print(f"{kind:13} {len(table):4}  F {without:.3f} {known:.3f}", end="  ")
        print(f"{known - without:+.3f} ({low:+.3f} to {high:+.3f})", end="  ")
        print(f"trust {trust[0]:.2f} {trust[1]:.2f}")
    if options.sheet:
        pairs = [cv2.resize(pair, pairs[0].shape[1::-1]) for pair in pairs]  # of worlds of any size
        empty = [np.zeros_like(pairs[0])] * (-len(pairs) % COLUMNS)
        sheet = [*pairs, *empty]
        lines = [np.hstack(sheet[at : at + COLUMNS]) for at in range(0, len(sheet), COLUMNS)]
        write_pixels(options.sheet, np.vstack(lines))


if __name__ == "__main__":
    main()
