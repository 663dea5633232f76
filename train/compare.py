"""Compare weights with those that ship, image by image: one table, differences with intervals.

    python -m train.compare DATA --worlds HELD… --cache DIR NAME=WEIGHTS…
    python -m train.compare DATA NAME=… --cache DIR --large --sets many camvid idd
    python -m train.compare DATA --cache DIR --keep    # docs/figures/street.json

WEIGHTS is a file or a shipped name; --large compares `fusion:large`. --keep records figures of what
ships instead. DATA holds many/, camvid/ and idd_lite/; HELD is a folder of ``train.worlds`` that
nothing learned from.
Cached, so that it goes on where it was. An interval is of the difference, with 1,000 draws of
images within their cameras or kinds.
"""

import argparse
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from itertools import chain
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor
from tqdm import tqdm

from roadtorch import load_detector
from roadtorch.data.catalogue import open_dataset
from roadtorch.data.dataset import Truth
from roadtorch.detectors.detector import Detector
from roadtorch.evaluation.metrics import RoadCounts, count_levels, max_f
from roadtorch.evaluation.uncertainty import percentile_interval, sample_weights
from roadtorch.layout.classes import VERTICAL
from roadtorch.run.memo import cache_key, read_cached, write_cached
from scripts.readme_figures import keep_records
from train.calibrate import EXCLUDED
from train.worlds.reader import read_world
from train.worlds.truth import VOID

SHIPPED = "ships=backbone-free"

LEFT_HAND = ("dn_idd", "dn_makassar")
RIGHT_HAND = ("cityscapes", "dn_cityscapes", "kitti_semantics", "dn_mapillary")
"""Cameras in traffic on that side, whose halves are compared."""

MIN_OBSTACLES = 200
"""Pixels of obstacles below which a camera has no figure."""

STEPS = {"camvid": 3, "idd": 2}
"""Every so many images of a set are compared; all of the others."""

LEVELS, SEED = 256, 11

LEFT, RIGHT, TAKEN = slice(0, 3), slice(3, 6), slice(6, 8)
"""Columns of counts: hits, false and missed road of the left half, of the right half; pixels of
obstacles taken for road, and all of them."""


class Sample(NamedTuple):
    """A labelled image: its camera or kind, its conditions, and a reader of image and truth."""

    camera: str
    conditions: tuple[str, ...]
    read: Callable[[], tuple[Tensor, Truth]]


class Records(NamedTuple):
    """Counts of n images: cameras (n,), conditions, counts (n, 8), likelihoods (n, 2, levels)."""

    cameras: np.ndarray
    conditions: list[tuple[str, ...]]
    counts: Tensor
    levels: Tensor


Score = Callable[[Records, Tensor], Tensor]
"""Score (draws,) of records, of weights (draws, n) of their images."""


def world_kind(name: str) -> str:
    """Return the tens of thousands, the kind and "night" of a world, of NUMBER_KIND_LIGHT."""
    number, kind, light = name.split("_")[:3]
    return f"{number[0]} {kind}" + " night" * (light == "night")


def obstacle_mask(road: Tensor, vertical: Tensor) -> Tensor:
    """Return where something vertical has road above and below it in its column, bool (H, W)."""
    above, below = road.cumsum(0) > 0, road.flip(0).cumsum(0).flip(0) > 0
    return vertical & above & below


# --- counting ---------------------------------------------------------------------------


def read_labelled(name: str, root: Path) -> Iterator[Sample]:
    """Yield the labelled images of many/, CamVid or IDD."""
    formats = {
        "many": ("folder", "many"),
        "camvid": ("camvid", "camvid"),
        "idd": ("idd-lite", "idd_lite"),
    }
    kind, folder = formats[name]
    dataset = open_dataset(kind, root / folder)
    for item in dataset.items[:: STEPS.get(name, 1)]:
        if item.group not in EXCLUDED:
            yield Sample(item.group or name, item.conditions, partial(dataset.read, item))


def read_worlds(roots: list[Path]) -> Iterator[Sample]:
    """Yield worlds, whose kinds are the cameras."""
    for file in chain(*(sorted((root / "images").glob("*.jpg")) for root in roots)):
        yield Sample(world_kind(file.stem), (), partial(read_world, file))


def count_image(sample: Sample, detector: Detector) -> tuple[Tensor, Tensor]:
    """Return the counts (8,) and the likelihoods (2, levels) of an image's true pixels."""
    image, truth = sample.read()
    detection = detector.detect(image)
    mask, valid, road = detection.mask, truth.valid, truth.road & truth.valid
    parts = torch.stack([mask & road, mask & valid & ~road, ~mask & road])
    halves = [half.sum((1, 2)) for half in parts.tensor_split(2, 2)]
    layout = (
        torch.full_like(road, VOID, dtype=torch.uint8) if truth.layout is None else truth.layout
    )
    obstacle = obstacle_mask(road, layout == VERTICAL)
    overlap = torch.stack([(mask & obstacle).sum(), obstacle.sum()])
    levels = count_levels(detection.likelihood, truth.road, valid, LEVELS)
    return torch.cat([*halves, overlap]), torch.stack([levels.road, levels.background])


