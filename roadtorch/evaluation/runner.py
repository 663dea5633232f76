"""The pass: every detector over every picture once, picture by picture."""

import multiprocessing
import pickle
import statistics
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from typing import Any, TypeVar

import torch
from torch import Tensor

from roadtorch.detectors import Detection, load_detector
from roadtorch.errors import RoadtorchError
from roadtorch.evaluation import metrics
from roadtorch.evaluation.datasets import Dataset, Item, Truth
from roadtorch.evaluation.floors import MEAN, resize
from roadtorch.evaluation.metrics import Decisions, RoadCounts

WHOLE = "all"  # the one group of a set that knows no drives
MEAN_THRESHOLD = 0.5  # road at this place in at least half of the pictures

Counts = TypeVar("Counts", RoadCounts, Decisions, Tensor)
Look = Callable[[Tensor, Item], Detection]


@dataclass(frozen=True)
class Plan:
    """What to run: a set, detectors by name with their settings, the mean masks by drive."""

    dataset: Dataset
    detectors: Mapping[str, Mapping[str, Any]]
    mean_masks: Mapping[str, Tensor] = field(default_factory=dict)


@dataclass(frozen=True)
class Score:
    """One detector's counts on one picture."""

    road: RoadCounts
    mask: Decisions
    layout: Tensor | None  # confusion (4,4) of the strongest potentials
    labels: Tensor | None  # confusion (4,4) of labels that may abstain
    seconds: float  # for detect alone


@dataclass(frozen=True)
class Result:
    """What came of one picture: a score for every detector, or why there is none."""

    item: Item
    scores: Mapping[str, Score]
    failure: str = ""


@dataclass(frozen=True)
class ImageRow:
    """What is kept of each picture for distributions and intervals."""

    name: str
    group: str
    road: RoadCounts  # 256 levels, as the 8-bit map has
    auc: float
    max_f: float
    mask: Decisions
    seconds: float


@dataclass
class Tally:
    """One detector's counts so far, by drive, and a row for each picture."""

    road: dict[str, RoadCounts] = field(default_factory=dict)
    mask: dict[str, Decisions] = field(default_factory=dict)
    layout: dict[str, Tensor] = field(default_factory=dict)
    labels: dict[str, Tensor] = field(default_factory=dict)
    rows: list[ImageRow] = field(default_factory=list)

    def add(self, item: Item, score: Score) -> None:
        """Count one more picture."""
        group = item.group or WHOLE
        _add(self.road, group, score.road)
        _add(self.mask, group, score.mask)
        if score.layout is not None:
            _add(self.layout, group, score.layout)
        if score.labels is not None:
            _add(self.labels, group, score.labels)
        self.rows.append(_row(item, group, score))

    def milliseconds(self, group: str | None = None) -> float:
        """The median time of detect, over one drive or all pictures."""
        kept = [row.seconds for row in self.rows if group in (None, row.group)]
        return 1000 * statistics.median(kept)


def _add(sums: dict[str, Counts], group: str, part: Counts) -> None:
    sums[group] = sums[group] + part if group in sums else part


def _row(item: Item, group: str, score: Score) -> ImageRow:
    coarse = metrics.coarsen(score.road)
    return ImageRow(
        item.name,
        group,
        RoadCounts(coarse.road.to(torch.int32), coarse.other.to(torch.int32)),
        float(metrics.auc(score.road)),
        float(metrics.max_f(score.road)[0]),
        score.mask,
        score.seconds,
    )


def every_kth(dataset: Dataset, limit: int | None) -> Dataset:
    """At most ``limit`` items of a set, spread evenly over it."""
    if limit is None or limit >= len(dataset.items):
        return dataset
    step = len(dataset.items) / limit
    chosen = tuple(dataset.items[int(index * step)] for index in range(limit))
    return Dataset(dataset.name, dataset.root, dataset.split, chosen, dataset.coding)


# --- looking ----------------------------------------------------------------------------


def looks(plan: Plan) -> dict[str, Look]:
    """The detectors of a plan, ready to look; ``prior:mean`` among them if it has masks."""
    found = {name: _look(name, settings) for name, settings in plan.detectors.items()}
    if plan.mean_masks:
        found[MEAN] = lambda image, item: mean_detection(image, item, plan.mean_masks)
    return found


def _look(name: str, settings: Mapping[str, Any]) -> Look:
    detector = load_detector(name, **settings)
    return lambda image, item: detector.detect(image)


def mean_detection(image: Tensor, item: Item, masks: Mapping[str, Tensor]) -> Detection:
    """The floor ``prior:mean``: what the mask of the item's drive says, at the image's size."""
    mask = masks[item.group or ""]
    likelihood = resize(mask, image.shape[1:]).to(torch.float32).clamp(0, 1)
    return Detection(likelihood, likelihood >= MEAN_THRESHOLD, {})


def score_image(look: Look, image: Tensor, item: Item, truth: Truth) -> Score:
    """Run one detector on one image and count."""
    start = time.perf_counter()
    detection = look(image, item)
    seconds = time.perf_counter() - start
    layout, labels = detection.cues.get("layout"), detection.cues.get("layout_labels")
    return Score(
        metrics.count_levels(detection.likelihood, truth.road, truth.valid),
        metrics.count_mask(detection.mask, truth.road, truth.valid),
        None if layout is None else _count_layout(layout.argmax(0), truth),
        None if labels is None else _count_layout(labels, truth),
        seconds,
    )


def _count_layout(labels: Tensor, truth: Truth) -> Tensor | None:
    return None if truth.layout is None else metrics.count_layout(labels, truth.layout)


def score_item(plan: Plan, found: Mapping[str, Look], item: Item) -> Result:
    """Read one item once and score every detector on it.

    Whatever goes wrong becomes the result's failure, and the picture then counts for no
    detector, so that all are scored on the same pictures.
    """
    who = ""
    try:
        image, truth = plan.dataset.read(item)
        scores = {}
        for who, look in found.items():
            scores[who] = score_image(look, image, item, truth)
        return Result(item, scores)
    except RoadtorchError as problem:
        return Result(item, {}, f"{who}: {problem}" if who else str(problem))
    except Exception as problem:  # a detector's own mistake must not end a long run
        return Result(item, {}, f"{who or item.name}: {type(problem).__name__}: {problem}")


# --- one process or several -------------------------------------------------------------


def run(plan: Plan, jobs: int = 1) -> Iterator[Result]:
    """Yield a result for every item, in the set's order, whatever ``jobs`` is.

    With several processes each runs with this process's number of threads, so that the
    results are the same to the bit.
    """
    items = plan.dataset.items
    if jobs == 1:
        found = looks(plan)
        yield from (score_item(plan, found, item) for item in items)
        return
    looks(plan)  # mistakes in names and settings show here, before processes start
    context = multiprocessing.get_context("spawn")
    # Bytes, because torch would share tensors between processes through sockets.
    message = pickle.dumps((plan, torch.get_num_threads()))
    with ProcessPoolExecutor(jobs, context, _prepare, (message,)) as pool:
        yield from map(pickle.loads, pool.map(_score_one, range(len(items))))


_prepared: list[Callable[[int], Result]] = []  # a worker process's own plan, set once


def _prepare(message: bytes) -> None:
    plan, threads = pickle.loads(message)
    torch.set_num_threads(threads)
    found = looks(plan)
    _prepared.append(lambda index: score_item(plan, found, plan.dataset.items[index]))


def _score_one(index: int) -> bytes:
    return pickle.dumps(_prepared[0](index))
