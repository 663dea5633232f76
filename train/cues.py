"""What each cue of the image adds to the network of `fusion`, and what it costs.

    python -m train.cues DATA/many [--weights FILE]

The network alone at several sizes, and naive Bayes of it with layout, texture, distance, position,
appearance and neighbours, as in `fusion:scratch`, leaving out one cue at a time. F of the mask on
each camera at the centre that the other cameras choose, at the working size; the difference to the
network alone with a 95 % interval over images resampled within cameras; the median milliseconds.
"""

import argparse
from collections.abc import Iterator, Mapping
from pathlib import Path
from time import perf_counter
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor
from tqdm import tqdm

from roadtorch.data.catalogue import open_dataset
from roadtorch.data.dataset import Truth
from roadtorch.detectors.fusion import ScratchFusionSettings, seen_from
from roadtorch.imaging.color import brightened
from roadtorch.imaging.resize import WorkingSize, at_work, resized, size_of
from roadtorch.imaging.segments import measure_segments, paint, segment_mean
from roadtorch.layout.classes import CLASSES, HORIZONTAL, pooled
from roadtorch.layout.image_network import scaled
from roadtorch.layout.labeller import EXPOSURE, segment_layout
from roadtorch.layout.weights import (
    FOR_IMAGES,
    WeightsFile,
    WholeImageNetwork,
    image_network_of,
    network_at,
)
from roadtorch.road.ego import continued, ego_found
from roadtorch.road.fusion import RULES, log_odds, seed_log_odds, segment_road
from roadtorch.road.seed_area import likely_seed
from train.calibrate import TOO_FEW, as_others_choose, counts_between, f_by_level

SCALES = (0.67, 1.0, 1.33)
"""Sizes relative to that of the network's settings."""

DETAIL = 4.0
"""Weight of the network's log odds by pixel against their mean over a superpixel."""

ALONE = "network alone"
DRAWS = 500


class Variant(NamedTuple):
    """The cues that are used; the others are .5 everywhere."""

    layout: bool = True
    texture: bool = True
    distance: bool = True
    place: bool = True
    look: bool = True
    neighbours: bool = True


VARIANTS = {"all cues": Variant()} | {
    f"without {name}": Variant()._replace(**{name: False}) for name in Variant._fields
}


def odds_of(
    image: Tensor, networks: Mapping[float, WholeImageNetwork]
) -> Iterator[tuple[str, Tensor, float]]:
    """Yield name, log odds (h, w) and seconds of each way to find the road of an image (3, h, w).

    networks: by scale.
    """
    settings = ScratchFusionSettings()
    for scale, network in networks.items():
        begun = perf_counter()
        cues = network.cues(image)
        seconds = perf_counter() - begun
        yield f"network at {scale:g}" if scale != 1 else ALONE, hidden(cues), seconds
        if scale == 1:
            learned, base = cues, seconds
    ego = ego_found(learned["ego"])
    begun = perf_counter()
    known = torch.cat([image, learned["layout"], learned["road"][None]])
    image, layout, road = continued(known, ego).split([3, CLASSES, 1])
    image = brightened(image, EXPOSURE)
    segments = measure_segments(image, settings.superpixels.cut(image))
    own = segment_layout(segments, settings.labeller.rules)
    taught = segment_mean([*layout, road[0]], segments.labels, segments.pixels)
    ground, odds = (
        pooled(own.T, taught[:CLASSES], settings.layout_weight)[HORIZONTAL],
        log_odds(taught[-1]),
    )
    share = settings.seed_area.share
    evidence = odds + seed_log_odds(segments, ground)
    sources = likely_seed(evidence, segments.row, segments.size, share)
    seed = sources[segments.labels]
    near, even, _ = seen_from(image, segments, seed, sources.nonzero()[:, 0])
    seconds = perf_counter() - begun
    nothing = torch.full_like(near, 0.5)
    for name, variant in VARIANTS.items():
        exponents = RULES.exponents._replace(
            appearance=RULES.exponents.appearance * variant.look,
            neighbours=RULES.exponents.neighbours * variant.neighbours,
        )
        position = RULES.position._replace(weight=RULES.position.weight * variant.place)
        rules = RULES._replace(exponents=exponents, position=position)
        pairs = ((ground, variant.layout), (near, variant.distance), (even, variant.texture))
        likely, close, plain = (cue if on else nothing for cue, on in pairs)
        begun = perf_counter()
        found = segment_road(segments, likely, close, plain, odds, rules)
        spent = base + seconds + perf_counter() - begun
        total = paint(log_odds(found), segments.labels) + DETAIL * log_odds(learned["road"])
        yield name, torch.where(ego, -torch.inf, total), spent


