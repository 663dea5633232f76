"""The pass: every detector over every picture once, picture by picture."""

import multiprocessing
import pickle
import time
from collections.abc import Callable, Collection, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePath
from typing import Any

import torch
from torch import Tensor

from roadtorch.data import maps
from roadtorch.data.dataset import Dataset, Item, Truth
from roadtorch.detector import Detection
from roadtorch.detectors.catalogue import load_detector
from roadtorch.errors import RoadtorchError
from roadtorch.evaluation import boundary, metrics
from roadtorch.evaluation.floors import MEAN, resize
from roadtorch.evaluation.tally import Score
from roadtorch.image_cache import ImageCache, image_cache

MEAN_THRESHOLD = 0.5  # road at this place in at least half of the pictures

Look = Callable[[Tensor, Item], Detection]


@dataclass(frozen=True)
class Plan:
    """What to run: a set and, by name, detectors with their settings and folders of maps.

    mean_masks: by drive, the masks of the floor ``prior:mean``; without any it stays out.
    """

    dataset: Dataset
    detectors: Mapping[str, Mapping[str, Any]]
    mean_masks: Mapping[str, Tensor] = field(default_factory=dict)
    maps: Mapping[str, Path] = field(default_factory=dict)


@dataclass(frozen=True)
class Result:
    """What came of one picture: a score for every detector, or why there is none."""

    item: Item
    scores: Mapping[str, Score]
    failure: str = ""


def every_kth(dataset: Dataset, limit: int | None) -> Dataset:
    """At most ``limit`` items of a set, spread evenly over it."""
    if limit is None or limit >= len(dataset.items):
        return dataset
    step = len(dataset.items) / limit
    return replace(dataset, items=tuple(dataset.items[int(index * step)] for index in range(limit)))


# --- looking ----------------------------------------------------------------------------


def looks(plan: Plan) -> dict[str, Look]:
    """The detectors of a plan, ready to look; ``prior:mean`` among them if it has masks."""
    found = {name: _look(name, settings) for name, settings in plan.detectors.items()}
    found |= {name: _map_look(folder, plan.dataset) for name, folder in plan.maps.items()}
    if plan.mean_masks:
        found[MEAN] = lambda image, item: mean_detection(image, item, plan.mean_masks)
    return found


def _look(name: str, settings: Mapping[str, Any]) -> Look:
    detector = load_detector(name, **settings)
    return lambda image, item: detector.detect(image)


def _map_look(folder: Path, dataset: Dataset) -> Look:
    def look(image: Tensor, item: Item) -> Detection:
        own = (image.shape[-2], image.shape[-1])
        # What infer makes is named like the picture, what KITTI's server takes like the label.
        like_picture = str(PurePath(item.name).with_name(item.image.stem))
        names = list(dict.fromkeys([item.name, like_picture, item.label.stem]))
        likelihood = maps.map_likelihood(folder, names, [own, *_view_size(dataset, item, own)])
        return Detection(likelihood, likelihood >= maps.THRESHOLD, {})

    return look


def _view_size(dataset: Dataset, item: Item, size: tuple[int, int]) -> list[tuple[int, int]]:
    if dataset.view is None:
        return []
    height, width = dataset.view(item, torch.zeros(size)).shape
    return [(height, width)]


def mean_detection(image: Tensor, item: Item, masks: Mapping[str, Tensor]) -> Detection:
    """The floor ``prior:mean``: what the mask of the item's drive says, at the image's size."""
    mask = masks[item.group or ""]
    likelihood = resize(mask, image.shape[1:]).to(torch.float32).clamp(0, 1)
    return Detection(likelihood, likelihood >= MEAN_THRESHOLD, {})


# --- scoring ----------------------------------------------------------------------------


