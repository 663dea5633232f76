"""Counting of every detector on every image, each image read once."""

import math
import time
from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

from torch import Tensor

from roadtorch.base.errors import InputError, RoadtorchError
from roadtorch.base.image_cache import ImageCache, image_cache
from roadtorch.data.dataset import Dataset, LabelledItem, Truth
from roadtorch.evaluation.boundary import count_boundary
from roadtorch.evaluation.methods import Contender, Predictor
from roadtorch.evaluation.metrics import count_layout, count_levels, count_mask
from roadtorch.evaluation.tally import ImageCounts, ImageResult
from roadtorch.imaging.resize import spatial_size
from roadtorch.run.workers import WORKER_CRASH, make_workers

# --- one image ------------------------------------------------------------------------


def warp_truth(dataset: Dataset, item: LabelledItem, truth: Truth) -> Truth:
    """Map the ground truth of one item to the space of the scores."""
    warp = partial(dataset.warp, item, (truth.road.shape[0], truth.road.shape[1]))
    layout = None if truth.layout is None else warp(truth.layout)
    return Truth(warp(truth.road), warp(truth.valid), layout)


def count_image(
    predictor: Predictor,
    dataset: Dataset,
    item: LabelledItem,
    image: Tensor,
    truth: Truth,
    shared: ImageCache,
) -> ImageCounts:
    """Run one detector on one image and count; truth: in the scoring space."""
    saved_before, start = shared.saved_seconds, time.perf_counter()
    detection = predictor(image, item)
    # Parts that were cached for other detectors count as this detector's work, too.
    seconds = time.perf_counter() - start + shared.saved_seconds - saved_before
    warp = partial(dataset.warp, item, spatial_size(image))
    mask, layout = warp(detection.mask), detection.cues.get("layout")
    confusion = None
    if layout is not None and truth.layout is not None:
        confusion = count_layout(warp(layout.argmax(0)), truth.layout)
    return ImageCounts(
        count_levels(warp(detection.likelihood), truth.road, truth.valid, dataset.levels),
        count_mask(mask, truth.road, truth.valid),
        count_boundary(mask, truth.road, truth.valid),
        confusion,
        seconds,
        math.nan if detection.trust is None else detection.trust,
    )


@dataclass(frozen=True)
class ScoringTask:
    """Task of a worker process: read one item, count every contender on it."""

    dataset: Dataset
    predictors: Mapping[str, Predictor]

    def __call__(self, item: LabelledItem) -> ImageResult:
        """Return the counts of one item.

        An exception becomes the result's failure; the image then counts for no detector, so that
        all are scored on the same images.
        """
        name = ""
        try:
            image, truth = self.dataset.read(item)
            truth, counts = warp_truth(self.dataset, item, truth), {}
            with image_cache() as shared:
                for name, predictor in self.predictors.items():
                    counts[name] = count_image(predictor, self.dataset, item, image, truth, shared)
            return ImageResult(item, counts)
        except RoadtorchError as error:
            return ImageResult(item, {}, f"{name}: {error}" if name else str(error))
        except Exception as error:  # a bug in a detector must not end a long run
            problem = f"{type(error).__name__}: {error}"
            return ImageResult(item, {}, f"{name or item.name}: {problem}")


def score_dataset(
    dataset: Dataset, contenders: Sequence[Contender], jobs: int | None = 1
) -> Generator[ImageResult]:
    """Yield a result for every item, in order; jobs: processes, None for as many as help."""
    task = ScoringTask(dataset, {entry.name: entry.prepare(dataset) for entry in contenders})
    return make_workers(jobs, len(dataset.items)).map(task, dataset.items, _crash_result)


def _crash_result(item: LabelledItem) -> ImageResult:
    return ImageResult(item, {}, str(InputError(item.image, *WORKER_CRASH)))
