"""Print the framing of roads: how unlike the halves of images are, and where roads leave the image.

    python -m train.worlds.framing FOLDER… [--kind town] [--traffic right]

A folder contains truth/*.png of ``train.worlds``, or road/*.png (1 road, 255 void). Needs no
Blender.
"""

import argparse
import csv
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from train.worlds.truth import ROAD, VOID

CODES = {"truth": ROAD, "road": 1}
"""Codes of road in the files of each folder."""

BALANCED = 0.1
"""Asymmetry below which both halves of the road count as alike."""

MARGIN = 0.04
"""Fraction of the width in which the outermost labelled pixel of a row stands for its border."""


class Framing(NamedTuple):
    """The framing of the road in an image.

    asymmetry: (left - right) / (left + right) of its pixels in both halves of the image.
    left_only, right_only: fractions of its rows in which it leaves the image on that side alone.
    """

    asymmetry: float
    left_only: float
    right_only: float


def measure_framing(road: np.ndarray, valid: np.ndarray) -> Framing | None:
    """Measure the framing of a road mask (H, W); None without enough road.

    Rows that are void at either border do not count.
    """
    road = road & valid
    if road.sum() < 0.01 * road.size:
        return None
    half = road.shape[1] // 2
    left, right = int(road[:, :half].sum()), int(road[:, -half:].sum())
    margin = int(MARGIN * road.shape[1])
    first, last = valid.argmax(1), valid[:, ::-1].argmax(1)
    rows = road.any(1) & (first <= margin) & (last <= margin)
    index = np.arange(len(road))
    cut_left, cut_right = (road[index, first] & rows), (road[index, -1 - last] & rows)
    count = max(1, int(rows.sum()))
    return Framing(
        (left - right) / (left + right),
        float((cut_left & ~cut_right).sum()) / count,
        float((cut_right & ~cut_left).sum()) / count,
    )


def predict_one_sided(
    edges: tuple[float, float],
    height: float,
    half_view: tuple[float, float],
    turn: float,
    tilt: float,
) -> float:
    """Predict the fraction of rows in which a straight, flat road leaves the image on one side.

    A row at a slope s below the horizon shows the ground at a distance of height / s.

    Args:
        edges: metres to the near and to the far edge of the road, on opposite sides of the camera.
        height: of the camera above the road, in metres.
        half_view: tangents of half the vertical and half the horizontal field of view.
        turn: tangent of the camera's yaw towards the far edge.
        tilt: tangent of the camera's pitch downwards.

    Returns:
        The fraction of rows below the horizon in which the far edge alone is out of the image.
    """
    (near, far), (up, across) = edges, half_view
    last = up + tilt
    far_out = height * (across + turn) / far
    near_out = height * (across - turn) / near
    return max(0.0, min(near_out, last) - max(far_out, 0.0)) / last if last > 0 else 0.0


def select_worlds(folder: Path, kind: str, traffic: str) -> list[str]:
    """Return the names of a folder's worlds of a kind, with traffic on a side if one is named."""
    names = sorted(file.stem for file in (folder / "truth").glob("*.png"))
    names = [name for name in names if kind in name.split("_")[1]]
    if traffic:
        with (folder / "worlds.csv").open() as table:
            sides = {row["name"]: row["traffic"] for row in csv.DictReader(table)}
        names = [name for name in names if sides.get(name) == traffic]
    return names


def read_framings(folder: Path, kind: str, traffic: str) -> Iterator[Framing]:
    """Yield the framings of a folder's images, of worlds only those of a kind and a side."""
    place = "truth" if (folder / "truth").is_dir() else "road"
    if place == "truth":
        files = [folder / place / f"{name}.png" for name in select_worlds(folder, kind, traffic)]
    else:
        files = sorted((folder / place).glob("*.png"))
    for file in files:
        code = np.asarray(cv2.imread(str(file), cv2.IMREAD_UNCHANGED))
        framing = measure_framing(code == CODES[place], code != VOID)
        if framing is not None:
            yield framing


def main() -> None:
    """Print a row for each folder, with the 95 % interval of rows cut on one side alone."""
    parser = argparse.ArgumentParser(description="Print how the road lies in images.")
    parser.add_argument("folders", type=Path, nargs="+")
    parser.add_argument("--kind", default="", help="of worlds, e.g. town")
    parser.add_argument("--traffic", default="", choices=("right", "left"), help="of worlds")
    options = parser.parse_args()
    print("folder images (L-R)/(L+R) |…| balanced left-only right-only one-side-only ± most-rows")
    for folder in options.folders:
        table = np.array(list(read_framings(folder, options.kind, options.traffic)))
        if len(table):
            size = np.abs(table[:, 0])
            left, right = table[:, 1:].mean(0)
            margin = 1.96 * table[:, 1:].sum(1).std() / len(table) ** 0.5
            most = (table[:, 1:].sum(1) > 0.5).mean()
            print(
                f"{folder.name} {len(table)} {np.median(table[:, 0]):+.2f} {np.median(size):.2f} "
                f"{(size < BALANCED).mean():.2f} {left:.2f} {right:.2f} "
                f"{left + right:.2f} {margin:.2f} {most:.2f}"
            )


if __name__ == "__main__":
    main()
