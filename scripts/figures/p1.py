"""P1, Tables I and II.

P1's own sets (After-Rain, Sunny-Shadows, Nanjing, Kitti-Layout) are not public any more or not
here: Table I is its protocol on CamVid, IDD and KITTI road, of which few images are taken so that
a command ends within minutes.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path

import torch
from torch import Tensor

from roadtorch.base.progress import Progress
from roadtorch.data.catalogue import open_dataset
from roadtorch.data.dataset import Truth, subsample_dataset
from roadtorch.data.kitti_road import use_birds_eye_view
from roadtorch.detectors.catalogue import load_detector
from roadtorch.evaluation.evaluate import evaluate
from roadtorch.evaluation.measures import ROAD_MEASURES
from roadtorch.evaluation.metrics import ConfusionCounts, count_mask, f_measure, precision, recall
from roadtorch.ufl.preprocess import WorkingShape, resize_bicubic
from scripts.figures.chart import show_table

SETS = {"camvid": ("camvid", 18), "idd-lite": ("idd_lite", 10), "kitti-road": ("kitti_road", 5)}
"""By name of the set: its folder in the data, and how many of its images are taken."""

TABLE = ("vanishing-point", "kmeans-road", "ufl:paper", "ufl:original", "ufl", "prior:triangle")
"""The three of Table I in its order, its own as text and as program, our best, a blind baseline."""

TABLE2 = tuple(measure for measure in ROAD_MEASURES if measure.key in ("maxf", "ap"))

BENCHMARK = (
    *("ufl:paper", "ufl:original", "ufl", "fusion:paper"),
    *("kmeans-road", "vanishing-point"),
)
"""Table II: P1, Xia et al., Kong et al.; its "CN [17]" is P2."""


def resize_as_p1(image: Tensor, truth: Truth) -> tuple[Tensor, Truth]:
    """Bring an image (3, H, W) and its truth to the size at which P1 works and scores.

    160x120 for images of 4:3, 397x120 for KITTI's; the label by its nearest pixel, where the
    authors' program calls road whatever a bicubic label leaves above 0.
    """
    height, width = image.shape[-2:]
    rows, columns = WorkingShape().size(height, width)
    down = (2 * torch.arange(rows)[:, None] + 1) * height // (2 * rows)
    right = (2 * torch.arange(columns) + 1) * width // (2 * columns)
    reduced = Truth(truth.road[down, right], truth.valid[down, right])
    return resize_bicubic(image, (rows, columns)), reduced


def pooled_counts(
    images: Sequence[tuple[Tensor, Truth]], detectors: Sequence[str]
) -> Mapping[str, ConfusionCounts]:
    """Count each detector's masks, pooled over images and their truth (P1, eq. 11)."""
    counts: dict[str, ConfusionCounts] = {}
    for name in detectors:
        detector = load_detector(name)
        for image, truth in Progress(images, desc=name, unit="image"):
            of_image = count_mask(detector.detect(image).mask, truth.road, truth.valid)
            counts[name] = counts[name] + of_image if name in counts else of_image
    return counts


def table1(data: Path, out: Path) -> None:
    """Write P1's Table I: pooled P, R and F (eq. 11) of P1, two methods and a baseline."""
    rows = []
    for set_name, (folder, count) in SETS.items():
        dataset = subsample_dataset(open_dataset(set_name, data / folder), count)
        images = [resize_as_p1(*dataset.read(item)) for item in dataset.items]
        for name, counts in pooled_counts(images, TABLE).items():
            figures = {"P": precision(counts), "R": recall(counts), "F": f_measure(counts)}
            percents = {key: f"{100 * float(value):.2f}" for key, value in figures.items()}
            rows.append({"set": dataset.name, "images": len(images), "method": name, **percents})
    show_table(out / "p1-table1.csv", rows)


def table2(data: Path, out: Path) -> None:
    """Write P1's Table II: MaxF and AP in bird's-eye view (evaluate kitti-road --bev)."""
    dataset = use_birds_eye_view(open_dataset("kitti-road", data / "kitti_road"))
    evaluation = evaluate(dataset, BENCHMARK, quiet=False)
    for failure in evaluation.failures:
        print(f"left out: {failure.image}: {failure.reason}")
    rows = []
    for name in evaluation.ranking():
        figures, row = evaluation.detectors[name], {"method": name}
        for group, part in (*sorted(figures.groups.items()), ("total", figures.pooled)):
            for measure in TABLE2:
                row[f"{group} {measure.name}"] = f"{100 * measure.get(part):.2f}"
        rows.append(row)
    show_table(out / "p1-table2.csv", rows)
