"""Choose the settings of the labeller and of the untrained fusion on many cameras.

A camera is a folder of many/ or a drive of CamVid, and each counts the same. A random walk over
the settings: a step changes one to three of them and stays if the score on the choosing cameras
rises. Without ``--held-out`` it starts from the defaults and all cameras choose. With it, it
starts from ``NEUTRAL`` settings (round numbers, all cues trusted alike), the others choose, and
the figures of those held out are printed: that is what the choice is worth. IDD is printed and
never chooses.

    python train/choose_settings.py labeller ../shared/data --steps 80 --held-out 0001TP dn_cat

The ground is continued over the ego car that ``fusion`` finds. Superpixels are cut once and
scored by the truth inside them, so a step takes seconds and the figures differ a little from
those of ``roadtorch evaluate``.
"""

import argparse
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import one_hot
from tqdm import tqdm

from roadtorch.data.catalogue import open_dataset
from roadtorch.data.dataset import Dataset, Item, Truth
from roadtorch.evaluation.metrics import (
    RoadCounts,
    class_recalls,
    decisions_at,
    f_measure,
    level_of,
    max_f,
)
from roadtorch.imaging.exposure import Exposure, brightened
from roadtorch.imaging.resize import WorkingSize, at_picture_size, resized, working_size
from roadtorch.layout.classes import CLASSES, HORIZONTAL
from roadtorch.layout.labeller import (
    ColumnOrder,
    LabellerSettings,
    PlacePrior,
    SkyLook,
    segment_layout,
)
from roadtorch.layout.picture_network import PictureNetwork
from roadtorch.layout.weights import WeightsFile, network_of
from roadtorch.road.ego import continued, ego_found
from roadtorch.road.fusion import Exponents, RoadPlace, SegmentRoadSettings, segment_road
from roadtorch.road.seed_area import seed_rectangle, seed_segments
from roadtorch.road.seed_distance import distance_likelihood, seed_distance
from roadtorch.road.texture import (
    Saturation,
    TextureSettings,
    uniformity_likelihood,
    unsaturated_uniformity,
)
from roadtorch.settings import Settings, build_settings
from roadtorch.superpixels.features import Bandwidths, Segments, measure_segments
from roadtorch.superpixels.slic import Superpixels
from roadtorch.superpixels.statistics import segment_histogram

EVERY = {"0001TP": 3, "0006R0": 5, "0016E5": 10, "ycor": 3, "idd": 6}
"""Every how many-th frame of a camera is used; all of those that are not listed."""

LEFT_OUT = "india_zed"
"""A folder that the set's own README leaves out of means."""

NEVER = "idd"
"""What never chooses."""
LEVELS = 1024


@dataclass(frozen=True)
class Frame:
    """One labelled frame, cut into n segments, with what the settings do not touch.

    Where the set tells no layout, all of ``kinds`` is 0.
    """

    camera: str
    segments: Segments
    road: Tensor
    """(n,2): pixels of background and of road."""
    kinds: Tensor
    """(n,3): pixels of sky, vertical and horizontal."""
    texture: Tensor
    distance: Tensor
    layout: Tensor


def read_frames(root: Path) -> list[Frame]:
    """Every so many-th frame of each folder of many/, of each CamVid drive and of IDD Lite."""
    many, camvid = open_dataset("folder", root / "many"), open_dataset("camvid", root / "camvid")
    idd = open_dataset("idd-lite", root / "idd_lite")
    cameras: dict[str, list[tuple[Dataset, Item]]] = {}
    for dataset in (many, camvid, idd):
        for item in dataset.items:
            cameras.setdefault(item.group or NEVER, []).append((dataset, item))
    cameras.pop(LEFT_OUT, None)
    network = network_of(WeightsFile(), "layout", PictureNetwork)
    frames = []
    for camera, items in cameras.items():
        mine = tqdm(items[:: EVERY.get(camera, 1)], camera, disable=None)
        frames += [measure_frame(*dataset.read(item), camera, network) for dataset, item in mine]
    return frames


