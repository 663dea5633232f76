"""The sequences that ``roadtorch.road.steady`` is chosen and judged on, detected once.

A sequence is kept as one file in the cache: pictures, likelihoods, masks, truth. Remove the cache
when the detector has changed.
"""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import torch
from torch import Tensor
from tqdm import tqdm

from roadtorch.data.catalogue import open_dataset
from roadtorch.detector import Detector, decide, decide_beside
from roadtorch.evaluation.flicker import Changes, Followed, count_changes, flicker, followed
from roadtorch.evaluation.metrics import Decisions, count_mask, f_measure
from roadtorch.io.image import read_image
from roadtorch.road.steady import Steady, SteadySettings
from roadtorch.sources.open import frame_places, read_frames
from train.rendered_drives import render_drive

CLIPS = (
    *("california_tree_shadows", "forest_road_shade"),
    *("germany_autobahn_bridge", "us_rural_damp"),
)
UNKNOWN = 2  # in the truth: void


@dataclass(frozen=True)
class Footage:
    """A sequence of n frames and what the detector says about each.

    images: uint8 (n,3,H,W). likelihood: float32 (n,H,W). mask, seed, ego: bool (n,H,W).
    truth: uint8 (n,H,W), 1 is road, 2 void; None where nobody knows.
    """

    name: str
    images: Tensor
    likelihood: Tensor
    mask: Tensor
    seed: Tensor
    ego: Tensor
    truth: Tensor | None

    def image(self, number: int) -> Tensor:
        """A frame (3,H,W) in [0,1]."""
        return self.images[number].to(torch.float32) / 255


def first(seen: Footage, count: int) -> Footage:
    """The first frames of a sequence."""
    parts = {name: part for name, part in vars(seen).items() if isinstance(part, Tensor)}
    return replace(seen, **{name: part[:count] for name, part in parts.items()})


Frames = Iterable[tuple[Tensor, Tensor | None]]
"""Pictures (3,H,W) with their truth."""


def rendered(seed: int, frames: int) -> Frames:
    """A rendered drive."""
    for scene in render_drive(seed, frames):
        truth = scene.road.to(torch.uint8).masked_fill(scene.void, UNKNOWN)
        yield scene.image, truth


def camvid_val(data: Path) -> Frames:
    """CamVid's val split: consecutive frames, 15 a second."""
    dataset = open_dataset("camvid", data / "camvid", "val")
    for item in dataset.items:
        truth = dataset.truth(item)
        yield read_image(item.image), truth.road.to(torch.uint8).masked_fill(~truth.valid, UNKNOWN)


def clip(path: Path) -> Frames:
    """A clip without truth."""
    for image in read_frames(frame_places([str(path)], 10**6)):
        yield image, None


def footage(name: str, frames: Frames, detector: Detector, cache: Path) -> Footage:
    """The sequence from the cache, or detected now and kept there."""
    path = cache / f"{name}.npz"
    if not path.exists():
        cache.mkdir(parents=True, exist_ok=True)
        kept = _detected(frames, detector, name)
        partial = path.with_suffix(".partial.npz")
        np.savez(partial, allow_pickle=False, **kept)
        partial.rename(path)
    with np.load(path) as file:
        parts = {key: torch.from_numpy(file[key]) for key in file.files}
    return Footage(name, **{"truth": None, **parts})


def _detected(frames: Frames, detector: Detector, name: str) -> dict[str, np.ndarray]:
    rows = [_row(*frame, detector) for frame in tqdm(frames, name, disable=None)]
    return {key: np.stack([row[key] for row in rows]) for key in rows[0]}


def _row(image: Tensor, truth: Tensor | None, detector: Detector) -> dict[str, np.ndarray]:
    found = detector.detect(image)
    row = {
        "images": (image * 255).round().to(torch.uint8),
        "likelihood": found.likelihood,
        "mask": found.mask,
        "seed": found.cues["seed_area"],
        "ego": found.cues["ego"],
    }
    if truth is not None:
        row["truth"] = truth
    return {key: value.numpy() for key, value in row.items()}


def decided(likelihood: Tensor, seed: Tensor, ego: Tensor, detector: Detector) -> Tensor:
    """The mask of a likelihood (H,W), as the detector decides; seed, ego: bool (H,W)."""
    if ego.any():
        return decide_beside(likelihood, ego, detector.settings, seed)
    return decide(likelihood, detector.settings, seed)


def every_footage(
    names: Iterable[str], data: Path | None, cache: Path, detector: Detector
) -> Iterator[Footage]:
    """Sequences by name: ``drive00`` is rendered, ``camvid`` and the clips are in the data."""
    for name in names:
        if name.startswith("drive"):
            frames = rendered(int(name.removeprefix("drive")), 60)
        elif data is None:
            continue
        else:
            frames = camvid_val(data) if name == "camvid" else clip(data / "clips" / f"{name}.mp4")
        yield footage(name, frames, detector, cache)


# --- figures ----------------------------------------------------------------------------


@dataclass(frozen=True)
class Figures:
    """What was counted of one sequence, a row a frame.

    outcome: int64 (n,4), true and false positives, false negatives, true negatives; None without
    truth. changes: int64 (n-1,2), changed and compared pixels.
    """

    outcome: Tensor | None
    changes: Tensor

    @property
    def flicker(self) -> float:
        """Over all frames."""
        changed, compared = self.changes.sum(0).tolist()
        return flicker([Changes(changed, compared)])

    @property
    def f(self) -> float:
        """F of all frames together; NaN without truth."""
        return math.nan if self.outcome is None else float(f_of(self.outcome.sum(0)))


def f_of(outcome: Tensor) -> Tensor:
    """F of counts (...,4)."""
    return f_measure(Decisions(*outcome.unbind(-1)))


def motions(seen: Footage) -> list[Followed]:
    """The motion between all frames that follow one another."""
    return [
        followed(seen.image(number - 1), seen.image(number))
        for number in range(1, len(seen.images))
    ]


def steadied(seen: Footage, settings: SteadySettings, detector: Detector) -> list[Tensor]:
    """The masks of all frames with the filter."""
    steady, masks = Steady(settings), []
    for number, likelihood in enumerate(seen.likelihood):
        ego = seen.ego[number]
        likelihood = steady(seen.image(number), likelihood, ego)
        standing = ego if steady.hidden is None else steady.hidden
        masks.append(decided(likelihood, seen.seed[number], standing, detector))
    return masks


def alone(seen: Footage, detector: Detector) -> list[Tensor]:
    """The masks of all frames without the filter."""
    parts = zip(seen.likelihood, seen.seed, seen.ego, strict=True)
    return [decided(*part, detector) for part in parts]


def true_masks(seen: Footage) -> list[Tensor]:
    """The truth as masks; nothing without truth."""
    return [] if seen.truth is None else [each == 1 for each in seen.truth]


def figures(seen: Footage, masks: Sequence[Tensor], moved: Sequence[Followed]) -> Figures:
    """Count masks of a sequence against the truth and from frame to frame."""
    changes = [
        count_changes(*pair, motion) for pair, motion in zip(pairwise(masks), moved, strict=True)
    ]
    outcome = None
    if seen.truth is not None:
        counts = [
            count_mask(mask, truth == 1, truth != UNKNOWN)
            for mask, truth in zip(masks, seen.truth, strict=True)
        ]
        outcome = torch.tensor([[int(part) for part in vars(each).values()] for each in counts])
    return Figures(outcome, torch.tensor([[each.changed, each.compared] for each in changes]))
