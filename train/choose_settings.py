"""Choose the settings of the labeller and of fusion on CamVid's development drives.

A random walk over the settings: a step changes one to three of them and stays if the score
on the choosing drives rises. Without ``--held-out`` it starts from the defaults and all three
drives choose. With it, it starts from ``NEUTRAL`` settings (round numbers, all cues trusted
alike), the other two drives choose, and the figure of the third is printed: that is what the
choice is worth (leave one drive out). IDD is printed and never chooses.

    python train/choose_settings.py labeller ../shared/data --steps 150 --held-out 0001TP

Superpixels are cut once and scored by the truth inside them, so a step takes seconds and the
figures differ a little from those of ``roadtorch evaluate``.
"""

import argparse
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from torch import Tensor
from tqdm import tqdm

from roadtorch.families.texture import Saturation, TextureSettings, unsaturated_uniformity
from roadtorch.fusion import (
    RoadPlace,
    RoadSettings,
    Weights,
    distance_likelihood,
    seed_distance,
    segment_road,
)
from roadtorch.geometry import SeedArea
from roadtorch.image import read_image
from roadtorch.layout.labeller import (
    HORIZONTAL,
    ColumnOrder,
    LabellerSettings,
    PlacePrior,
    segment_layout,
)
from roadtorch.segments import Bandwidths, Exposure, Segments, brightened, measure_segments
from roadtorch.settings import Settings, build_settings
from roadtorch.superpixels import segment_histogram
from roadtorch.texture import uniformity_likelihood
from roadtorch.working import Superpixels, WorkingSize, resized, working_size

DRIVES = ("0001TP", "0006R0", "0016E5")
EVERY = {"0001TP": 2, "0006R0": 3, "0016E5": 8, "idd": 6}
"""Every how many-th frame of a drive is used."""
CAMVID_LAYOUT = torch.tensor([0, 1, 1, 2, 2, 1, 1, 1, 1, 1, 1])
IDD_TO_CAMVID = np.full(256, 11, np.uint8)
IDD_TO_CAMVID[:7] = [3, 4, 9, 8, 7, 1, 0]
LEVELS = 1024


@dataclass
class Frame:
    """One labelled frame, cut into segments; truth: (n,12) pixels of each class."""

    drive: str
    segments: Segments
    truth: Tensor
    texture: Tensor
    distance: Tensor
    layout: Tensor


def read_frames(root: Path) -> list[Frame]:
    camvid = [
        (path, path.parent.name)
        for s in ("train", "val")
        for path in _pictures(root / "camvid" / s)
    ]
    frames = []
    for drive in DRIVES:
        mine = [item for item in camvid if item[0].stem.startswith(drive)][:: EVERY[drive]]
        for path, split in tqdm(mine, drive, disable=None):
            annotation = cv2.imread(str(root / "camvid" / f"{split}annot" / f"{path.stem}.png"), 0)
            frames.append(read_frame(path, np.asarray(annotation), drive))
    for path in tqdm(_pictures(root / "idd_lite/images")[:: EVERY["idd"]], "idd", disable=None):
        annotation = cv2.imread(str(root / "idd_lite/labels" / f"{path.stem}.png"), 0)
        frames.append(read_frame(path, IDD_TO_CAMVID[np.asarray(annotation)], "idd"))
    return frames


def _pictures(folder: Path) -> list[Path]:
    return sorted(folder.glob("*.jpg"))


def read_frame(path: Path, annotation: np.ndarray, drive: str) -> Frame:
    image = read_image(path)
    size = working_size(image.shape[1], image.shape[2], WorkingSize())
    small = brightened(resized(image, size).clamp(0, 1), Exposure())
    truth = cv2.resize(annotation, size[::-1], interpolation=cv2.INTER_NEAREST)
    labels = Superpixels().cut(small)
    segments = measure_segments(small, labels)
    classes = torch.from_numpy(truth).long()
    counts = segment_histogram(classes, labels, len(segments.size), 12)
    texture = TextureSettings()
    _, values, _ = unsaturated_uniformity(small, labels, SeedArea(), texture, Saturation())
    texture = uniformity_likelihood(values, texture.even)
    distance = seed_distance(segments, SeedArea())
    layout = segment_layout(segments, LabellerSettings())[:, HORIZONTAL]
    return Frame(drive, segments, counts, texture, distance, layout)


def layout_recalls(frames: list[Frame], settings: LabellerSettings) -> dict[str, list[float]]:
    """Recall of sky, vertical and horizontal by drive."""
    right: dict[str, Tensor] = {}
    total: dict[str, Tensor] = {}
    for frame in frames:
        decision = segment_layout(frame.segments, settings).argmax(1)
        truth = torch.stack(
            [frame.truth[:, :11][:, c == CAMVID_LAYOUT].sum(1) for c in range(3)], 1
        )
        hit = truth.gather(1, decision[:, None])[:, 0]
        right[frame.drive] = right.get(frame.drive, 0) + torch.bincount(decision, hit, minlength=3)
        total[frame.drive] = total.get(frame.drive, 0) + truth.sum(0)
    return {drive: (right[drive] / total[drive]).tolist() for drive in right}


def road_f(frames: list[Frame], settings: RoadSettings) -> dict[str, list[float]]:
    """MaxF of road by drive, pixels pooled, and F at the threshold 0.5 that all drives share."""
    counts: dict[str, Tensor] = {}
    for frame in frames:
        distance = distance_likelihood(frame.distance, settings.reach)
        road = segment_road(frame.segments, frame.layout, distance, frame.texture, settings)
        level = (road * (LEVELS - 1)).round().long()
        parts = (frame.truth[:, 3], frame.truth[:, :11].sum(1) - frame.truth[:, 3])
        both = torch.stack([torch.bincount(level, part, minlength=LEVELS) for part in parts])
        counts[frame.drive] = counts.get(frame.drive, 0) + both
    return {drive: _maxf_and_f(both) for drive, both in counts.items()}


