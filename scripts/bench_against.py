"""Time detectors in two checkouts of roadtorch, in turn in one process.

    git worktree add /tmp/before main
    python scripts/bench_against.py /tmp/before
    python scripts/bench_against.py /tmp/before fusion ufl --size 960x720 --rounds 40

Both are loaded beside each other and every round runs both; the one that begins changes from round
to round. A ratio is the median of the rounds' ratios, this checkout's time over the other's. All
runs on one thread; ``--clock process`` counts the process's own time, which other work on the
same cores lengthens but little.
"""

import argparse
import importlib
import sys
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from statistics import median
from types import ModuleType

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # for the scripts beside

import torch
from torch import Tensor

from roadtorch.scenes.street import render_scene
from scripts.bench import WARM_UP, ratio, size

HERE = Path(__file__).resolve().parents[1]
CLOCKS = {"wall": time.perf_counter, "process": time.process_time}

Detect = Callable[[Tensor], object]


def detectors_of(root: Path, names: Sequence[str]) -> dict[str, Detect]:
    """``detect`` of a checkout's own detectors; modules that are loaded stay loaded."""

    def loaded() -> dict[str, ModuleType]:
        ours = [name for name in sys.modules if name.partition(".")[0] == "roadtorch"]
        return {name: sys.modules[name] for name in ours}

    others = loaded()
    for name in others:
        del sys.modules[name]
    sys.path.insert(0, str(root))
    try:
        catalogue = importlib.import_module("roadtorch.detectors.catalogue")
        found = {name: catalogue.load_detector(name).detect for name in names}
        image = render_scene(0).image
        for detect in found.values():
            detect(image)  # what is imported late is this checkout's own, too
        return found
    finally:
        sys.path.remove(str(root))
        for name in loaded():
            del sys.modules[name]
        sys.modules.update(others)


def in_turn(
    calls: Sequence[Callable[[], object]], rounds: int, clock: Callable[[], float]
) -> list[list[float]]:
    """Milliseconds of every call, a number a counted round."""
    times: list[list[float]] = [[] for _ in calls]
    for number in range(WARM_UP + rounds):
        order = list(range(len(calls)))
        for place in order[::-1] if number % 2 else order:
            start = clock()
            calls[place]()
            if number >= WARM_UP:
                times[place].append((clock() - start) * 1000)
    return times


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("before", type=Path, help="the other checkout")
    parser.add_argument("detectors", nargs="*", default=["fusion"])
    parser.add_argument("--size", type=size, default=(640, 480), help="of the rendered street")
    parser.add_argument("--rounds", type=int, default=20)
    parser.add_argument("--clock", choices=CLOCKS, default="wall")
    given = parser.parse_args()
    torch.set_num_threads(1)
    width, height = given.size
    image = render_scene(0, height, width).image.contiguous()
    before, now = (detectors_of(root.resolve(), given.detectors) for root in (given.before, HERE))
    print("| | before, ms | now, ms | ratio |\n|---|---:|---:|---:|")
    for name in given.detectors:
        calls = [partial(one[name], image) for one in (before, now)]
        old, new = in_turn(calls, given.rounds, CLOCKS[given.clock])
        print(f"| {name} | {median(old):.1f} | {median(new):.1f} | {ratio(new, old):.2f} |")


if __name__ == "__main__":
    main()
