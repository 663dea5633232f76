"""Time every stage of the detector ``ufl``, and what its matrix products reach.

    python scripts/bench_ufl.py
    python scripts/bench_ufl.py --picture street.jpg --rounds 40 --json ufl.json

Each round runs every contestant once, as in ``bench.py``: the stages inside ``detect``, ``detect``
as a whole, the bare matrix products of K-means and of encoding in the same blocks, and one large
product of square matrices, for the rate that the machine can give. On a busy machine, take one
thread and the time that the processor spent on it: ``--threads 1 --clock processor``.
"""

import argparse
import json
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import torch
from torch import Tensor

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # for the rendered scenes

from roadtorch import detector
from roadtorch.detectors import ufl
from roadtorch.detectors.catalogue import load_detector
from roadtorch.errors import RoadtorchError
from roadtorch.ufl import features, learned, maps
from scripts.bench import (
    SUM,
    Clock,
    Round,
    Stages,
    machine,
    picture_at,
    positive,
    run_rounds,
    sizes,
    summary,
    table,
    time_call,
    time_stages,
)

KMEANS, ENCODING = "K-means", "encode and select"
STAGES: Stages = {
    "check the image": ((detector, "checked_image"),),
    "resize to the working size": ((ufl, "bicubic"),),
    "blur and equalise": ((learned, "equalised"),),
    "patches and whitening": ((learned, "white_patches"),),
    KMEANS: ((learned, "learn_dictionary"),),
    ENCODING: ((learned, "select_maps"),),
    "mean map": ((ufl, "mean_map"),),
    "regions": ((ufl, "threshold_regions"),),
    "tree": ((ufl, "build_tree"),),
    "two iterations": ((ufl, "find_road"),),
    "masks": ((ufl, "widened"), (ufl, "mask_to_image"), (ufl, "remove_isolated")),
    "pictures of the stages": (
        (ufl, "dictionary_picture"),
        (ufl, "mosaic"),
        (ufl, "map_pictures"),
        (ufl, "map_to_image"),
    ),
    "back to full size": ((ufl, "enlarged_likelihood"),),
    "decide": ((detector, "decide"),),
}
"""The functions that make up each stage, by the module in which ``ufl`` looks them up."""

UFL, LARGE = "ufl, end to end", "a large product"
KMEANS_BARE, ENCODING_BARE = "bare products of K-means", "bare products of encoding"
RATIOS = {
    f"{KMEANS_BARE} / {KMEANS}": (KMEANS_BARE, KMEANS),
    f"{ENCODING_BARE} / {ENCODING}": (ENCODING_BARE, ENCODING),
}
CLOCKS: dict[str, Clock] = {"wall": time.perf_counter, "processor": time.process_time}
SIDE = 1024
"""Of the square matrices of the large product: far beyond the size where a call costs anything."""


def patches_of(image: Tensor) -> Tensor:
    """The white patches (n,d) from which ``ufl`` learns."""
    settings = ufl.UflSettings()
    small = ufl.bicubic(image, settings.working.size(image.shape[1], image.shape[2]))
    return features.white_patches(learned.equalised(small, settings.smoothing), settings.dictionary)


def kmeans_products(patches: Tensor, bases: Tensor, rounds: int) -> None:
    """What K-means multiplies, and nothing else."""
    for _ in range(rounds):
        for block in patches.split(features.BLOCK):
            torch.mm(block, bases.T)


def encoding_products(patches: Tensor, bases: Tensor, kept: int) -> None:
    """What encoding multiplies: all bases in blocks, and the selected ones once more."""
    for block in (*bases.split(maps.BLOCK), bases[:kept]):
        torch.mm(block, patches.T)


def products(image: Tensor) -> dict[str, tuple[Callable[[], Any], float]]:
    """The bare products by name, with their floating-point operations."""
    settings = ufl.UflSettings()
    rounds, bases = settings.dictionary.rounds, settings.dictionary.bases
    kept = maps.selected_count(bases, settings.maps.share)
    patches = patches_of(image)
    points = maps.make_encoder(patches, patches[:bases]).points
    square = torch.ones(SIDE, SIDE)
    each = 2.0 * bases * patches.shape[0] * patches.shape[1]
    twice = 2.0 * (bases + kept) * points.shape[0] * points.shape[1]
    return {
        KMEANS_BARE: (partial(kmeans_products, patches, patches[:bases], rounds), rounds * each),
        ENCODING_BARE: (partial(encoding_products, points, points[:bases], kept), twice),
        LARGE: (lambda: square @ square, 2.0 * SIDE**3),
    }


def contestants(image: Tensor, clock: Clock) -> list[Callable[[], Round]]:
    """What is timed once a round."""
    detect = load_detector("ufl").detect
    bare = [partial(time_call, name, call, clock) for name, (call, _) in products(image).items()]
    return [
        partial(time_stages, detect, image, STAGES, clock),
        partial(time_call, UFL, partial(detect, image), clock),
        *bare,
    ]


def rates(milliseconds: dict[str, dict[str, float]], work: dict[str, float]) -> str:
    """GFLOP/s of the median and of the fastest round, and their share of the large product's."""
    reached = {
        name: [operations / milliseconds[name][key] / 1e6 for key in ("median", "fastest")]
        for name, operations in work.items()
    }
    lines = ["| GFLOP/s | median | fastest | share of the large product |", "|---|---:|---:|---:|"]
    for name, (median, fastest) in reached.items():
        shares = [value / top for value, top in zip((median, fastest), reached[LARGE], strict=True)]
        lines.append(
            f"| {name} | {median:.0f} | {fastest:.0f} | {shares[0]:.2f}, {shares[1]:.2f} |"
        )
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--picture", type=Path, help="a street picture (default: a rendered one)")
    parser.add_argument("--sizes", type=sizes, default="160x120", help="width x height, …")
    parser.add_argument("--rounds", type=positive, default=20, help="counted rounds")
    parser.add_argument("--threads", type=positive, default=2)
    parser.add_argument("--clock", choices=CLOCKS, default="wall", help="what is measured")
    parser.add_argument("--json", type=Path, help="write all figures to this file")
    given = parser.parse_args()
    torch.set_num_threads(given.threads)
    cv2.setNumThreads(given.threads)
    results: dict[str, Any] = {"machine": machine() | {"clock": given.clock}, "sizes": {}}
    print(", ".join(f"{name}: {value}" for name, value in results["machine"].items()))
    for width, height in given.sizes:
        try:
            image = picture_at(given.picture, width, height)
        except RoadtorchError as problem:
            parser.error(str(problem))
        size = f"{width}x{height}"
        counted = run_rounds(contestants(image, CLOCKS[given.clock]), given.rounds, size)
        bare = {name: operations for name, (_, operations) in products(image).items()}
        work = {KMEANS: bare[KMEANS_BARE], ENCODING: bare[ENCODING_BARE], **bare}
        figures = summary(counted, [*STAGES, SUM, UFL, *bare], RATIOS)
        results["sizes"][size] = figures | {"rounds": counted, "operations": work}
        print(f"\n{table(size, figures)}\n\n{rates(figures['ms'], work)}", flush=True)
    if given.json:
        given.json.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
