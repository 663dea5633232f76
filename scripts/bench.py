"""Time every stage of the detector ``fusion`` beside its peers, interleaved in one process.

    python scripts/bench.py
    python scripts/bench.py --picture street.jpg --sizes 640x480,960x720 --rounds 40 --json t.json

Each round runs every contestant once, in an order that moves on by one from round to round;
figures are medians over the rounds with quartiles, and the fastest round. A ratio is the
median of the rounds' ratios: what slows the whole machine for a while slows both sides of it.
Other work on the same cores does not: threads that wait for one another suffer far more than
code on one thread. On a busy machine only the fastest rounds say something.

The stages are timed inside ``detect`` itself, by a stopwatch around the functions it calls.
"""

import argparse
import json
import os
import platform
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from functools import partial, wraps
from importlib.metadata import version
from pathlib import Path
from types import ModuleType
from typing import Any
from unittest.mock import patch

import cv2
import numpy as np
import skimage
import torch
from torch import Tensor
from tqdm import tqdm

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # for the scripts beside

from roadtorch import detector, superpixels, working_size
from roadtorch.detectors import fusion
from roadtorch.detectors.catalogue import load_detector
from roadtorch.errors import RoadtorchError
from roadtorch.image import read_image
from roadtorch.layout.picture_network import PictureNetwork
from roadtorch.scenes import render_scene
from roadtorch.superpixels import slic
from scripts.torchvision_shim import torchvision

Stages = Mapping[str, tuple[tuple[ModuleType | type, str], ...]]
STAGES: Stages = {
    "check the image": ((detector, "checked_image"),),
    "resize to the working size": ((working_size, "resized"),),
    "network": ((PictureNetwork, "cues"),),
    "brighten": ((fusion, "brightened"),),
    "superpixels": ((superpixels, "slic"),),
    "measure": ((fusion, "measure_segments"),),
    "layout": ((fusion, "segment_layout"), (fusion, "decide_layout")),
    "texture": ((fusion, "unsaturated_uniformity"), (fusion, "uniformity_likelihood")),
    "distance": ((fusion, "seed_distance"), (fusion, "distance_likelihood")),
    "road": ((fusion, "segment_road"),),
    "pool": (
        (fusion, "segment_mean"),
        (fusion, "pooled"),
        (fusion, "log_odds"),
        (fusion, "fused_log_odds"),
        (fusion, "calibrated"),
    ),
    "ego car and seed": (
        (fusion, "ego_found"),
        (fusion, "continued"),
        (fusion, "likely_seed"),
    ),
    "paint": ((fusion, "road_place"), (fusion, "paint")),
    "back to full size": ((working_size, "at_picture_size"),),
    "decide": ((detector, "decide"),),
}
"""The functions that make up each stage, by the module in which ``fusion`` looks them up."""

SEGMENTS = 400
WARM_UP = 2  # rounds that are not counted
QUICK = 5  # rounds of --quick

FUSION, LRASPP = "fusion, end to end", "lraspp_mobilenet_v3_large"
OURS, THEIRS = f"roadtorch slic, {SEGMENTS} segments", f"skimage slic, {SEGMENTS} segments"
SUM = "sum of the stages"
RATIOS = {"fusion / lraspp": (FUSION, LRASPP), "skimage slic / our slic": (THEIRS, OURS)}

Clock = Callable[[], float]
"""Seconds, from any start."""
Round = dict[str, float]
"""Milliseconds by name: stages and contestants of one round."""


class Stopwatch:
    """Adds up the time of each stage; a call inside a stage belongs to that stage."""

    def __init__(self, clock: Clock) -> None:
        self.clock = clock
        self.times: Round = {}
        self.inside = False

    def around(self, stage: str, function: Callable[..., Any]) -> Callable[..., Any]:
        @wraps(function)
        def timed(*arguments: Any, **named: Any) -> Any:
            if self.inside:
                return function(*arguments, **named)
            self.inside = True
            start = self.clock()
            try:
                return function(*arguments, **named)
            finally:
                spent = (self.clock() - start) * 1000
                self.times[stage] = self.times.get(stage, 0.0) + spent
                self.inside = False

        return timed


@contextmanager
def stopwatch(stages: Stages, clock: Clock) -> Iterator[Round]:
    """Within the block, every stage adds its milliseconds to the result."""
    watch = Stopwatch(clock)
    with ExitStack() as stack:
        for stage, functions in stages.items():
            for module, name in functions:
                timed = watch.around(stage, getattr(module, name))
                stack.enter_context(patch.object(module, name, timed))
        yield watch.times


def time_stages(
    detect: Callable[[Tensor], Any],
    image: Tensor,
    stages: Stages = STAGES,
    clock: Clock = time.perf_counter,
) -> Round:
    """Milliseconds of each stage in one ``detect``; RuntimeError if a stage did not run."""
    with stopwatch(stages, clock) as times:
        detect(image)
    if missing := stages.keys() - times.keys():
        raise RuntimeError(f"detect no longer calls the functions of {', '.join(sorted(missing))}")
    return {stage: times[stage] for stage in stages} | {SUM: sum(times.values())}


def time_call(name: str, call: Callable[[], Any], clock: Clock = time.perf_counter) -> Round:
    start = clock()
    call()
    return {name: (clock() - start) * 1000}


