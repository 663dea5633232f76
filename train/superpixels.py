"""A teacher of the scene layout that has never seen a street: boosted trees over superpixels.

P2 takes its labels from Hoiem, Efros and Hebert (IJCV 2007): boosted decision trees over colour,
texture, place, size and straight lines of regions, taught on another data set. Here the regions are
superpixels of two sizes, the trees scikit-learn's, and what teaches them rendered worlds, whose
truth the renderer knows.
"""

import pickle
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import torch
from sklearn.ensemble import HistGradientBoostingClassifier
from torch import Tensor

from roadtorch.imaging.color import color_planes
from roadtorch.imaging.resize import WorkingSize, resize_to_work, spatial_size
from roadtorch.imaging.segments import paint_segments, segment_mean, segment_size
from roadtorch.imaging.slic import Superpixels
from roadtorch.layout.classes import HORIZONTAL, NUM_CLASSES
from roadtorch.train.source import ROAD_CODE, find_source_images, read_truth, reduce_truth

COLOURS = ("R", "G", "B", "L", "a", "b", "S")
SCALES, ANGLES = (1.0, 2.5), 6
"""Standard deviations, in pixels, and orientations of the filters of texture."""

COARSE = 10
"""A coarse superpixel has as many pixels as this number of fine ones."""

MIN_LINE = 1 / 12
"""Least length of a straight line, fraction of the width."""

CERTAIN = 0.75
"""Fraction of a superpixel that is of one class, from which on it teaches the trees."""


def describe_pixels(image: Tensor) -> Tensor:
    """Return what regions are described by, planes (C, H, W) of an image (3, H, W) in [0, 1]."""
    colours = color_planes(image, COLOURS)
    lightness = np.ascontiguousarray(colours[COLOURS.index("L")].numpy())
    planes = [*colours, *colours[COLOURS.index("L") :].square()]
    for scale in SCALES:
        smooth = cv2.GaussianBlur(lightness, (0, 0), scale)
        across, down = (cv2.Sobel(smooth, cv2.CV_32F, *order) for order in ((1, 0), (0, 1)))
        for angle in np.arange(ANGLES) * np.pi / ANGLES:
            planes.append(torch.from_numpy(abs(np.cos(angle) * across + np.sin(angle) * down)))
        planes.append(torch.from_numpy(abs(lightness - smooth)))
    return torch.stack([*planes, *straight_lines(lightness), *positions(image)])


def straight_lines(lightness: np.ndarray) -> list[Tensor]:
    """Return where straight lines are, and their |cos| and |sin|, of a plane (H, W): three maps."""
    grey = cv2.normalize(lightness, np.zeros(()), 0, 255, cv2.NORM_MINMAX).astype(np.uint8)
    maps = [np.zeros(grey.shape, np.float32) for _ in range(3)]
    length = max(4, round(MIN_LINE * grey.shape[1]))
    lines = cv2.HoughLinesP(cv2.Canny(grey, 60, 120), 1, np.pi / 180, length, None, length, 3)
    for ends in [] if lines is None else lines.reshape(-1, 4):
        left, top, right, bottom = map(int, ends)
        angle = np.arctan2(bottom - top, right - left)
        for plane, value in zip(maps, (1.0, abs(np.cos(angle)), abs(np.sin(angle))), strict=True):
            cv2.line(plane, (left, top), (right, bottom), float(value), 3)
    return [torch.from_numpy(plane) for plane in maps]


def positions(image: Tensor) -> list[Tensor]:
    """Return row, its square, column and its distance from the middle, fractions: (H, W) each."""
    height, width = spatial_size(image)
    row = torch.linspace(0, 1, height)[:, None].expand(height, width)
    column = torch.linspace(0, 1, width).expand(height, width)
    return [row, row.square(), column, (column - 0.5).abs()]


def describe_superpixels(image: Tensor, superpixels: Superpixels) -> tuple[Tensor, np.ndarray]:
    """Cut an image (3, H, W) at working size: labels int64 (H, W) of n, features (n, 2C + 2).

    The features are means and the size of the superpixel, and of the coarse one at its middle.
    """
    planes, parts = describe_pixels(image), list[Tensor]()
    coarse = superpixels.model_copy(update={"pixels": COARSE * superpixels.pixels})
    fine = superpixels.cut(image)
    pixels = segment_size(fine, int(fine.max()) + 1)
    for labels in (fine, coarse.cut(image)):
        size = segment_size(labels, int(labels.max()) + 1)
        means = torch.cat([segment_mean(planes, labels, size), size[None] / labels.numel()])
        parts.append(segment_mean(paint_segments(means, labels), fine, pixels))
    return fine, torch.cat(parts).T.numpy()


def learn_trees(folders: Sequence[Path], file: Path, limit: int, superpixels: Superpixels) -> None:
    """Teach trees by at most ``limit`` source images, evenly spaced, and write them to a file."""
    images = find_source_images(folders)
    features, classes = list[np.ndarray](), list[np.ndarray]()
    for source in images[:: -(-len(images) // limit)]:
        small = resize_to_work(source.item.read(), WorkingSize())
        codes = reduce_truth(read_truth(source), spatial_size(small)).long()
        codes = codes.where(codes != ROAD_CODE, HORIZONTAL)
        labels, described = describe_superpixels(small, superpixels)
        shares = torch.stack([(codes == layout).float() for layout in range(NUM_CLASSES)])
        shares = segment_mean(shares, labels, segment_size(labels, len(described))).numpy()
        certain = shares.max(0) >= CERTAIN
        features.append(described[certain])
        classes.append(shares.argmax(0)[certain])
    trees = HistGradientBoostingClassifier(max_iter=200, class_weight="balanced", random_state=0)
    trees.fit(np.concatenate(features), np.concatenate(classes))
    file.write_bytes(pickle.dumps(trees))


class SuperpixelTeacher:
    """The trees of a file as a teacher."""

    def __init__(self, file: Path, superpixels: Superpixels) -> None:
        self._trees: HistGradientBoostingClassifier = pickle.loads(file.read_bytes())
        self._superpixels = superpixels

    def potentials(self, image: Tensor) -> Tensor:
        """Return the potentials (3, H, W) of an image (3, H, W) at working size; they sum to 1."""
        labels, features = describe_superpixels(image, self._superpixels)
        chances = torch.from_numpy(self._trees.predict_proba(features)).T.contiguous()
        return paint_segments(chances, labels)