def hidden(cues: Mapping[str, Tensor]) -> Tensor:
    """Return the network's log odds of road, -inf on the ego car."""
    return torch.where(ego_found(cues["ego"]), -torch.inf, log_odds(cues["road"]))


class Counted(NamedTuple):
    """Pixels of n images by log odds (n, 2, levels + 1), and their seconds (n,)."""

    counts: np.ndarray
    seconds: np.ndarray


@torch.no_grad()
def counted(many: Path, weights: str) -> tuple[dict[str, Counted], np.ndarray]:
    """Count road and background by log odds of each way; return counts and cameras (n,)."""
    network = image_network_of(WeightsFile(file=weights), FOR_IMAGES)
    size = (network.settings.height, network.settings.width)
    networks = {scale: network_at(network, *scaled(*size, scale)) for scale in SCALES}
    dataset, rows, cameras = open_dataset("folder", many), {}, []
    for item in tqdm([item for item in dataset.items if item.group not in TOO_FEW], disable=None):
        image, truth = dataset.read(item)
        small = at_work(image, WorkingSize(pixels=256 * 192))
        planes = torch.stack([truth.valid, truth.road & truth.valid]).float()
        valid, road = resized(planes, size_of(small)) > 0.5
        for name, odds, seconds in odds_of(small, networks):
            counts = counts_between(odds, Truth(road, valid))
            rows.setdefault(name, []).append((counts, seconds))
        cameras.append(str(item.group))
    found = {}
    for name, pairs in rows.items():
        counts, seconds = zip(*pairs, strict=True)
        found[name] = Counted(np.array(counts), np.array(seconds))
    return found, np.array(cameras)


def table_of(counts: np.ndarray, cameras: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Compute F by camera and level with weights (n,) of the images."""
    weighed = counts * weights[:, None, None]
    return f_by_level(np.array([weighed[cameras == each].sum(0) for each in np.unique(cameras)]))


def drawn_anew(cameras: np.ndarray, at: np.random.Generator) -> np.ndarray:
    """Count how often each image is resampled (n,), with replacement within its camera."""
    weights = np.zeros(len(cameras))
    for camera in np.unique(cameras):
        mine = np.flatnonzero(cameras == camera)
        np.add.at(weights, at.choice(mine, len(mine)), 1)
    return weights


def main() -> None:
    parser = argparse.ArgumentParser(description="What each cue brings beside the network.")
    parser.add_argument("many", type=Path)
    parser.add_argument("--weights", default="")
    given = parser.parse_args()
    torch.set_num_threads(1)
    found, cameras = counted(given.many, given.weights)
    at, ones = np.random.default_rng(35), np.ones(len(cameras))
    draws = [drawn_anew(cameras, at) for _ in range(DRAWS)]
    level = {
        name: table_of(each.counts, cameras, ones).mean(0).argmax() for name, each in found.items()
    }
    means = {
        name: [table_of(each.counts, cameras, draw)[:, level[name]].mean() for draw in draws]
        for name, each in found.items()
    }
    print("| | F | worst | against the network alone (95 %) | ms |\n|---|---|---|---|---|")
    for name, each in found.items():
        f = as_others_choose(table_of(each.counts, cameras, ones))
        less = np.array(means[name]) - np.array(means[ALONE])
        low, high = np.quantile(less, [0.025, 0.975])
        print(
            f"| {name} | {f.mean():.3f} | {f.min():.3f} | {less.mean():+.3f} "
            f"({low:+.3f} to {high:+.3f}) | {1000 * np.median(each.seconds):.1f} |"
        )


if __name__ == "__main__":
    main()
