"""A folder of rendered worlds: its files, its list, its sheet. Needs no Blender."""

import csv
import hashlib
from collections.abc import Iterable
from pathlib import Path

import cv2
import numpy as np

from train.worlds.truth import EGO, HORIZONTAL, ROAD, SKY, VOID

FOLDERS = ("images", "truth", "lenses")
COLUMNS = ("name", "kind", "light", "sha256", "code")

TONES = {SKY: (255, 160, 60), ROAD: (0, 255, 0), EGO: (0, 0, 255), HORIZONTAL: (0, 200, 255)}
TONES[VOID] = (255, 0, 255)
"""Colours of the truth on a sheet, BGR."""


def hash_truth(truth: np.ndarray) -> str:
    """Return the SHA-256 of a truth's codes, whatever its file's compression."""
    return hashlib.sha256(np.ascontiguousarray(truth, np.uint8).tobytes()).hexdigest()


def hash_code() -> str:
    """Return the first digits of the SHA-256 of this package's code: the version of its worlds."""
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).parent.glob("*.[pc][ys]*")):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:12]


def read_truth(folder: Path, name: str) -> np.ndarray:
    """Return the codes of a world, uint8 (H, W)."""
    path = folder / "truth" / f"{name}.png"
    return np.asarray(cv2.imread(str(path), cv2.IMREAD_UNCHANGED))


def append_row(folder: Path, name: str, truth: np.ndarray) -> None:
    """Append a world to the folder's list, which gets its header first."""
    _, kind, light = name.split("_")
    row = (name, kind, light, hash_truth(truth), hash_code())
    with (folder / "worlds.csv").open("a") as file:
        header = "" if file.tell() else ",".join(COLUMNS) + "\n"
        file.write(header + ",".join(row) + "\n")


def read_list(table: Path) -> dict[str, str]:
    """Return the hash of each world's truth in a list, by the world's name."""
    with table.open(encoding="utf-8", newline="") as file:
        return {row["name"]: row["sha256"] for row in csv.DictReader(file)}


def compare_with_list(folder: Path, table: Path) -> tuple[list[str], list[str]]:
    """Return the names of a list that a folder lacks, and those whose truth differs there."""
    missing, different = [], []
    for name, digest in read_list(table).items():
        files = (folder / "images" / f"{name}.jpg", folder / "truth" / f"{name}.png")
        if not all(file.exists() for file in files):
            missing.append(name)
        elif hash_truth(read_truth(folder, name)) != digest:
            different.append(name)
    return missing, different


def draw_sheet(folder: Path, numbers: Iterable[int], columns: int = 8) -> np.ndarray:
    """Return images side by side, each above a copy with its truth in colours."""
    tiles = []
    for number in numbers:
        for path in (folder / "images").glob(f"{number:05d}_*.jpg"):
            image, truth = np.asarray(cv2.imread(str(path))), read_truth(folder, path.stem)
            overlay = image.copy()
            for code, tone in TONES.items():
                overlay[truth == code] = overlay[truth == code] * 0.55 + np.array(tone) * 0.45
            cv2.putText(overlay, path.stem, (4, 14), 0, 0.45, (255, 255, 255), 1)
            tiles.append(np.concatenate([image, overlay], 0))
    tiles += [np.zeros_like(tiles[0])] * (-len(tiles) % columns)
    rows = [np.concatenate(tiles[k : k + columns], 1) for k in range(0, len(tiles), columns)]
    return np.concatenate(rows, 0)