@dataclass(frozen=True)
class Scene:
    """One item as it is scored: its picture, and the truth where it is scored."""

    dataset: Dataset
    item: Item
    image: Tensor
    truth: Truth

    def seen(self, values: Tensor) -> Tensor:
        """A map (…,H,W) of the picture's size in the space of the truth."""
        view = self.dataset.view
        in_picture = values.shape[-2:] == self.image.shape[-2:]
        return view(self.item, values) if view is not None and in_picture else values


def read_scene(dataset: Dataset, item: Item) -> Scene:
    """Read one item; RoadtorchError when its files are missing, damaged or do not fit."""
    image, truth = dataset.read(item)
    scene = Scene(dataset, item, image, truth)
    return replace(scene, truth=seen_truth(scene))


def seen_truth(scene: Scene) -> Truth:
    """The truth of a scene in the space in which it is scored."""
    truth = scene.truth
    layout = None if truth.layout is None else scene.seen(truth.layout)
    return Truth(scene.seen(truth.road), scene.seen(truth.valid), layout)


def score_scene(look: Look, scene: Scene, shared: ImageCache) -> Score:
    """Run one detector on one picture and count."""
    truth, saved = scene.truth, shared.saved
    start = time.perf_counter()
    detection = look(scene.image, scene.item)
    # What others had made before it counts as this one's work, too.
    seconds = time.perf_counter() - start + shared.saved - saved
    likelihood, mask = scene.seen(detection.likelihood), scene.seen(detection.mask)
    layout, labels = detection.cues.get("layout"), detection.cues.get("layout_labels")
    return Score(
        metrics.count_levels(likelihood, truth.road, truth.valid, scene.dataset.levels),
        metrics.count_mask(mask, truth.road, truth.valid),
        boundary.count_boundary(mask, truth.road, truth.valid),
        None if layout is None else _count_layout(layout.argmax(0), scene),
        None if labels is None else _count_layout(labels, scene),
        seconds,
    )


def _count_layout(labels: Tensor, scene: Scene) -> Tensor | None:
    truth = scene.truth.layout
    return None if truth is None else metrics.count_layout(scene.seen(labels), truth)


def score_item(plan: Plan, found: Mapping[str, Look], item: Item) -> Result:
    """Read one item once and score every detector on it.

    Whatever goes wrong becomes the result's failure, and the picture then counts for no
    detector, so that all are scored on the same pictures.
    """
    who = ""
    try:
        scene = read_scene(plan.dataset, item)
        scores = {}
        with image_cache() as shared:
            for who, look in found.items():
                scores[who] = score_scene(look, scene, shared)
        return Result(item, scores)
    except RoadtorchError as problem:
        return Result(item, {}, f"{who}: {problem}" if who else str(problem))
    except Exception as problem:  # a detector's own mistake must not end a long run
        return Result(item, {}, f"{who or item.name}: {type(problem).__name__}: {problem}")


# --- one process or several -------------------------------------------------------------


def run(plan: Plan, jobs: int = 1, done: Collection[str] = ()) -> Iterator[Result]:
    """Yield a result for every item that is not done, in the set's order, whatever ``jobs`` is.

    done: names of items. With several processes each runs with this process's number of
    threads, so that the results are the same to the bit.
    """
    items = [item for item in plan.dataset.items if item.name not in done]
    found = looks(plan)  # mistakes in names and settings show here, before processes start
    if jobs == 1:
        yield from (score_item(plan, found, item) for item in items)
        return
    context = multiprocessing.get_context("spawn")
    # Bytes, because torch would share tensors between processes through sockets.
    message = pickle.dumps((plan, torch.get_num_threads()))
    with ProcessPoolExecutor(jobs, context, _prepare, (message,)) as pool:
        yield from map(pickle.loads, pool.map(_score_one, items))


_prepared: list[Callable[[Item], Result]] = []  # a worker process's own plan, set once


def _prepare(message: bytes) -> None:
    plan, threads = pickle.loads(message)
    torch.set_num_threads(threads)
    found = looks(plan)
    _prepared.append(lambda item: score_item(plan, found, item))


def _score_one(item: Item) -> bytes:
    return pickle.dumps(_prepared[0](item))
