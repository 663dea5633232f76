"""The pass: every detector over every picture once, picture by picture."""

import math
import multiprocessing
import pickle
import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass

import torch
from torch import Tensor

from roadtorch.data.dataset import Dataset, Item, Truth
from roadtorch.errors import RoadtorchError
from roadtorch.evaluation.boundary import count_boundary
from roadtorch.evaluation.methods import Look, Method
from roadtorch.evaluation.metrics import count_layout, count_levels, count_mask
from roadtorch.evaluation.tally import Score, Scored
from roadtorch.runtime.image_cache import ImageCache, image_cache
from roadtorch.runtime.signals import end_with_parent, interrupting_none_started

# --- one picture ------------------------------------------------------------------------


@dataclass(frozen=True)
class LabelledPicture:
    """One item that has been read: its picture, and the truth in the picture's own space."""

    dataset: Dataset
    item: Item
    image: Tensor
    truth: Truth

    def seen(self, values: Tensor) -> Tensor:
        """A map (…,H,W) of the picture's size in the space in which it is scored."""
        view = self.dataset.view
        in_picture = values.shape[-2:] == self.image.shape[-2:]
        return view(self.item, values) if view is not None and in_picture else values

    def seen_truth(self) -> Truth:
        """The truth in the space in which it is scored."""
        layout = None if self.truth.layout is None else self.seen(self.truth.layout)
        return Truth(self.seen(self.truth.road), self.seen(self.truth.valid), layout)


def score_look(look: Look, scene: LabelledPicture, truth: Truth, shared: ImageCache) -> Score:
    """Run one detector on one picture and count; truth: as it is scored."""
    saved, start = shared.saved, time.perf_counter()
    detection = look(scene.image, scene.item)
    # What others had made before it counts as this one's work, too.
    seconds = time.perf_counter() - start + shared.saved - saved
    mask, layout = scene.seen(detection.mask), detection.cues.get("layout")
    labels = {
        "layout": None if layout is None else layout.argmax(0),
        "labels": detection.cues.get("layout_labels"),
    }
    confusions = {
        kind: count_layout(scene.seen(values), truth.layout)
        for kind, values in labels.items()
        if values is not None and truth.layout is not None
    }
    return Score(
        count_levels(
            scene.seen(detection.likelihood), truth.road, truth.valid, scene.dataset.levels
        ),
        count_mask(mask, truth.road, truth.valid),
        count_boundary(mask, truth.road, truth.valid),
        confusions.get("layout"),
        confusions.get("labels"),
        seconds,
        math.nan if detection.trust is None else detection.trust,
    )


def score_item(dataset: Dataset, looks: Mapping[str, Look], item: Item) -> Scored:
    """Read one item once and score every detector on it.

    Whatever goes wrong becomes the result's failure, and the picture then counts for no
    detector, so that all are scored on the same pictures.
    """
    who = ""
    try:
        scene = LabelledPicture(dataset, item, *dataset.read(item))
        truth, scores = scene.seen_truth(), {}
        with image_cache() as shared:
            for who, look in looks.items():
                scores[who] = score_look(look, scene, truth, shared)
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
