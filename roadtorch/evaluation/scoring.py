"""The pass: every detector over every picture once, picture by picture."""

import math
import multiprocessing
import pickle
import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from roadtorch.data.dataset import Dataset, Item, Truth
from roadtorch.errors import RoadtorchError
from roadtorch.evaluation.methods import Look, Method
from roadtorch.evaluation.tally import Score, Scored, count
from roadtorch.runtime.image_cache import ImageCache, image_cache
from roadtorch.runtime.signals import end_with_parent, interrupting_none_started

# --- one picture ------------------------------------------------------------------------


@dataclass(frozen=True)
class LabelledPicture:
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


def read_scene(dataset: Dataset, item: Item) -> LabelledPicture:
    """Read one item; RoadtorchError when its files are missing, damaged or do not fit."""
    image, truth = dataset.read(item)
    scene = LabelledPicture(dataset, item, image, truth)
    return replace(scene, truth=seen_truth(scene))


def seen_truth(scene: LabelledPicture) -> Truth:
    """The truth of a scene in the space in which it is scored."""
    truth = scene.truth
    layout = None if truth.layout is None else scene.seen(truth.layout)
    return Truth(scene.seen(truth.road), scene.seen(truth.valid), layout)


def score_scene(look: Look, scene: LabelledPicture, shared: ImageCache) -> Score:
    """Run one detector on one picture and count."""
    saved, start = shared.saved, time.perf_counter()
    detection = look(scene.image, scene.item)
    # What others had made before it counts as this one's work, too.
    seconds = time.perf_counter() - start + shared.saved - saved
    layout, labels = detection.cues.get("layout"), detection.cues.get("layout_labels")
    counts = count(
        scene.truth,
        scene.dataset.levels,
        scene.seen(detection.likelihood),
        scene.seen(detection.mask),
        layout=None if layout is None else scene.seen(layout.argmax(0)),
        labels=None if labels is None else scene.seen(labels),
    )
    trust = math.nan if detection.trust is None else detection.trust
    return replace(counts, seconds=seconds, trust=trust)


def score_item(dataset: Dataset, looks: Mapping[str, Look], item: Item) -> Scored:
    """Read one item once and score every detector on it.

    Whatever goes wrong becomes the result's failure, and the picture then counts for no
    detector, so that all are scored on the same pictures.
    """
    who = ""
    try:
        scene = read_scene(dataset, item)
        scores = {}
        with image_cache() as shared:
            for who, look in looks.items():
                scores[who] = score_scene(look, scene, shared)
        return Scored(item, scores)
    except RoadtorchError as problem:
        return Scored(item, {}, f"{who}: {problem}" if who else str(problem))
    except Exception as problem:  # a detector's own mistake must not end a long run
        return Scored(item, {}, f"{who or item.name}: {type(problem).__name__}: {problem}")


# --- one process or several -------------------------------------------------------------


def prepared(dataset: Dataset, methods: Sequence[Method]) -> dict[str, Look]:
    """The methods by name, ready to look."""
    return {one.name: one.prepare(dataset) for one in methods}


def score(
    dataset: Dataset, methods: Sequence[Method], jobs: int = 1, done: Collection[str] = ()
) -> Iterator[Scored]:
    """Yield a result for every item that is not done, in the set's order, whatever ``jobs`` is.

    done: names of items. With several processes each runs with this process's number of
    threads, so that the results are the same to the bit.
    """
    items = [item for item in dataset.items if item.name not in done]
    looks = prepared(dataset, methods)  # mistakes show here, before processes start
    if jobs == 1:
        yield from (score_item(dataset, looks, item) for item in items)
        return
    context = multiprocessing.get_context("spawn")
    # Bytes, because torch would share tensors between processes through sockets.
    message = pickle.dumps((dataset, methods, torch.get_num_threads()))
    with ProcessPoolExecutor(jobs, context, _prepare, (message,)) as pool:
        with interrupting_none_started():
            results = pool.map(_score_one, items)
        yield from map(pickle.loads, results)


_prepared: list[Callable[[Item], Scored]] = []  # a worker process's own pass, set once


def _prepare(message: bytes) -> None:
    end_with_parent()
    dataset, methods, threads = pickle.loads(message)
    torch.set_num_threads(threads)
    looks = prepared(dataset, methods)
    _prepared.append(lambda item: score_item(dataset, looks, item))


def _score_one(item: Item) -> bytes:
    return pickle.dumps(_prepared[0](item))
