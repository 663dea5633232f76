"""The decision whether to adopt an adapted network, by agreement with a teacher. Ours.

Without labels, a network is judged by the F-score of its mask against the teacher's on the half of
the footage that it was not trained on. A half's network is worse than the average of both, which is
the result; the average was trained on these frames, so that its score is optimistic. Hence the
held-out network must gain for "adopt", and it must lose and the average not gain for "do not
adopt". Trust is no evidence: training on the labels raises it.
"""

import math
from collections.abc import Iterator, Sequence
from functools import reduce
from operator import add
from pathlib import Path
from typing import Literal, NamedTuple

import torch
from torch import Tensor

from roadtorch.base.progress import Progress
from roadtorch.detectors.catalogue import load_detector
from roadtorch.detectors.fusion import FusionSettings
from roadtorch.evaluation.metrics import RoadCounts, count_levels, count_mask, max_f
from roadtorch.evaluation.result import Difference, Interval
from roadtorch.evaluation.uncertainty import percentile_interval, pooled_f, sample_weights
from roadtorch.imaging.resize import spatial_size
from roadtorch.inputs.item import Item, evenly_spaced
from roadtorch.layout.classes import NUM_CLASSES
from roadtorch.run.loop import Inference
from roadtorch.run.memo import read_arrays
from roadtorch.train.adaptation.frames import RUN_LENGTH
from roadtorch.train.config import ImageTraining
from roadtorch.train.prepared import from_uint8, image_file_name
from roadtorch.train.teachers import resize_as_prepared

MAX_JUDGED = 150
"""Frames of each half that are judged, evenly spaced."""

MIN_JUDGED = 16
"""Frames of both halves below which there is no verdict."""

MIN_GAIN = 0.002
"""Gain of F from which an adapted network is worth adopting."""

VERDICT_SEED = 36


class MaskCounts(NamedTuple):
    """Pixel counts of three networks by frame: the fields of ``ConfusionCounts``, (frames, 4).

    adapted: network not trained on these frames. averaged: average of both halves' networks.
    """

    initial: Tensor
    adapted: Tensor
    averaged: Tensor


class Verdict(NamedTuple):
    """The decision on an adaptation: F of the networks, and the difference of the first two.

    initial, adapted: on held-out frames. averaged: of the averaged network on the same frames, on
    which it was trained. reason: why the networks were not compared.
    """

    word: Literal["adopt", "do not adopt", "cannot tell"]
    initial: float
    adapted: float
    change: Difference
    averaged: float
    frames: int
    reason: str = ""

    def __str__(self) -> str:
        """Return the verdict as one sentence, with its reason."""
        if self.reason:
            return f"{self.word}: {self.reason}"
        outcome = {
            "adopt": "agrees better",
            "do not adopt": "agrees less",
            "cannot tell": "may or may not agree better",
        }[self.word]
        text = (
            f"{self.word}: on {self.frames} held-out frames the mask {outcome} with the teacher: "
            f"F {self.initial:.3f} to {self.adapted:.3f}, {self.change}"
        )
        is_less = self.change.interval.sign < 0
        return text + (f"; averaged network {self.averaged:.3f}" if is_less else "")


def count_masks(
    images: Sequence[Item],
    weights: tuple[Path, Path, Path],
    prepared: Path,
    training: ImageTraining,
    quiet: bool = False,
) -> MaskCounts:
    """Compare three networks' masks (``MaskCounts``) with the teacher's maps of prepared frames."""
    detectors = [load_detector("fusion", weights={"file": str(file)}) for file in weights]
    counts: list[list[Tensor]] = [[] for _ in weights]
    for image, road in _labelled_frames(images, prepared, "evaluating", quiet):
        for rows, detector in zip(counts, detectors, strict=True):
            mask = Inference(detector)(image).mask.float()[None]
            mask = resize_as_prepared(mask, training.network, spatial_size(road))[0]
            rows.append(torch.stack(tuple(count_mask(mask >= 0.5, road, torch.ones_like(road)))))
    return MaskCounts(*(torch.stack(rows) if rows else torch.empty(0, 4) for rows in counts))


def fit_bias(
    images: Sequence[Item], file: Path, prepared: Path, training: ImageTraining, quiet: bool = False
) -> float:
    """Fit the bias of a network's road, in log odds, for the best F against the teacher. Ours.

    Fine-tuned on soft labels, a network is less or more confident than the one that `fusion` is
    calibrated for; one bias for all frames corrects that. 0 if the teacher sees no road.
    """
    network_alone = {"weight": 0.0}  # the appearance learned from the network would undo part of it
    detector = load_detector("fusion", weights={"file": str(file)}, appearance=network_alone)
    settings = detector.settings
    assert isinstance(settings, FusionSettings)
    counts: list[RoadCounts] = []
    for image, road in _labelled_frames(images, prepared, "calibrating", quiet):
        likelihood = Inference(detector)(image).likelihood[None]
        likelihood = resize_as_prepared(likelihood, training.network, spatial_size(road))[0]
        counts.append(count_levels(likelihood.clamp(0, 1), road, torch.ones_like(road), 256))
    if not counts:
        return 0.0
    best, threshold = max_f(reduce(add, counts))
    if best.isnan():  # the teacher sees no road
        return 0.0
    shift = torch.tensor(settings.threshold).logit() - threshold.clamp(0.05, 0.95).logit()
    return float(shift * settings.calibration.temperature)


def _labelled_frames(
    images: Sequence[Item], prepared: Path, title: str, quiet: bool
) -> Iterator[tuple[Tensor, Tensor]]:
    """Yield frames (3, H, W) and the teacher's road, bool (h, w)."""
    sampled = evenly_spaced(images, MAX_JUDGED)
    for image in Progress(sampled, desc=title, unit="frame", quiet=quiet):
        file = prepared / f"{image_file_name(image)}.npz"
        if not file.exists():
            continue  # skipped and reported before
        yield image.read(), from_uint8(read_arrays(file, "maps")["maps"][NUM_CLASSES]) >= 0.5


def no_verdict(reason: str, frames: int) -> Verdict:
    """Return a verdict without comparison, with the reason."""
    none = Difference(math.nan, Interval())
    return Verdict("cannot tell", math.nan, math.nan, none, math.nan, frames, reason)


def decide_verdict(judged: Sequence[MaskCounts]) -> Verdict:
    """Decide by both halves' frames; the interval is a bootstrap of runs of ``RUN_LENGTH``."""
    frames = sum(len(half.initial) for half in judged)
    if frames < MIN_JUDGED:
        return no_verdict(f"{frames} frames are too few to decide", frames)
    generator = torch.Generator().manual_seed(VERDICT_SEED)
    runs = [
        [part.sum(0) for rows in halves for part in rows.split(RUN_LENGTH)]
        for halves in zip(*judged, strict=True)
    ]
    blocks = [torch.stack(sums) for sums in runs]
    weights = sample_weights(("",) * len(blocks[0]), generator)
    scores = [pooled_f(sums, weights) for sums in blocks]
    initial, adapted, averaged = (float(values[0]) for values in scores)
    interval = percentile_interval(scores[1][1:] - scores[0][1:])
    change = Difference(adapted - initial, interval)
    word = "cannot tell"
    if interval.sign > 0 and change.value >= MIN_GAIN:
        word = "adopt"
    elif interval.sign < 0 and averaged - initial < MIN_GAIN:
        word = "do not adopt"
    return Verdict(word, initial, adapted, change, averaged, frames)
