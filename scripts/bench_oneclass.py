"""Time the one-class classifiers beside scikit-learn's, interleaved in one process.

    python scripts/bench_oneclass.py
    python scripts/bench_oneclass.py --picture street.jpg --rounds 30 --json oneclass.json

scikit-learn comes with the test extra (`scripts/test.sh` installs it).

First part: fit to the samples of one picture, about 90, and score all of its pixels, both
sides on the same float32 samples and pixels, each pixel scored (no distinct colours). Every
round runs all pairs once; ratios are medians over the rounds of theirs over ours. A timed call
follows one of its own kind, for otherwise ours would start on caches that a peer has filled,
and a peer on caches that ours has hardly touched.

Second part: the whole grid of classifiers and representations on one picture, its planes and
superpixels made once.
"""

import argparse
import json
import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from sklearn.cluster import KMeans
from sklearn.covariance import EmpiricalCovariance, MinCovDet
from sklearn.decomposition import PCA
from sklearn.mixture import GaussianMixture
from sklearn.neighbors import NearestNeighbors
from sklearn.svm import OneClassSVM
from threadpoolctl import threadpool_limits
from torch import Tensor
from tqdm import tqdm

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # for the rendered scenes

from roadtorch.detector import Detector
from roadtorch.detectors.oneclass import ENTRIES
from roadtorch.errors import RoadtorchError
from roadtorch.imaging.color import REPRESENTATIONS, planes
from roadtorch.oneclass import CLASSIFIERS, axes_of, fit
from roadtorch.oneclass.samples import SampleSettings, road_samples
from roadtorch.runtime.image_cache import image_cache
from scripts.bench import machine, picture_at, positive, sizes

SHOWN = ("S", "HS", "RGB")
WARM_UP = 1

Score = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""A peer: fit to samples (m,d) and score pixels (n,d)."""


def best_mixture(samples: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    fitted = [GaussianMixture(number, random_state=0).fit(samples) for number in range(1, 7)]
    return min(fitted, key=lambda mixture: mixture.bic(samples)).score_samples(pixels)


def residual(samples: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    fitted = PCA(max(1, samples.shape[1] - 1)).fit(samples)
    back = fitted.inverse_transform(fitted.transform(pixels))
    return np.square(pixels - back).sum(1)


def nearest_mean(samples: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    options: dict[str, Any] = {"n_init": 10, "random_state": 0}
    return KMeans(5, **options).fit(samples).transform(pixels).min(1)


BALL: dict[str, Any] = {"nu": 0.025, "gamma": 1 / 25}
"""The settings of SVDD: sigma 5, 2.5 % rejected."""

PEERS: dict[str, Score] = {
    "nn": lambda s, p: NearestNeighbors(n_neighbors=1).fit(s).kneighbors(p)[0][:, 0],
    "gaussian": lambda s, p: EmpiricalCovariance().fit(s).mahalanobis(p),
    "robust_gaussian": lambda s, p: (
        MinCovDet(support_fraction=0.975, random_state=0).fit(s).mahalanobis(p)
    ),
    "mog2": lambda s, p: GaussianMixture(2, random_state=0).fit(s).score_samples(p),
    "mog4": lambda s, p: GaussianMixture(4, random_state=0).fit(s).score_samples(p),
    "mog_opt": best_mixture,
    "svdd": lambda s, p: OneClassSVM(**BALL).fit(s).score_samples(p),
    "pca": residual,
    "kmeans": nearest_mean,
}
"""scikit-learn's classifier of the same kind. Its mixtures have one start, ours five."""


def pairs(image: Tensor, representation: str) -> dict[tuple[str, str], Callable[[], Any]]:
    """Ours and theirs of every classifier with a peer, ready to run, on one picture."""
    names = REPRESENTATIONS[representation]
    axes, samples = axes_of(names), road_samples(image, names, SampleSettings())
    pixels = planes(image, names).flatten(1).T
    rows = np.ascontiguousarray(pixels.numpy())
    calls: dict[tuple[str, str], Callable[[], Any]] = {}
    for name, peer in PEERS.items():
        classifier = CLASSIFIERS[name]
        if classifier.refuses(len(names)):
            continue
        calls[name, "ours"] = lambda c=classifier: fit(c, samples, axes).score(pixels)
        calls[name, "theirs"] = lambda p=peer: p(samples.numpy(), rows)
    return calls