def measure_frame(image: Tensor, truth: Truth, camera: str, network: PictureNetwork) -> Frame:
    """Cut a frame at the working size and count the truth inside its segments."""
    size = working_size(image.shape[1], image.shape[2], WorkingSize())
    ego = ego_found(network.cues(image)["ego"])
    seen = continued(image, ego) if ego.any() else image
    small = brightened(resized(seen, size).clamp(0, 1), Exposure())
    labels = Superpixels().cut(small)
    segments = measure_segments(small, labels)
    count = len(segments.size)
    unknown = torch.full(truth.road.shape, CLASSES)
    layout = unknown if truth.layout is None else truth.layout
    valid, road, kinds = (
        at_picture_size(part, size).long() for part in (truth.valid & ~ego, truth.road, layout)
    )
    texture = TextureSettings()
    seed = seed_rectangle(labels.shape)
    _, values, _ = unsaturated_uniformity(small, labels, seed, texture, Saturation())
    return Frame(
        camera,
        segments,
        segment_histogram(road, labels, count, 2, valid),
        segment_histogram(kinds.clamp(max=CLASSES), labels, count, CLASSES + 1)[:, :CLASSES],
        uniformity_likelihood(values, texture.even),
        seed_distance(segments, seed_segments(labels, seed)),
        segment_layout(segments, LabellerSettings())[:, HORIZONTAL],
    )


def layout_recalls(frames: list[Frame], settings: LabellerSettings) -> dict[str, list[float]]:
    """Recall of sky, vertical and horizontal by camera, where the layout is told."""
    told = [frame for frame in frames if frame.kinds.any()]
    confusions = {frame.camera: torch.zeros(CLASSES, CLASSES) for frame in told}
    for frame in told:
        decision = one_hot(segment_layout(frame.segments, settings).argmax(1), CLASSES)
        confusions[frame.camera] += frame.kinds.T @ decision.to(frame.kinds)
    return {camera: class_recalls(each).tolist() for camera, each in confusions.items()}


def road_f(frames: list[Frame], settings: SegmentRoadSettings) -> dict[str, list[float]]:
    """MaxF of road by camera, pixels pooled, and F at the threshold 0.5 that all share."""
    counts = {
        frame.camera: RoadCounts(torch.zeros(LEVELS), torch.zeros(LEVELS)) for frame in frames
    }
    for frame in frames:
        distance = distance_likelihood(frame.distance, settings.reach)
        road = segment_road(frame.segments, frame.layout, distance, frame.texture, settings)
        other, true = (
            torch.bincount(level_of(road, LEVELS), part, LEVELS) for part in frame.road.T
        )
        counts[frame.camera] += RoadCounts(true, other)
    return {
        camera: [float(max_f(each)[0]), float(f_measure(decisions_at(each, 0.5)))]
        for camera, each in counts.items()
    }


Space = dict[str, tuple[float, float]]
# Few, because there are few scenes. On CamVid's drives alone, with all 18 numbers of the labeller
# free, the drive 0006R0, held out, fell from .92 to .86 while the two others rose by .01; with 18
# of fusion free the mean over the held-out drives was .894, with these .903. The rest was set by
# hand.
LABELLER: Space = {
    "place.horizon": (0.4, 0.6),
    "place.sky_rise": (0.0, 0.3),
    "place.sky_softness": (0.1, 0.5),
    "place.ground_drop": (-0.1, 0.1),
    "place.ground_slope": (0.0, 0.5),
    "place.ground_softness": (0.05, 0.3),
    "place.vertical": (0.5, 2.0),
    "sky.light": (0.0, 3.0),
    "sky.level": (0.4, 0.8),
    "sky.even": (0.0, 3.0),
    "sky.blue": (0.0, 1.0),
    "sharpness": (0.5, 2.5),
    "order.weight": (0.3, 4.0),
    "order.change": (0.01, 0.1),
}
ROAD: Space = {
    "place.weight": (0.0, 2.0),
    "place.apex": (0.3, 0.7),
    "exponents.layout": (0.0, 2.0),
    "exponents.distance": (0.0, 3.0),
    "exponents.texture": (0.0, 2.0),
    "exponents.look": (0.0, 2.0),
    "exponents.neighbours": (0.0, 10.0),
    "reach": (0.5, 6.0),
    "bandwidths.chroma": (0.01, 0.1),
    "bandwidths.row": (0.1, 3.0),
    "bias": (-4.0, 4.0),
}


