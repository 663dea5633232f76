"""The pass: every detector over every image once, image by image."""

import math
import time
from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass

from torch import Tensor

from roadtorch.base.errors import InputError, RoadtorchError
from roadtorch.base.image_cache import ImageCache, image_cache
from roadtorch.data.dataset import Dataset, LabelledItem, Truth
from roadtorch.evaluation.boundary import count_boundary
from roadtorch.evaluation.methods import Contender, Look
from roadtorch.evaluation.metrics import count_layout, count_levels, count_mask
from roadtorch.evaluation.tally import Score, Scored
from roadtorch.run.workers import DIED, workers_for

# --- one image ------------------------------------------------------------------------


@dataclass(frozen=True)
class LabelledImage:
    """One item that has been read: its image, and the truth in the image's own space."""

    dataset: Dataset
    item: LabelledItem
    image: Tensor
    truth: Truth

    def seen(self, values: Tensor) -> Tensor:
        """A map (…,H,W) of the image's size in the space in which it is scored."""
        view = self.dataset.view
        in_image = values.shape[-2:] == self.image.shape[-2:]
        return view(self.item, values) if view is not None and in_image else values

    def seen_truth(self) -> Truth:
        """The truth in the space in which it is scored."""
        layout = None if self.truth.layout is None else self.seen(self.truth.layout)
        return Truth(self.seen(self.truth.road), self.seen(self.truth.valid), layout)


def score_look(look: Look, scene: LabelledImage, truth: Truth, shared: ImageCache) -> Score:
    """Run one detector on one image and count; truth: as it is scored."""
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


@dataclass(frozen=True)
class Scoring:
    """The task of workers: one item is read once, and every contender is scored on it."""

    dataset: Dataset
    looks: Mapping[str, Look]

    def __call__(self, item: LabelledItem) -> Scored:
        """Return the scores of one item.

        Whatever goes wrong becomes the result's failure, and the image then counts for no
        detector, so that all are scored on the same images.
        """
        name = ""
        try:
            scene = LabelledImage(self.dataset, item, *self.dataset.read(item))
            truth, scores = scene.seen_truth(), {}
            with image_cache() as shared:
                for name, look in self.looks.items():
                    scores[name] = score_look(look, scene, truth, shared)
            return Scored(item, scores)
        except RoadtorchError as error:
            return Scored(item, {}, f"{name}: {error}" if name else str(error))
        except Exception as error:  # a detector's own mistake must not end a long run
            problem = f"{type(error).__name__}: {error}"
            return Scored(item, {}, f"{name or item.name}: {problem}")


def score(
    dataset: Dataset, contenders: Sequence[Contender], jobs: int | None = 1
) -> Generator[Scored]:
    """Yield a result for every item, in the set's order; jobs: processes, None for what pays."""
    looks = {entry.name: entry.prepare(dataset) for entry in contenders}
    task = Scoring(dataset, looks)
    return workers_for(jobs, len(dataset.items)).map(task, dataset.items, _died)


def _died(item: LabelledItem) -> Scored:
    return Scored(item, {}, str(InputError(item.image, *DIED)))
