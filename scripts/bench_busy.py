"""What a machine with other work makes of ``detect``: beside two processes that never rest.

    python scripts/bench.py --only busy
    python scripts/bench_busy.py torch 2 seen     # one way: loads torch, threads, others

Who loads torch settles how its threads wait for one another: a program that imports it first has
threads that spin for long, one that imports roadtorch first has threads that soon sleep, as in the
commands. `detect` takes no more threads than there are free cores ("seen"), or all ("unseen").
"""

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))  # for the scripts beside

WAYS = {
    "torch imported first, 2 threads": ("torch", 2, "seen"),
    "roadtorch imported first, 2 threads": ("roadtorch", 2, "seen"),
    "torch imported first, torch.set_num_threads(1)": ("torch", 1, "seen"),
    "torch imported first, 2 threads whoever else runs": ("torch", 2, "unseen"),
    "roadtorch imported first, 2 threads whoever else runs": ("roadtorch", 2, "unseen"),
}
BUSY = 2  # processes that never rest
SECONDS = 6.0  # of each way at most
MOST = 20  # calls


@contextmanager
def busy(processes: int) -> Iterator[None]:
    """So many processes that never rest, for the block."""
    words = [sys.executable, "-c", "while True: pass"]
    running = [subprocess.Popen(words) for _ in range(processes)]
    try:
        yield
    finally:
        for process in running:
            process.kill()
            process.wait()


def detect_for(first: str, threads: int, others: str) -> list[float]:
    """Milliseconds of each ``detect`` of ``fusion`` at 640×480."""
    __import__(first)
    import torch

    from roadtorch import load_detector, openmp  # before torch, unless ``first`` is torch
    from roadtorch.scenes.street import render_scene

    torch.set_num_threads(threads)
    if others == "unseen":
        setattr(openmp, "free_cores", lambda: threads)  # noqa: B010
    detector, image = load_detector("fusion"), render_scene(0, 480, 640).image.contiguous()
    times, end = [], time.perf_counter() + SECONDS
    while len(times) < MOST + 1 and (len(times) < 2 or time.perf_counter() < end):
        start = time.perf_counter()
        detector.detect(image)
        times.append(1000 * (time.perf_counter() - start))
    return times[1:]


def run(first: str, threads: int, others: str) -> list[float]:
    """``detect_for`` in a new process in whose environment nothing is said of threads."""
    rest = {k: v for k, v in os.environ.items() if not k.startswith(("OMP_", "GOMP_", "MKL_"))}
    words = [sys.executable, str(Path(__file__)), first, str(threads), others]
    return json.loads(subprocess.check_output(words, text=True, env=rest).splitlines()[-1])


def measure_busy(threads: int, rounds: int) -> list[dict[str, object]]:
    """Every way, alone and beside the busy processes."""
    from scripts.bench_figures import figure
    from scripts.bench_parts import shown

    figures = []
    for row, way in WAYS.items():
        alone = run(*way)
        with busy(BUSY):
            beside = run(*way)
        figures += [
            shown("busy", row, "alone, ms", alone),
            shown("busy", row, f"beside {BUSY} busy processes, ms", beside),
            figure("busy", row, "calls counted beside them", len(beside), "kernels"),
        ]
    return figures


PARTS = {"busy": measure_busy}

if __name__ == "__main__":
    print(json.dumps(detect_for(sys.argv[1], int(sys.argv[2]), sys.argv[3])))
