"""The sequences that the filter of ``roadtorch.steady`` is chosen and judged on, detected once.

A sequence is kept as one file in the cache: pictures, likelihoods, masks, truth. Remove the cache
when the detector has changed.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor
from tqdm import tqdm

from roadtorch.data.catalogue import open_dataset
from roadtorch.detector import Detector, decide, decide_beside
from roadtorch.image import read_image
from roadtorch.scene_drives import render_drive
from roadtorch.sources.footage import frame_places, read_frames

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
        np.savez(partial, **kept)
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


def decided(seen: Footage, number: int, likelihood: Tensor, detector: Detector) -> Tensor:
    """The mask of a frame whose likelihood was changed, as the detector decides."""
    seed, ego = seen.seed[number], seen.ego[number]
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