def milliseconds(call: Callable[[], Any]) -> float:
    start = time.perf_counter()
    call()
    return (time.perf_counter() - start) * 1000


def compare(image: Tensor, representation: str, rounds: int) -> dict[str, dict[str, float]]:
    """Median milliseconds of ours and theirs, median and fastest ratio, by classifier."""
    calls = list(pairs(image, representation).items())
    times: dict[tuple[str, str], list[float]] = {key: [] for key, _ in calls}
    for number in tqdm(range(WARM_UP + rounds), representation, leave=False, file=sys.stderr):
        # Two by two, so that both sides of a ratio see the same load.
        turn = 2 * (number % (len(calls) // 2))
        for key, call in calls[turn:] + calls[:turn]:
            call()
            spent = milliseconds(call)
            if number >= WARM_UP:
                times[key].append(spent)
    figures = {}
    for name in dict.fromkeys(name for name, _ in times):
        ours, theirs = times[name, "ours"], times[name, "theirs"]
        figures[name] = {
            "ours": statistics.median(ours),
            "theirs": statistics.median(theirs),
            "ratio": statistics.median(b / a for a, b in zip(ours, theirs, strict=True)),
            "fastest": min(theirs) / min(ours),
        }
    return figures


def table(representation: str, figures: dict[str, dict[str, float]]) -> str:
    lines = [
        f"| {representation} | ours, ms | scikit-learn, ms | ratio | of the fastest |",
        "|---|---:|---:|---:|---:|",
    ]
    for name, value in figures.items():
        lines.append(
            f"| {name} | {value['ours']:.1f} | {value['theirs']:.1f} "
            f"| {value['ratio']:.1f} | {value['fastest']:.1f} |"
        )
    return "\n".join(lines)


def time_grid(image: Tensor, rounds: int) -> dict[str, float]:
    """Seconds for every detector on one picture: median, fastest, and processor time."""
    detectors = [Detector(entry, entry.settings()) for entry in ENTRIES]
    wall, processor = [], []
    for number in tqdm(range(WARM_UP + rounds), "grid", leave=False, file=sys.stderr):
        start, used = time.perf_counter(), time.process_time()
        with image_cache():
            for detector in detectors:
                detector.detect(image)
        if number >= WARM_UP:
            wall.append(time.perf_counter() - start)
            processor.append(time.process_time() - used)
    return {
        "detectors": len(detectors),
        "median": statistics.median(wall),
        "fastest": min(wall),
        "processor": statistics.median(processor),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--picture", type=Path, help="a street picture (default: a rendered one)")
    parser.add_argument("--sizes", type=sizes, default="640x480,480x360", help="of both parts")
    parser.add_argument("--rounds", type=positive, default=20, help="counted rounds")
    parser.add_argument("--grid-rounds", type=positive, default=3, help="of the whole grid")
    parser.add_argument("--threads", type=positive, default=2)
    parser.add_argument("--json", type=Path, help="write all figures to this file")
    given = parser.parse_args()
    torch.set_num_threads(given.threads)
    threadpool_limits(given.threads)
    if len(given.sizes) != 2:
        parser.error("--sizes: give two, for the pixels to score and for the grid")
    try:
        image, small = (picture_at(given.picture, *size) for size in given.sizes)
    except RoadtorchError as problem:
        parser.error(str(problem))
    results: dict[str, Any] = {"machine": machine()}
    print(", ".join(f"{name}: {value}" for name, value in results["machine"].items()))
    for representation in SHOWN:
        results[representation] = compare(image, representation, given.rounds)
        print(f"\n{table(representation, results[representation])}", flush=True)
    # With the levels of a file, as pictures have them.
    grid = time_grid((small * 255).round() / 255, given.grid_rounds)
    results["grid"] = grid
    size = "x".join(map(str, given.sizes[1]))
    print(
        f"\nThe grid of {grid['detectors']} detectors at {size}: {grid['median']:.1f} s, "
        f"fastest {grid['fastest']:.1f} s, processor time {grid['processor']:.1f} s"
    )
    if given.json:
        given.json.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