NEUTRAL_WIDTHS = Bandwidths(
    lightness=0.1, chroma=0.05, gradient=0.05, contrast=0.1, row=1.0, column=1.0
)
NEUTRAL = {
    "labeller": LabellerSettings(
        place=PlacePrior(
            sky_rise=0.1, sky_slope=0.5, sky_softness=0.2, ground_slope=0.5, vertical=1.0
        ),
        sky=SkyLook(light=1.0, level=0.5, even=1.0, blue=1.0),
        bandwidths=NEUTRAL_WIDTHS,
        order=ColumnOrder(weight=1.0),
        sharpness=1.0,
    ),
    "fusion": SegmentRoadSettings(
        place=RoadPlace(weight=1.0, apex=0.5, narrow=0.1, spread=1.0, softness=0.1),
        exponents=Exponents(layout=1.0, distance=1.0, texture=1.0, look=1.0, neighbours=1.0),
        reach=2.0,
        bandwidths=NEUTRAL_WIDTHS,
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
    cameras: list[str],
    steps: int,
    seed: int,
) -> tuple[Settings, dict[str, list[float]]]:
    """The best settings found, by the mean over ``cameras`` of the mean figure of each."""
    generator = np.random.default_rng(seed)
    best, figures = start, score(start)
    for _ in tqdm(range(steps), disable=None):
        tried = changed(best, space, generator)
        found = score(tried)
        if _mean(found, cameras) > _mean(figures, cameras):
            best, figures = tried, found
    return best, figures


def _mean(figures: dict[str, list[float]], cameras: list[str]) -> float:
    return float(np.mean([np.mean(figures[camera]) for camera in cameras]))


RECIPES: dict[str, tuple[Settings, Space, Callable[[list[Frame], Any], dict[str, list[float]]]]] = {
    "labeller": (LabellerSettings(), LABELLER, layout_recalls),
    "fusion": (SegmentRoadSettings(), ROAD, road_f),
}
"""What there is to choose: where it starts, what may move, and the score."""


def main() -> None:
    parser = argparse.ArgumentParser(description="Choose settings on many cameras.")
    parser.add_argument("what", choices=tuple(RECIPES))
    parser.add_argument("data", type=Path, help="holds many/, camvid/ and idd_lite/")
    parser.add_argument("--held-out", nargs="+", default=[], metavar="CAMERA")
    parser.add_argument("--steps", type=int, default=140)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    frames = read_frames(arguments.data)
    default, space, score = RECIPES[arguments.what]
    start = NEUTRAL[arguments.what] if arguments.held_out else default
    before = score(frames, start)
    held_out = [camera for camera in arguments.held_out if camera in before]
    choosing = [camera for camera in before if camera not in (*held_out, NEVER)]
    best, after = walk(
        start,
        space,
        lambda tried: score(frames, tried),
        choosing,
        arguments.steps,
        arguments.seed,
    )
    result = {"before": before, "after": after, "settings": best.model_dump()}
    print(json.dumps(result, indent=1))
    for camera in held_out:
        values = _mean(before, [camera]), _mean(after, [camera])
        print(f"{camera}, not chosen on: {values[0]:.4f} -> {values[1]:.4f}")
    print(f"chosen on {' '.join(choosing)}: {_mean(after, choosing):.4f}")


if __name__ == "__main__":
    main()
