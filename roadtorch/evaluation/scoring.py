"""Counting of every detector on every image, each image read once."""

import math
import time
from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass

from torch import Tensor

from roadtorch.base.errors import InputError, RoadtorchError
from roadtorch.base.image_cache import ImageCache, image_cache
from roadtorch.data.dataset import Dataset, LabelledItem, Truth
from roadtorch.evaluation.boundary import count_boundary
from roadtorch.evaluation.methods import Contender, Predictor
from roadtorch.evaluation.metrics import count_layout, count_levels, count_mask
from roadtorch.evaluation.tally import ImageCounts, ImageResult
from roadtorch.run.workers import WORKER_CRASH, make_workers

# --- one image ------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class LabelledImage:
    """An item that has been read: its image, and the truth in the space of the image."""

    dataset: Dataset
    item: LabelledItem
    image: Tensor
    truth: Truth

    def warp(self, values: Tensor) -> Tensor:
        """Warp a map (..., H, W) of the image's size to the space in which the set is scored."""
        space = self.dataset.scoring_space
        in_image = values.shape[-2:] == self.image.shape[-2:]
        return space(self.item, values) if space is not None and in_image else values

    def scoring_truth(self) -> Truth:
        """Return the truth in the space in which the set is scored."""
        layout = None if self.truth.layout is None else self.warp(self.truth.layout)
        return Truth(self.warp(self.truth.road), self.warp(self.truth.valid), layout)


def count_image(
    predictor: Predictor, scene: LabelledImage, truth: Truth, shared: ImageCache
) -> ImageCounts:
    """Run one detector on one image and count; truth: in the scoring space."""
    saved_before, start = shared.saved_seconds, time.perf_counter()
    detection = predictor(scene.image, scene.item)
    # Parts that were cached for other detectors count as this detector's work, too.
    seconds = time.perf_counter() - start + shared.saved_seconds - saved_before
    mask, layout = scene.warp(detection.mask), detection.cues.get("layout")
    confusion = None
    if layout is not None and truth.layout is not None:
        confusion = count_layout(scene.warp(layout.argmax(0)), truth.layout)
    likelihood = scene.warp(detection.likelihood)
    return ImageCounts(
        count_levels(likelihood, truth.road, truth.valid, scene.dataset.levels),
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
            scene = LabelledImage(self.dataset, item, *self.dataset.read(item))
            truth, counts = scene.scoring_truth(), {}
            with image_cache() as shared:
                for name, predictor in self.predictors.items():
                    counts[name] = count_image(predictor, scene, truth, shared)
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
