"""Time the stages of ``fusion`` in two checkouts of roadtorch, in turn in one process.

    git worktree add /tmp/before main
    python scripts/bench_against.py /tmp/before
    python scripts/bench_against.py /tmp/before --size 960x720 --rounds 40 --threads 2
    python scripts/bench_against.py /tmp/before --threads 2 --write docs/performance.md

Both are loaded beside each other and every round runs both; the one that begins changes from round
to round. A ratio is the median of the rounds' ratios, this checkout's time over the other's. On
one thread it is the process's own time that counts, which other work on the same cores lengthens
but little; on more it is the time on the clock.
"""

import argparse
import importlib
import os
import sys
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import NamedTuple

import cv2
import torch
from torch import Tensor

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # for the scripts beside

from scripts.bench import FIGURES, commit, made_by
from scripts.bench_figures import (
    Figure,
    figure,
    merged,
    part_table,
    read_figures,
    rewrite,
    write_figures,
)
from scripts.bench_parts import OURS as SLIC
from scripts.bench_parts import SEGMENTS, ratio, shown, threads_in_words
from scripts.bench_stages import FUSION

HERE = Path(__file__).resolve().parents[1]
OURS = ("roadtorch", "scripts")  # the packages that each checkout has its own of
PART = "before-after"
WARM_UP = 2  # rounds that are not counted

Clock = Callable[[], float]
"""Seconds, from any start."""

Round = dict[str, float]
"""Milliseconds by stage."""


class Checkout(NamedTuple):
    """What is timed of a checkout: its bench, its detector and its superpixels."""

    bench: ModuleType
    detect: Callable[[Tensor], object]
    slic: Callable[..., Tensor]


def checkout_of(root: Path) -> Checkout:
    """A checkout's own modules; those that are loaded stay loaded."""

    def loaded() -> dict[str, ModuleType]:
        return {name: sys.modules[name] for name in sys.modules if name.partition(".")[0] in OURS}

    others = loaded()
    for name in others:
        del sys.modules[name]
    sys.path.insert(0, str(root))
    try:
        bench = importlib.import_module("scripts.bench")
        catalogue = importlib.import_module("roadtorch.detectors.catalogue")
        superpixels = importlib.import_module("roadtorch.superpixels.slic")
        return Checkout(bench, catalogue.load_detector("fusion").detect, superpixels.slic)
    finally:
        sys.path.remove(str(root))
        for name in loaded():
            del sys.modules[name]
        sys.modules.update(others)


def time_once(checkout: Checkout, image: Tensor, clock: Clock) -> Round:
    """All stages inside one ``detect``, another as a whole, and the superpixels of the picture."""
    bench, detect, slic = checkout
    times = bench.time_stages(detect, image, clock=clock)
    times |= bench.time_call(FUSION, partial(detect, image), clock)
    return times | bench.time_call(SLIC, partial(slic, image, SEGMENTS), clock)


def in_turn(
    checkouts: Sequence[Checkout], image: Tensor, rounds: int, threads: int
) -> list[list[Round]]:
    """The counted rounds, each with the times of every checkout in the order given."""
    clock = time.process_time if threads == 1 else time.perf_counter
    calls = [partial(time_once, checkout, image, clock) for checkout in checkouts]
    counted = []
    for number in range(WARM_UP + rounds):
        turn = number % 2
        found = [call() for call in (calls[::-1] if turn else calls)]
        if number >= WARM_UP:
            counted.append(found[::-1] if turn else found)
    return counted


def figures_of(
    rounds: Sequence[Sequence[Round]], commits: Sequence[str], words: str
) -> list[Figure]:
    """Medians of both and of their ratios, a row a stage.

    commits: of the checkouts; words: how many threads.
    """
    columns = [f"before, ms, {words}", f"now, ms, {words}"]
    found = [figure(PART, "commit", *both) for both in zip(columns, commits, strict=True)]
    for name in rounds[0][0]:
        before, now = ([both[place][name] for both in rounds] for place in (0, 1))
        found += [
            shown(PART, name, columns[0], before),
            shown(PART, name, columns[1], now),
            shown(PART, name, f"ratio, {words}", ratio(now, before), ""),
        ]
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("before", type=Path, help="the other checkout")
    parser.add_argument("--size", default="640x480", help="width x height of a rendered street")
    parser.add_argument("--rounds", type=int, default=20)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--write", type=Path, help="keep the figures, and show them in this page")
    given = parser.parse_args()
    torch.set_num_threads(given.threads)
    cv2.setNumThreads(given.threads)
    load = round(os.getloadavg()[0], 1)
    before, now = (checkout_of(root.resolve()) for root in (given.before, HERE))
    ((width, height),) = now.bench.sizes(given.size)
    image = now.bench.picture_at(None, width, height)
    rounds = in_turn([before, now], image, given.rounds, given.threads)
    command = f"python scripts/bench_against.py BEFORE --threads {given.threads}"
    made = made_by(command, given.threads, given.rounds, load)
    commits = [commit(root) or "unknown" for root in (given.before, HERE)]
    found = figures_of(rounds, commits, threads_in_words(given.threads))
    found = [made | one for one in found]
    print(part_table(found, PART))
    if given.write:
        figures = merged(read_figures(FIGURES), found, made["command"])
        write_figures(FIGURES, figures)
        rewrite(given.write, figures)


if __name__ == "__main__":
    main()