def record(name: str, detector: Detector, options: argparse.Namespace) -> Records:
    """Count all images of a set, or read their counts from the cache."""
    samples = read_worlds(options.worlds) if name == "worlds" else read_labelled(name, options.data)
    key = cache_key(detector, name, *(options.worlds if name == "worlds" else []), STEPS)
    file = options.cache / f"{name}-{key}.npz"
    cached = read_cached(file, key)
    cameras, conditions, counts, levels = [], [], [], []
    for sample in tqdm(samples, desc=name, disable=None, leave=False):
        cameras.append(sample.camera)
        conditions.append(sample.conditions)
        if cached is None:
            row = count_image(sample, detector)
            counts.append(row[0])
            levels.append(row[1])
    if cached is None:
        cached = {"counts": torch.stack(counts), "levels": torch.stack(levels)}
        write_cached(file, key, cached)
    return Records(np.array(cameras), conditions, cached["counts"], cached["levels"])


# --- scores -----------------------------------------------------------------------------


def draw_weights(cameras: np.ndarray) -> Tensor:
    """Draw how often each image counts, float64 (draws, n): the first row is all ones."""
    return sample_weights(cameras.tolist(), torch.Generator().manual_seed(SEED))


def pool(records: Records, weights: Tensor, members: np.ndarray) -> Tensor:
    """Sum the counts (draws, 8) of some images."""
    rows = torch.from_numpy(members.nonzero()[0])
    return weights[:, rows] @ records.counts[rows].double()


def f_of(counts: Tensor) -> Tensor:
    """Compute F (draws,) of counts (draws, 8)."""
    hits, false, missed = (counts[:, LEFT] + counts[:, RIGHT]).unbind(1)
    return 2 * hits / (2 * hits + false + missed).clamp_min(1)


def camera_f(camera: str) -> Score:
    """Return the score F of a camera."""
    return lambda records, weights: f_of(pool(records, weights, records.cameras == camera))


def cameras_with_road(records: Records) -> list[str]:
    """Return the cameras, or kinds, whose images show road."""
    ones, names = torch.ones(1, len(records.cameras)).double(), np.unique(records.cameras)
    hits_and_missed = [
        pool(records, ones, records.cameras == name)[:, [0, 2, 3, 5]] for name in names
    ]
    return [str(name) for name, road in zip(names, hits_and_missed, strict=True) if road.any()]


def mean_f(records: Records, weights: Tensor) -> Tensor:
    """Compute the mean of F over the cameras."""
    cameras = cameras_with_road(records)
    return torch.stack([camera_f(name)(records, weights) for name in cameras]).mean(0)


def worst_f(records: Records, weights: Tensor) -> Tensor:
    """Compute the least F of a camera."""
    cameras = cameras_with_road(records)
    return torch.stack([camera_f(name)(records, weights) for name in cameras]).amin(0)


def mean_max_f(records: Records, weights: Tensor) -> Tensor:
    """Compute the mean of MaxF over the cameras, each at its best threshold."""
    best = []
    for camera in cameras_with_road(records):
        rows = torch.from_numpy((records.cameras == camera).nonzero()[0])
        levels = torch.einsum("dn,nkl->kdl", weights[:, rows], records.levels[rows].double())
        best.append(max_f(RoadCounts(*levels.round().long()))[0])
    return torch.stack(best).mean(0)


def condition_f(condition: str) -> Score:
    """Return the score F of the images of a condition, pooled."""

    def score(records: Records, weights: Tensor) -> Tensor:
        members = np.array([condition in words for words in records.conditions])
        return f_of(pool(records, weights, members))

    return score


def half_errors(camera: str, half: slice, error: int) -> Score:
    """Return false (1) or missed (2) road of a camera's half, as a fraction of its true road."""

    def score(records: Records, weights: Tensor) -> Tensor:
        counts = pool(records, weights, records.cameras == camera)
        road = counts[:, [0, 2, 3, 5]].sum(1)
        return counts[:, half][:, error] / road.clamp_min(1)

    return score


def wrong_halves(camera: str) -> Score:
    """Return road missed beyond the oncoming lane and false road on the near side, summed."""
    sides = [(LEFT, 1), (RIGHT, 2)] if camera in LEFT_HAND else [(LEFT, 2), (RIGHT, 1)]
    parts = [half_errors(camera, *side) for side in sides]
    return lambda records, weights: parts[0](records, weights) + parts[1](records, weights)


def mean_wrong_halves(records: Records, weights: Tensor) -> Tensor:
    """Compute the mean of the wrong halves over the cameras of which the side is known."""
    cameras = [name for name in LEFT_HAND + RIGHT_HAND if name in records.cameras]
    return torch.stack([wrong_halves(name)(records, weights) for name in cameras]).mean(0)


