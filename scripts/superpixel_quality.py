"""Compare superpixels with true outlines: roadtorch's slic beside scikit-image's, on CamVid.

    python scripts/superpixel_quality.py CAMVID_ROOT --every 6 --segments 400

What is measured, as means over the pictures:

segments           how many come out; scikit-image returns fewer than asked for, so its rows
                   stand at the asked number and, "matched", at the least asked number (nearly)
                   that makes it return no fewer than roadtorch does
boundary recall    share of the true boundary's pixels with a segment boundary at most two
                   rows and two columns away
undersegmentation  Neubert and Protzel, "Superpixel Benchmark and Comparison", Forum
                   Bildverarbeitung 2012: for every class and every segment that it enters,
                   the smaller of the segment's parts inside and outside; summed, by pixels
boundary length    share of neighbouring pixel pairs that a segment boundary separates: long,
                   ragged boundaries buy recall

A boundary pixel is one whose right or lower neighbour differs. Void is nothing: neither its
outline nor its pixels count.
"""

import argparse
import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from inspect import signature
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
import skimage
import torch
from torch import Tensor
from tqdm import tqdm

from roadtorch.data.catalogue import open_dataset
from roadtorch.data.labels import read_labels
from roadtorch.errors import RoadtorchError
from roadtorch.superpixels.slic import slic

TOLERANCE = 2  # pixels
VOID = 11
OUR_COMPACTNESS = (0.05, 0.1, 0.2)  # beside the default
THEIR_COMPACTNESS = (10.0, 20.0)
HALVINGS = 5  # of the interval in which the matching number is sought

Cut = Callable[[Tensor], np.ndarray]
"""An image (3,H,W) → segment numbers (H,W)."""


class Picture(NamedTuple):
    """An image (3,H,W) with its true classes (H,W)."""

    image: Tensor
    classes: np.ndarray


@dataclass(frozen=True)
class Quality:
    """The measures of one picture, or their means."""

    segments: float
    boundary_recall: float
    undersegmentation: float
    boundary_length: float


@dataclass(frozen=True)
class Row:
    """One line of the table."""

    method: str
    compactness: str
    asked: int
    quality: Quality


def boundary(labels: np.ndarray, known: np.ndarray) -> np.ndarray:
    """bool (H,W): the right or lower neighbour has another label and both are known."""
    marked = np.zeros(labels.shape, dtype=bool)
    marked[:, :-1] |= (labels[:, 1:] != labels[:, :-1]) & known[:, 1:] & known[:, :-1]
    marked[:-1] |= (labels[1:] != labels[:-1]) & known[1:] & known[:-1]
    return marked


def boundary_recall(labels: np.ndarray, classes: np.ndarray) -> float:
    """Share of the true boundary within ``TOLERANCE`` of a segment's; NaN without any."""
    true = boundary(classes, classes != VOID)
    found = boundary(labels, np.ones(labels.shape, dtype=bool))
    window = np.ones((2 * TOLERANCE + 1,) * 2, dtype=np.uint8)
    near = cv2.dilate(found.astype(np.uint8), window) > 0
    return float(near[true].mean()) if true.any() else float("nan")


def undersegmentation(labels: np.ndarray, classes: np.ndarray) -> float:
    """Σ over classes and segments of min(inside, outside), as a share of the known pixels."""
    known = classes != VOID
    inside = np.zeros((labels.max() + 1, VOID))
    np.add.at(inside, (labels[known], classes[known]), 1)
    outside = inside.sum(1, keepdims=True) - inside
    return float(np.minimum(inside, outside).sum() / known.sum())


def boundary_length(labels: np.ndarray) -> float:
    """Share of horizontally or vertically neighbouring pixels in different segments."""
    across, down = labels[:, 1:] != labels[:, :-1], labels[1:] != labels[:-1]
    return float((across.sum() + down.sum()) / (across.size + down.size))


def measure(labels: np.ndarray, classes: np.ndarray) -> Quality:
    return Quality(
        len(np.unique(labels)),
        boundary_recall(labels, classes),
        undersegmentation(labels, classes),
        boundary_length(labels),
    )