def _maxf_and_f(counts: Tensor) -> list[float]:
    positive, false = counts.flip(1).cumsum(1)
    f = 2 * positive / (positive + false + positive[-1])
    return [float(f.max()), float(f[LEVELS // 2 - 1])]


Space = dict[str, tuple[float, float]]
# Few, because there are few scenes. With all 18 numbers of the labeller free, the drive 0006R0,
# held out, fell from .92 to .86 while the two choosing drives rose by .01; with 18 of fusion free
# the mean over the held-out drives was .894, with these it is .903. The rest was set by hand.
LABELLER: Space = {
    "place.horizon": (0.4, 0.6),
    "place.sky_softness": (0.1, 0.5),
    "place.ground_softness": (0.05, 0.3),
    "place.vertical": (0.5, 2.0),
    "sharpness": (0.5, 2.5),
    "order.weight": (0.3, 4.0),
    "order.change": (0.01, 0.1),
}
ROAD: Space = {
    "place.weight": (0.0, 2.0),
    "place.apex": (0.3, 0.7),
    "weights.layout": (0.0, 2.0),
    "weights.distance": (0.0, 3.0),
    "weights.texture": (0.0, 2.0),
    "weights.look": (0.0, 2.0),
    "weights.neighbours": (0.0, 10.0),
    "reach": (0.5, 6.0),
    "bandwidths.chroma": (0.01, 0.1),
    "bandwidths.row": (0.1, 3.0),
    "bias": (-4.0, 4.0),
}


NEUTRAL = {
    "labeller": LabellerSettings(
        place=PlacePrior(
            sky_rise=0.1, sky_slope=0.5, sky_softness=0.2, ground_slope=0.5, vertical=1.0
        ),
        bandwidths=Bandwidths(
            lightness=0.1, chroma=0.05, gradient=0.05, contrast=0.1, row=1.0, column=1.0
        ),
        order=ColumnOrder(weight=1.0),
        sharpness=1.0,
    ),
    "fusion": RoadSettings(
        place=RoadPlace(weight=1.0, apex=0.5, narrow=0.1, spread=1.0, softness=0.1),
        weights=Weights(layout=1.0, distance=1.0, texture=1.0, look=1.0, neighbours=1.0),
        reach=2.0,
        bandwidths=Bandwidths(
            lightness=0.1, chroma=0.05, gradient=0.05, contrast=0.1, row=1.0, column=1.0
        ),
        bias=0.0,
    ),
}


def changed(settings: Settings, space: Space, generator: np.random.Generator) -> Settings:
    """One to three settings moved by a fifth of their range or so."""
    values = settings.model_dump()
    for key in generator.choice(list(space), size=generator.integers(1, 4), replace=False):
        low, high = space[key]
        *path, name = key.split(".")
        group = values
        for part in path:
            group = group[part]
        step = generator.normal() * (high - low) / 5
        group[name] = round(float(np.clip(group[name] + step, low, high)), 4)
    return build_settings(type(settings), values)


def walk(
    start: Settings,
    space: Space,
    score: Callable[[Settings], dict[str, list[float]]],
    drives: list[str],
    steps: int,
    seed: int,
) -> tuple[Settings, dict[str, list[float]]]:
    """The best settings found, by the mean over ``drives`` of the mean figure of each."""
    generator = np.random.default_rng(seed)
    best, figures = start, score(start)
    for _ in tqdm(range(steps), disable=None):
        tried = changed(best, space, generator)
        found = score(tried)
        if _mean(found, drives) > _mean(figures, drives):
            best, figures = tried, found
    return best, figures


def _mean(figures: dict[str, list[float]], drives: list[str]) -> float:
    return float(np.mean([np.mean(figures[drive]) for drive in drives]))


RECIPES: dict[str, tuple[Settings, Space, Callable[[list[Frame], Any], dict[str, list[float]]]]] = {
    "labeller": (LabellerSettings(), LABELLER, layout_recalls),
    "fusion": (RoadSettings(), ROAD, road_f),
}
"""What there is to choose: where it starts, what may move, and the score."""


def main() -> None:
    parser = argparse.ArgumentParser(description="Choose settings on CamVid's development drives.")
    parser.add_argument("what", choices=("labeller", "fusion"))
    parser.add_argument("data", type=Path, help="the folder that holds camvid/ and idd_lite/")
    parser.add_argument("--held-out", choices=DRIVES)
    parser.add_argument("--steps", type=int, default=140)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    frames = read_frames(arguments.data)
    default, space, score = RECIPES[arguments.what]
    drives = [drive for drive in DRIVES if drive != arguments.held_out]
    start = NEUTRAL[arguments.what] if arguments.held_out else default
    before = score(frames, start)
    best, after = walk(
        start,
        space,
        lambda tried: score(frames, tried),
        drives,
        arguments.steps,
        arguments.seed,
    )
    result = {"before": before, "after": after, "settings": best.model_dump()}
    print(json.dumps(result, indent=1))
    if arguments.held_out:
        print(f"{arguments.held_out}, not chosen on: {_mean(after, [arguments.held_out]):.4f}")
    print(f"chosen on {' '.join(drives)}: {_mean(after, drives):.4f}")


if __name__ == "__main__":
    main()
