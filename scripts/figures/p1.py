"""P1, Tables I and II.

P1's own sets (After-Rain, Sunny-Shadows, Nanjing, Kitti-Layout) are not public any more or not
here: Table I is its protocol on CamVid, IDD and KITTI road.
"""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from roadtorch.data.catalogue import open_dataset
from roadtorch.data.dataset import Dataset, LabelledItem, Truth, subsample_dataset
from roadtorch.data.kitti_road import use_birds_eye_view
from roadtorch.evaluation.evaluate import evaluate
from roadtorch.evaluation.measure import Measure
from roadtorch.evaluation.measures import F_MASK, ROAD_MEASURES
from roadtorch.evaluation.methods import contender_from_name
from roadtorch.evaluation.metrics import ConfusionCounts, f_measure, precision, recall
from roadtorch.evaluation.tally import Tally
from roadtorch.evaluation.uncertainty import percentile_interval
from roadtorch.ufl.preprocess import WorkingShape, resize_bicubic
from scripts.figures.chart import show_table
from scripts.figures.counting import count_images, replicate

SETS = {"camvid": "camvid", "idd-lite": "idd_lite", "kitti-road": "kitti_road"}
"""By name of the set: its folder in the data."""

TABLE1_IMAGES = {"idd-lite": 50}
"""How many images of a set Table I takes, evenly spread; of the others all."""

TABLE = ("vanishing-point", "kmeans-road", "ufl:paper", "ufl:original", "ufl", "prior:triangle")
"""The three of Table I in its order, its own as text and as program, our best, a blind baseline."""

TABLE2 = tuple(measure for measure in ROAD_MEASURES if measure.key in ("maxf", "ap"))

BENCHMARK = (
    *("ufl:paper", "ufl:original", "ufl", "fusion:paper", "cpf"),
    *("illuminant-invariant", "oneclass:gaussian:nrng", "kmeans-road", "vanishing-point"),
)
"""Table II: P1, P2 (its "CN [17]") with its texture alone, Álvarez and López 2011 and P3, which P1
cites, Xia et al., Kong et al."""

KITTI_BLUR = {"smoothing": {"sigma": 2.5}}
"""All that P1 changes for Table II, in its two faithful variants."""


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


class SmallDataset(Dataset):
    """A data set whose images and truth have the size at which P1 works and scores."""

    def read(self, item: LabelledItem) -> tuple[Tensor, Truth]:
        """Read the image, shape (3, 120, W), and the ground truth of one item."""
        return resize_as_p1(*super().read(item))


LEVELS = 256  # of likelihoods: masks alone are scored, and counts stay small


def open_small(data: Path, name: str, count: int | None = None) -> SmallDataset:
    """Open a set of ``SETS`` at P1's size, with at most so many images, evenly spread."""
    dataset = subsample_dataset(open_dataset(name, data / SETS[name]), count)
    return SmallDataset(**vars(replace(dataset, levels=LEVELS)))


def pooled_replicates(tally: Tally, measure: Measure) -> Tensor:
    """Return a score of pooled pixels in each draw of drives and images, (replicates,)."""
    values = measure.formula(replicate(tally).pooled)
    assert isinstance(values, Tensor)
    return values


Variant = tuple[str, Mapping[str, Any]]
"""Name of a detector and settings of it."""


def score_variants(dataset: Dataset, variants: Mapping[str, Variant]) -> list[dict[str, object]]:
    """Return P, R and F of masks, pooled over images (P1, eq. 11), F with its 95 % interval.

    "less" is F less that of the first variant, on the same draws.
    """
    contenders = [
        replace(contender_from_name(*variant), name=title) for title, variant in variants.items()
    ]
    tallies = count_images(dataset, contenders)
    counts = {
        title: ConfusionCounts(*tally.table().outcomes.sum(0)) for title, tally in tallies.items()
    }
    replicates = {title: pooled_replicates(tally, F_MASK) for title, tally in tallies.items()}
    first, rows = next(iter(variants)), []
    for title, outcome in counts.items():
        low, high = percentile_interval(replicates[title])
        figures = {"P": precision(outcome), "R": recall(outcome), "F": f_measure(outcome)}
        figures |= {"low": low, "high": high, "less": figures["F"] - f_measure(counts[first])}
        low, high = percentile_interval(replicates[title] - replicates[first])
        figures |= {"less, low": low, "less, high": high}
        row = {"set": dataset.name, "images": len(dataset.items), "method": title}
        rows.append(row | {key: f"{100 * float(value):.2f}" for key, value in figures.items()})
    return rows


def table1(data: Path, out: Path) -> None:
    """Write P1's Table I: pooled P, R and F (eq. 11) of P1, two methods and a baseline.

    On all images of CamVid and KITTI and every fifth of IDD: eight minutes.
    """
    variants = {method: (method, {}) for method in TABLE}
    sets = [open_small(data, name, TABLE1_IMAGES.get(name)) for name in SETS]
    rows = [row for dataset in sets for row in score_variants(dataset, variants)]
    show_table(out / "p1-table1.csv", rows)


def table2(data: Path, out: Path) -> None:
    """Write P1's Table II: MaxF and AP in bird's-eye view (evaluate kitti-road --bev)."""
    dataset = use_birds_eye_view(open_dataset("kitti-road", data / "kitti_road"))
    changes = {name: KITTI_BLUR for name in ("ufl:paper", "ufl:original")}
    contenders = [contender_from_name(name, changes.get(name, {})) for name in BENCHMARK]
    evaluation = evaluate(dataset, contenders, quiet=False)
    for failure in evaluation.failures:
        print(f"left out: {failure.image}: {failure.reason}")
    rows = []
    for name in evaluation.ranking():
        figures, row = evaluation.detectors[name], {"method": name}
        for group, part in (*sorted(figures.groups.items()), ("total", figures.pooled)):
            for measure in TABLE2:
                row[f"{group} {measure.name}"] = f"{100 * measure.get(part):.2f}"
        for measure in TABLE2:
            draws = pooled_replicates(evaluation.tallies[name], measure)
            low, high = percentile_interval(draws)
            row[f"total {measure.name}, 95 %"] = f"{100 * low:.1f} to {100 * high:.1f}"
        rows.append(row)
    show_table(out / "p1-table2.csv", rows)
