"""Time all detectors, their stages and their peers: the figures of docs/performance.md.

    python scripts/bench.py --write docs/performance.md              # all parts: ten minutes
    python scripts/bench.py --only stages,networks --threads 1       # some of them
    python scripts/bench.py --resume --write docs/performance.md     # what this commit lacks
    python scripts/bench.py --check docs/performance.md              # is the page as measured?

Every part runs in a process of its own for each number of threads, takes about a minute at most,
and is kept in docs/performance.json as soon as it is there. Within a part each round runs every
contestant once, in an order that moves on by one from round to round; figures are medians
over the rounds, with quartiles in the file. A ratio is the median of the rounds' ratios: what
slows the whole machine for a while slows both sides of it. Other work on the same cores does not:
threads that wait for one another suffer far more than code on one thread.

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
from datetime import date
from functools import wraps
from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from types import ModuleType
from typing import Any
from unittest.mock import patch

import cv2
import numpy as np
import torch
from torch import Tensor
from tqdm import tqdm

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # for the scripts beside

from roadtorch import detector
from roadtorch.detectors import fusion
from roadtorch.imaging import resize as working_size
from roadtorch.io.image import read_image
from roadtorch.layout.picture_network import PictureNetwork
from roadtorch.scenes.street import render_scene
from roadtorch.superpixels import slic as superpixels
from scripts.bench_figures import Figure, Parts, merged, read_figures, rewrite, stale, write_figures

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

WARM_UP = 2  # rounds that are not counted

SUM = "sum of the stages"

ROOT = Path(__file__).resolve().parents[1]

FIGURES = ROOT / "docs" / "performance.json"

ALONE = {
    "start": "scripts.bench_start",
    "first": "scripts.bench_start",
    "training-pictures": "scripts.bench_training",
    "training-patches": "scripts.bench_training",
    "size": "scripts.bench_size",
}
"""The parts that start processes of their own and say there how many threads those have."""

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
        "torchvision": version("torchvision"),
        "scikit-image": version("scikit-image"),
        "commit": commit(),
    }


def cores() -> int | None:
    """Cores this process may use; where the system does not tell, all there are."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()


def commit(root: Path = ROOT) -> str | None:
    """The commit of a checkout, ``+`` where files differ from it; None without git."""
    command = ["git", "-C", str(root), "describe", "--always", "--dirty=+", "--exclude=*"]
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


def part_names() -> list[str]:
    """All parts, in the order of their tables."""
    return [*all_parts(), *ALONE]


def all_parts() -> Parts:
    """The parts that are measured once for each number of threads."""
    from scripts import bench_parts, bench_stages

    return {**bench_parts.PARTS, **bench_stages.PARTS}


def measured(part: str, threads: int, rounds: int) -> list[Figure]:
    """The figures of one part, measured in this process."""
    if part in ALONE:
        return import_module(ALONE[part]).PARTS[part](threads, rounds)
    torch.set_num_threads(threads)
    cv2.setNumThreads(threads)
    return all_parts()[part](threads, rounds)


def child(part: str, threads: int, rounds: int) -> list[Figure]:
    """The figures of one part, measured in a process of its own, with what made them."""
    words = ["--only", part, "--threads", str(threads)]
    load = round(os.getloadavg()[0], 1)
    done = subprocess.run(
        [sys.executable, str(Path(__file__)), *words, "--rounds", str(rounds), "--in-process"],
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    made = made_by(" ".join(["python scripts/bench.py", *words]), threads, rounds, load)
    return [made | one for one in json.loads(done.stdout.splitlines()[-1])]


def made_by(command: str, threads: int, rounds: int, load: float) -> Figure:
    """What every figure of a run says of it."""
    return {
        "rounds": rounds,
        "threads": threads,
        "command": command,
        "date": date.today().isoformat(),
        "machine": machine_in_words(),
        "commit": commit(),
        "load": load,
    }


def machine_in_words() -> str:
    """Processor, cores and torch, as figures name them."""
    return f"{cores()} cores, {processor()}, torch {torch.__version__.partition('+')[0]}"


def processor() -> str:
    """The processor's name, where the system tells it; else its architecture."""
    told = Path("/proc/cpuinfo")
    lines = told.read_text().splitlines() if told.is_file() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()


def runs(given: argparse.Namespace) -> list[tuple[str, int]]:
    """The parts that are asked for, each with its threads; what measures itself has one run."""
    chosen = given.only or part_names()
    return [
        (part, threads)
        for part in chosen
        for threads in (given.threads[:1] if part in ALONE else given.threads)
    ]


def names_of_parts(text: str) -> list[str]:
    """``stages,start`` → names of parts."""
    chosen = text.split(",")
    if unknown := [name for name in chosen if name not in part_names()]:
        raise argparse.ArgumentTypeError(f"{unknown[0]}: give some of {', '.join(part_names())}")
    return chosen


def thread_counts(text: str) -> list[int]:
    """``1,2`` → [1, 2]."""
    return [positive(part) for part in text.split(",")]


def arguments() -> argparse.Namespace:
    """What the command line asks for."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", type=names_of_parts, help="some parts, such as stages,start")
    parser.add_argument("--threads", type=thread_counts, default=[1, 2])
    parser.add_argument("--rounds", type=positive, default=20, help="counted rounds")
    parser.add_argument("--json", type=Path, default=FIGURES, help="where figures are kept")
    parser.add_argument("--resume", action="store_true", help="skip what this commit has measured")
    parser.add_argument("--write", type=Path, help="put the tables into this page")
    parser.add_argument("--check", type=Path, help="measure nothing: is this page as measured?")
    parser.add_argument("--in-process", action="store_true", help=argparse.SUPPRESS)
    return parser.parse_args()


def measure_all(given: argparse.Namespace) -> None:
    """Measure the parts in turn, and keep each as soon as it is there."""
    for part, threads in runs(given):
        figures, now = read_figures(given.json), commit()
        own = [one for one in figures if is_of(one, part, threads) and one["commit"] == now]
        if given.resume and own:
            continue
        start = time.monotonic()
        new = child(part, threads, given.rounds)
        write_figures(given.json, merged(figures, new, new[0]["command"]))
        print(f"{part}, threads {threads}: {time.monotonic() - start:.0f} s", file=sys.stderr)


def is_of(one: Figure, part: str, threads: int) -> bool:
    """Whether a figure comes from the run of a part on so many threads."""
    return one["command"].endswith(f"--only {part} --threads {threads}")


def main() -> int:
    """Measure, write or check; 1 where the page says something else than the figures."""
    given = arguments()
    if given.check:
        faults = stale(given.check.read_text("utf-8"), read_figures(given.json))
        print("\n".join(f"{given.check}: {fault}" for fault in faults), end="\n" if faults else "")
        return 1 if faults else 0
    if given.in_process:
        print(json.dumps(measured(given.only[0], given.threads[0], given.rounds)))
        return 0
    measure_all(given)
    if given.write:
        rewrite(given.write, read_figures(given.json))
    return 0


if __name__ == "__main__":
    sys.exit(main())