def contestants(image: Tensor) -> list[Callable[[], Round]]:
    """What is timed once a round: the stages, ``fusion`` as users call it, and the peers."""
    torch.manual_seed(0)
    network = torchvision.models.segmentation.lraspp_mobilenet_v3_large(
        weights=None, weights_backbone=None
    ).eval()
    detect = load_detector("fusion").detect
    rows = np.ascontiguousarray(image.permute(1, 2, 0).numpy())

    @torch.inference_mode()
    def lraspp() -> Any:
        return network(image[None])

    skimage_slic = partial(skimage.segmentation.slic, rows, SEGMENTS, compactness=10)
    return [
        partial(time_stages, detect, image),
        partial(time_call, FUSION, partial(detect, image)),
        partial(time_call, LRASPP, lraspp),
        partial(time_call, OURS, partial(slic, image, SEGMENTS)),
        partial(time_call, THEIRS, skimage_slic),
    ]


def run_rounds(calls: Sequence[Callable[[], Round]], rounds: int, title: str) -> list[Round]:
    """The counted rounds of the contestants; each begins with the next one in turn."""
    counted = []
    for number in tqdm(range(WARM_UP + rounds), title, leave=False, file=sys.stderr):
        turn = number % len(calls)
        times: Round = {}
        for call in [*calls[turn:], *calls[:turn]]:
            times |= call()
        if number >= WARM_UP:
            counted.append(times)
    return counted


def spread(values: list[float]) -> dict[str, float]:
    """Median and quartiles."""
    low, high = np.percentile(values, [25, 75])
    return {"median": statistics.median(values), "low": float(low), "high": float(high)}


def summary(
    rounds: list[Round], names: Sequence[str], ratios: Mapping[str, tuple[str, str]]
) -> dict[str, dict[str, dict[str, float]]]:
    """Milliseconds by name, and ratios of two of them, over all rounds.

    The fastest of a ratio is that of the two fastest times, not the smallest ratio.
    """
    columns = {name: [times[name] for times in rounds] for name in rounds[0]}
    fastest = {name: min(values) for name, values in columns.items()}
    shares = {
        name: spread([times[over] / times[under] for times in rounds])
        | {"fastest": fastest[over] / fastest[under]}
        for name, (over, under) in ratios.items()
    }
    return {
        "ms": {name: spread(columns[name]) | {"fastest": fastest[name]} for name in names},
        "ratios": shares,
    }


def table(size: str, figures: dict[str, dict[str, dict[str, float]]]) -> str:
    """The figures of one size as a Markdown table."""
    lines = [f"| {size} | median | quartiles | fastest |", "|---|---:|---:|---:|"]
    for key, unit, digits in (("ms", " ms", 1), ("ratios", "", 2)):
        for name, value in figures[key].items():
            shown = {part: f"{number:.{digits}f}" for part, number in value.items()}
            lines.append(
                f"| {name} | {shown['median']}{unit} | {shown['low']} – {shown['high']} "
                f"| {shown['fastest']} |"
            )
    return "\n".join(lines)


def machine() -> dict[str, Any]:
    """What the figures depend on besides the code."""
    return {
        "cores": cores(),
        "load before": round(os.getloadavg()[0], 1) if hasattr(os, "getloadavg") else None,
        "architecture": platform.machine(),
        "python": platform.python_version(),
        "torch": torch.__version__,
        "torch threads": torch.get_num_threads(),
        "opencv threads": cv2.getNumThreads(),
        "torchvision": torchvision.__version__,
        "scikit-image": version("scikit-image"),
        "commit": commit(),
    }


def cores() -> int | None:
    """Cores this process may use; where the system does not tell, all there are."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()


def commit() -> str | None:
    """The commit of the code, ``+`` where files differ from it; None without git."""
    root = str(Path(__file__).resolve().parents[1])
    command = ["git", "-C", root, "describe", "--always", "--dirty=+", "--exclude=*"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return None
    return done.stdout.strip()


def sizes(text: str) -> list[tuple[int, int]]:
    """``640x480,960x720`` → [(640, 480), (960, 720)]: width and height, each at least 16."""
    try:
        pairs = [tuple(map(int, part.split("x"))) for part in text.split(",")]
    except ValueError:
        pairs = []
    if not pairs or any(len(pair) != 2 or min(pair) < 16 for pair in pairs):
        raise argparse.ArgumentTypeError(f"{text}: give sizes from 16x16 up, such as 640x480")
    return [(width, height) for width, height in pairs]


def positive(text: str) -> int:
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text}: give a whole number from 1 up")
    return int(text)


def picture_at(path: Path | None, width: int, height: int) -> Tensor:
    """The given picture at this size, or a rendered street."""
    if path is None:
        return render_scene(0, height, width).image.contiguous()
    return working_size.resized(read_image(path), (height, width)).clamp(0, 1)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--picture", type=Path, help="a street picture (default: a rendered one)")
    parser.add_argument("--sizes", type=sizes, default="640x480,960x720", help="width x height, …")
    parser.add_argument("--rounds", type=positive, default=20, help="counted rounds")
    parser.add_argument("--threads", type=positive, default=2)
    parser.add_argument("--json", type=Path, help="write all figures to this file")
    parser.add_argument("--quick", action="store_true", help=f"{QUICK} rounds: under a minute")
    given = parser.parse_args()
    torch.set_num_threads(given.threads)
    cv2.setNumThreads(given.threads)
    results: dict[str, Any] = {"machine": machine(), "sizes": {}}
    print(", ".join(f"{name}: {value}" for name, value in results["machine"].items()))
    rounds = QUICK if given.quick else given.rounds
    for width, height in given.sizes:
        size = f"{width}x{height}"
        try:
            image = picture_at(given.picture, width, height)
        except RoadtorchError as problem:
            parser.error(str(problem))
        counted = run_rounds(contestants(image), rounds, size)
        figures = summary(counted, [*STAGES, SUM, FUSION, LRASPP, OURS, THEIRS], RATIOS)
        results["sizes"][size] = figures | {"rounds": counted}
        print(f"\n{table(size, figures)}", flush=True)
    if given.json:
        given.json.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