def obstacles_taken(records: Records, weights: Tensor, cameras: Sequence[str] = ()) -> Tensor:
    """Compute how much of what stands before road is called road, as mean over cameras (or all)."""
    parts = []
    for camera in cameras or np.unique(records.cameras):
        hits, total = pool(records, weights, records.cameras == camera)[:, TAKEN].unbind(1)
        if total[0] > MIN_OBSTACLES:
            parts.append(hits / total.clamp_min(1))
    return torch.stack(parts).mean(0) if parts else torch.full((len(weights),), torch.nan)


def scores_of(name: str, records: Records) -> Mapping[str, Score]:
    """Return the scores of a set, by name."""
    scores: dict[str, Score] = {"F": mean_f, "worst": worst_f, "MaxF": mean_max_f}
    if name in ("many", "worlds"):
        scores["stands before road"] = obstacles_taken
    if name == "many":
        scores["wrong halves"] = mean_wrong_halves
        for camera in LEFT_HAND + RIGHT_HAND:
            scores[f"wrong halves {camera}"] = wrong_halves(camera)
            for side, half in (("left", LEFT), ("right", RIGHT)):
                scores[f"{camera} false {side}"] = half_errors(camera, half, 1)
                scores[f"{camera} missed {side}"] = half_errors(camera, half, 2)
    for condition in sorted(set(chain(*records.conditions))):
        scores[f"F {condition}"] = condition_f(condition)
    return scores | {f"F {camera}": camera_f(camera) for camera in cameras_with_road(records)}


# --- table ------------------------------------------------------------------------------


def load_candidate(text: str, is_large: bool) -> tuple[str, Detector]:
    """Load the detector of NAME=WEIGHTS."""
    name, _, file = text.partition("=")
    return name, load_detector("fusion:large" if is_large else "fusion", weights={"file": file})


def print_table(name: str, records: Mapping[str, Records]) -> None:
    """Print the scores of a set: what ships, then each candidate's and its difference."""
    first, *candidates = records
    weights = draw_weights(records[first].cameras)
    print(f"\n| {name} | {' | '.join(records)} |\n|---|{'---|' * len(records)}")
    for label, score in scores_of(name, records[first]).items():
        draws = weights[:1] if score is mean_max_f else weights
        base = score(records[first], draws)
        cells = [f"{float(base[0]):.4f}"]
        for candidate in candidates:
            values = score(records[candidate], draws)
            cell = f"{float(values[0]):.4f} {float(values[0] - base[0]):+.4f}"
            if len(draws) > 1:
                low, high = percentile_interval(values[1:] - base[1:])
                cell += f" ({low:+.4f} to {high:+.4f})"
            cells.append(cell)
        print(f"| {label} | {' | '.join(cells)} |", flush=True)


def keep_shipped(options: argparse.Namespace) -> None:
    """Record wrong halves and what stands before road called road of what ships, with intervals."""
    scores: dict[str, Score] = {"halves": mean_wrong_halves, "obstacles": obstacles_taken}
    for camera in LEFT_HAND + RIGHT_HAND:
        scores[f"halves@{camera}"] = wrong_halves(camera)
        scores[f"obstacles@{camera}"] = partial(obstacles_taken, cameras=[camera])
    values = dict[str, float]()
    for name in ("fusion", "fusion:large"):
        records = record("many", load_candidate(SHIPPED, name != "fusion")[1], options)
        weights = draw_weights(records.cameras)
        for label, score in scores.items():
            key, draws = f"street.{name}.{label}", score(records, weights)
            ends = zip((".low", ".high"), percentile_interval(draws[1:]), strict=True)
            values |= {key: float(draws[0]), **{key + end: float(value) for end, value in ends}}
    keep_records("street", "python -m train.compare DATA --cache OUT --keep", values)


def main() -> None:
    """Print a table for each set."""
    parser = argparse.ArgumentParser(description="Compare weights with those that ship.")
    parser.add_argument("data", type=Path)
    parser.add_argument("candidates", nargs="*", metavar="NAME=FIRST[+SECOND]")
    parser.add_argument("--worlds", type=Path, nargs="*", default=[])
    parser.add_argument("--cache", type=Path, required=True)
    parser.add_argument("--sets", nargs="*", default=[])
    parser.add_argument("--large", action="store_true")
    parser.add_argument("--keep", action="store_true")
    options = parser.parse_intermixed_args()
    torch.set_num_threads(1)
    if options.keep:
        return keep_shipped(options)
    detectors = [load_candidate(text, options.large) for text in (SHIPPED, *options.candidates)]
    for name in options.sets or (["many", "worlds"] if options.worlds else ["many"]):
        records = {title: record(name, detector, options) for title, detector in detectors}
        print_table(name, records)


if __name__ == "__main__":
    main()
