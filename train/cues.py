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
from roadtorch.detectors.fusion import ScratchFusionSettings, seed_likelihoods
from roadtorch.evaluation.uncertainty import percentile_interval, sample_weights
from roadtorch.imaging.resize import WorkingSize, resize_maps, resize_to_work, spatial_size
from roadtorch.imaging.segments import paint_segments, segment_mean
from roadtorch.layout.classes import HORIZONTAL, NUM_CLASSES, opinion_pool
from roadtorch.layout.image_network import compute_cues, scale_size
from roadtorch.layout.labeller import label_segments
from roadtorch.layout.weights import (
    DEFAULT_WEIGHTS,
    WeightsFile,
    WholeImageNetwork,
    load_image_network,
    resize_network,
)
from roadtorch.road.bayes import ROAD_RULES, log_odds, seed_log_odds, segment_road
from roadtorch.road.ego import extrapolate_over_ego, find_ego_car
from roadtorch.road.seed_area import find_seed_segments
from train.calibrate import EXCLUDED, count_odds, cross_validated_f, f_by_level

SCALES = (0.67, 1.0, 1.33)
"""Sizes relative to that of the network's settings."""

PIXEL_WEIGHT = 4.0
"""Weight of the network's log odds by pixel against their mean over a superpixel."""

ALONE = "network alone"


class Variant(NamedTuple):
    """The cues that are used; the others are .5 everywhere."""

    layout: bool = True
    texture: bool = True
    distance: bool = True
    position: bool = True
    appearance: bool = True
    neighbours: bool = True


VARIANTS = {"all cues": Variant()} | {
    f"without {name}": Variant()._replace(**{name: False}) for name in Variant._fields
}


def compute_odds(
    image: Tensor, networks: Mapping[float, WholeImageNetwork]
) -> Iterator[tuple[str, Tensor, float]]:
    """Yield name, log odds (h, w) and seconds of each way to find the road of an image (3, h, w).

    networks: by scale.
    """
    settings = ScratchFusionSettings()
    for scale, network in networks.items():
        start = perf_counter()
        cues = compute_cues(network, image)
        seconds = perf_counter() - start
        yield f"network at {scale:g}" if scale != 1 else ALONE, network_odds(cues), seconds
        if scale == 1:
            learned, base = cues, seconds
    ego = find_ego_car(learned["ego"])
    start = perf_counter()
    planes = torch.cat([image, learned["layout"], learned["road"][None]])
    image, layout, road = extrapolate_over_ego(planes, ego).split([3, NUM_CLASSES, 1])
    image, segments, layout_rules = label_segments(image, settings.labeller, settings.superpixels)
    layout_network = segment_mean([*layout, road[0]], segments.labels, segments.pixels)
    weight, odds = settings.layout_weight, log_odds(layout_network[-1])
    ground = opinion_pool(layout_rules.T, layout_network[:NUM_CLASSES], weight)[HORIZONTAL]
    evidence = odds + seed_log_odds(segments, ground)
    sources = find_seed_segments(evidence, segments.row, segments.size, settings.seed_area.fraction)
    seed = sources[segments.labels]
    near, even, _ = seed_likelihoods(image, segments, seed, sources.nonzero()[:, 0])
    seconds = perf_counter() - start
    nothing = torch.full_like(near, 0.5)
    for name, variant in VARIANTS.items():
        exponents = ROAD_RULES.exponents._replace(
            appearance=ROAD_RULES.exponents.appearance * variant.appearance,
            neighbours=ROAD_RULES.exponents.neighbours * variant.neighbours,
        )
        position = ROAD_RULES.position._replace(
            weight=ROAD_RULES.position.weight * variant.position
        )
        rules = ROAD_RULES._replace(exponents=exponents, position=position)
        pairs = ((ground, variant.layout), (near, variant.distance), (even, variant.texture))
        likely, close, plain = (cue if on else nothing for cue, on in pairs)
        start = perf_counter()
        road_estimate = segment_road(segments, likely, close, plain, odds, rules)
        elapsed = base + seconds + perf_counter() - start
        total = paint_segments(log_odds(road_estimate), segments.labels)
        total = total + PIXEL_WEIGHT * log_odds(learned["road"])
        yield name, torch.where(ego, -torch.inf, total), elapsed


def network_odds(cues: Mapping[str, Tensor]) -> Tensor:
    """Return the network's log odds of road, -inf on the ego car."""
    return torch.where(find_ego_car(cues["ego"]), -torch.inf, log_odds(cues["road"]))


class OddsCounts(NamedTuple):
    """Pixels of n images by log odds (n, 2, levels + 1), and their seconds (n,)."""

    counts: np.ndarray
    seconds: np.ndarray


@torch.no_grad()
def count_images(many: Path, weights: str) -> tuple[dict[str, OddsCounts], np.ndarray]:
    """Count road and background by log odds of each way; return counts and cameras (n,)."""
    network = load_image_network(WeightsFile(file=weights), DEFAULT_WEIGHTS)
    size = (network.settings.height, network.settings.width)
    networks = {scale: resize_network(network, *scale_size(*size, scale)) for scale in SCALES}
    dataset, rows, cameras = open_dataset("folder", many), {}, []
    for item in tqdm([item for item in dataset.items if item.group not in EXCLUDED], disable=None):
        image, truth = dataset.read(item)
        small = resize_to_work(image, WorkingSize(pixels=256 * 192))
        planes = torch.stack([truth.valid, truth.road & truth.valid]).float()
        valid, road = resize_maps(planes, spatial_size(small)) > 0.5
        for name, odds, seconds in compute_odds(small, networks):
            counts = count_odds(odds, Truth(road, valid))
            rows.setdefault(name, []).append((counts, seconds))
        cameras.append(str(item.group))
    ways = {}
    for name, pairs in rows.items():
        counts, seconds = zip(*pairs, strict=True)
        ways[name] = OddsCounts(np.array(counts), np.array(seconds))
    return ways, np.array(cameras)


def score_table(counts: np.ndarray, cameras: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Compute F by camera and level with weights (n,) of the images."""
    weighted = counts * weights[:, None, None]
    return f_by_level(
        np.array([weighted[cameras == camera].sum(0) for camera in np.unique(cameras)])
    )


def main() -> None:
    parser = argparse.ArgumentParser(description="What each cue brings beside the network.")
    parser.add_argument("many", type=Path)
    parser.add_argument("--weights", default="")
    options = parser.parse_args()
    torch.set_num_threads(1)
    ways, cameras = count_images(options.many, options.weights)
    ones, *draws = sample_weights(cameras.tolist(), torch.Generator().manual_seed(35)).numpy()
    level = {
        name: score_table(result.counts, cameras, ones).mean(0).argmax()
        for name, result in ways.items()
    }
    means = {
        name: [score_table(result.counts, cameras, draw)[:, level[name]].mean() for draw in draws]
        for name, result in ways.items()
    }
    print("| | F | worst | against the network alone (95 %) | ms |\n|---|---|---|---|---|")
    for name, result in ways.items():
        f = cross_validated_f(score_table(result.counts, cameras, ones))
        less = np.array(means[name]) - np.array(means[ALONE])
        low, high = percentile_interval(torch.from_numpy(less))
        print(
            f"| {name} | {f.mean():.3f} | {f.min():.3f} | {less.mean():+.3f} "
            f"({low:+.3f} to {high:+.3f}) | {1000 * np.median(result.seconds):.1f} |"
        )


if __name__ == "__main__":
    main()