def mean_quality(cut: Cut, pictures: Sequence[Picture]) -> Quality:
    each = [measure(cut(picture.image), picture.classes) for picture in pictures]
    return Quality(
        *(float(np.nanmean([asdict(one)[name] for one in each])) for name in asdict(each[0]))
    )


def our_cut(image: Tensor, segments: int, compactness: float) -> np.ndarray:
    return slic(image, segments, compactness).numpy()


def their_cut(image: Tensor, segments: int, compactness: float) -> np.ndarray:
    rows = np.ascontiguousarray(image.permute(1, 2, 0).numpy())
    return skimage.segmentation.slic(rows, segments, compactness=compactness, start_label=0)


def matching_number(
    compactness: float, segments: int, wanted: float, pictures: Sequence[Picture]
) -> int:
    """The least asked number, nearly, with which scikit-image returns ``wanted`` or more."""

    def too_few(asked: int) -> bool:
        cuts = (their_cut(picture.image, asked, compactness) for picture in pictures)
        return float(np.mean([len(np.unique(labels)) for labels in cuts])) < wanted

    low, high = 0, segments
    while too_few(high):
        low, high = high, 2 * high
    for _ in range(HALVINGS):
        middle = (low + high + 1) // 2
        low, high = (middle, high) if too_few(middle) else (low, middle)
    return high


def compare(pictures: Sequence[Picture], segments: int) -> list[Row]:
    """All rows: ours at the default and other settings, theirs as asked and matched."""
    default = mean_quality(lambda image: slic(image, segments).numpy(), pictures)
    own = signature(slic).parameters["compactness"].default
    rows = [Row("roadtorch", f"{own:g} (default)", segments, default)]
    for value in OUR_COMPACTNESS:
        cut = partial(our_cut, segments=segments, compactness=value)
        rows.append(Row("roadtorch", f"{value:g}", segments, mean_quality(cut, pictures)))
    for value in THEIR_COMPACTNESS:
        matched = matching_number(value, segments, default.segments, pictures)
        for name, asked in (("scikit-image", segments), ("scikit-image, matched", matched)):
            cut = partial(their_cut, segments=asked, compactness=value)
            rows.append(Row(name, f"{value:g}", asked, mean_quality(cut, pictures)))
    return rows


def table(rows: Sequence[Row]) -> str:
    """The rows as a Markdown table."""
    lines = [
        "| slic of | compactness | asked | segments | boundary recall | undersegmentation "
        "| boundary length |",
        "|---|---:|---:|---:|---:|---:|---:|",
    ]
    for row in rows:
        one = row.quality
        lines.append(
            f"| {row.method} | {row.compactness} | {row.asked} | {one.segments:.0f} "
            f"| {one.boundary_recall:.4f} | {one.undersegmentation:.4f} "
            f"| {one.boundary_length:.4f} |"
        )
    return "\n".join(lines)


def read_pictures(root: Path, every: int) -> list[Picture]:
    """Every how many-th picture of CamVid's development split."""
    dataset = open_dataset("camvid", root, "dev")
    return [
        Picture(dataset.read(item)[0], read_labels(item.label))  # read() checks both files
        for item in tqdm(dataset.items[::every], "reading", leave=False)
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("camvid", type=Path, help="the folder with train/, trainannot/, …")
    parser.add_argument("--every", type=int, default=6, help="use every how many-th picture")
    parser.add_argument("--segments", type=int, default=400)
    parser.add_argument("--json", type=Path, help="write the figures to this file")
    given = parser.parse_args()
    if min(given.every, given.segments) < 1:
        parser.error("give whole numbers from 1 up")
    try:
        pictures = read_pictures(given.camvid, given.every)
    except RoadtorchError as problem:
        parser.error(str(problem))
    rows = compare(pictures, given.segments)
    print(f"{len(pictures)} pictures of CamVid dev, {given.segments} segments asked for\n")
    print(table(rows))
    if given.json:
        figures = {"pictures": len(pictures), "rows": [asdict(row) for row in rows]}
        given.json.write_text(json.dumps(figures, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    torch.set_num_threads(1)
    main()
