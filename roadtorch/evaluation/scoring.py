"""Counting of every detector on every image, each image read once."""

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from typing import Any

from torch import Tensor

from roadtorch.base.errors import InputError, RoadtorchError
from roadtorch.base.image_cache import image_cache
from roadtorch.base.progress import Progress
from roadtorch.data.dataset import Dataset, LabelledItem, Truth
from roadtorch.detectors.detection import Detection
from roadtorch.evaluation.boundary import count_boundary
from roadtorch.evaluation.methods import Contender, Predictor
from roadtorch.evaluation.metrics import count_layout, count_levels, count_mask
from roadtorch.evaluation.result import Failure
from roadtorch.evaluation.tally import ImageCounts
from roadtorch.imaging.resize import spatial_size
from roadtorch.run.workers import WORKER_CRASH, make_workers

Warp = Callable[[Tensor], Tensor]
"""Values (..., H, W) of an image → the same in the space of the scores."""


def warp_truth(dataset: Dataset, item: LabelledItem, truth: Truth) -> Truth:
    """Map the ground truth of one item to the space of the scores."""
    warp = partial(dataset.warp, item, (truth.road.shape[0], truth.road.shape[1]))
    layout = None if truth.layout is None else warp(truth.layout)
    return Truth(warp(truth.road), warp(truth.valid), layout)


def count_detection(
    detection: Detection, truth: Truth, seconds: float, warp: Warp, levels: int
) -> ImageCounts:
    """Count one detection; truth: in the scoring space."""
    mask, layout, confusion = warp(detection.mask), detection.cues.get("layout"), None
    if layout is not None and truth.layout is not None:
        confusion = count_layout(warp(layout.argmax(0)), truth.layout)
    return ImageCounts(
        count_levels(warp(detection.likelihood), truth.road, truth.valid, levels),
        count_mask(mask, truth.road, truth.valid),
        count_boundary(mask, truth.road, truth.valid),
        confusion,
        seconds,
        math.nan if detection.trust is None else detection.trust,
    )


@dataclass(frozen=True)
class ItemTask:
    """Task of a worker process: read one item, run and measure every contender on it."""

    dataset: Dataset
    predictors: Mapping[str, Predictor]
    measure: Callable[[Detection, Truth, float, Warp, int], Any]  # as ``count_detection``

    def __call__(self, item: LabelledItem) -> Mapping[str, Any] | Failure:
        """Return the measured values by contender.

        An exception becomes a failure; the image then counts for no detector, so that all are
        scored on the same images.
        """
        name, values, levels = "", dict[str, Any](), self.dataset.levels
        try:
            image, truth = self.dataset.read(item)
            warp = partial(self.dataset.warp, item, spatial_size(image))
            truth = warp_truth(self.dataset, item, truth)
            with image_cache() as shared:
                for name, predictor in self.predictors.items():
                    # Parts that were cached for other detectors count as this one's work, too.
                    start = time.perf_counter() + shared.saved_seconds
                    detection = predictor(image, item)
                    seconds = time.perf_counter() + shared.saved_seconds - start
                    values[name] = self.measure(detection, truth, seconds, warp, levels)
            return values
        except Exception as error:  # a bug in a detector must not end a long run
            is_refusal = isinstance(error, RoadtorchError)
            problem = str(error) if is_refusal else f"{type(error).__name__}: {error}"
            return Failure(item.name, item.group, f"{name}: {problem}" if name else problem)


def run_contenders(
    dataset: Dataset,
    contenders: Sequence[Contender],
    measure: Callable[[Detection, Truth, float, Warp, int], Any] = count_detection,
    jobs: int | None = 1,
    quiet: bool = True,
    **progress: str,
) -> Iterator[tuple[LabelledItem, Mapping[str, Any] | Failure]]:
    """Yield every item, in order, with the values by contender, or its failure.

    jobs: processes, None for as many as help. progress: texts of the progress bar.
    """
    task = ItemTask(dataset, {entry.name: entry.prepare(dataset) for entry in contenders}, measure)
    count = len(dataset.items)
    with closing(make_workers(jobs, count).map(task, dataset.items, _crash_failure)) as results:
        bar = Progress(results, total=count, unit="image", quiet=quiet, **progress)
        yield from zip(dataset.items, bar, strict=True)


def _crash_failure(item: LabelledItem) -> Failure:
    return Failure(item.name, item.group, str(InputError(item.image, *WORKER_CRASH)))
