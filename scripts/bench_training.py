"""Samples a second of a training, what share of the time its network has, and what a process adds.

    python scripts/bench.py --only training-pictures,training-patches
    python scripts/bench_training.py pictures PREPARED        # one process; under torchrun, several

Rendered streets are made ready as `roadtorch train` does it, then batches are made and trained on
for a few seconds. The network's share is that of its step: forward, backward, the exchange with
other processes and the optimiser; the rest goes into reading and varying pictures.
"""

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # for the scripts beside

from roadtorch.cli.group import BRIEF_WAITS
from roadtorch.runtime.signals import stop_on_signals
from roadtorch.scenes.street import render_scene
from roadtorch.train.config import PatchTraining, PictureTraining, Training
from roadtorch.train.folder import RunFolder
from roadtorch.train.loop import (
    AverageWeights,
    Batch,
    RunContext,
    TrainingSetup,
    make_optimiser,
    step,
)
from roadtorch.train.prepared import write_arrays
from roadtorch.train.processes import join_processes
from roadtorch.train.run import recipe_of

KINDS: dict[str, Training] = {"pictures": PictureTraining(), "patches": PatchTraining()}
PICTURES = 16
SECONDS = 6.0
WARM_UP = 2  # batches
TURNS = 2  # of all ways of running


def prepare(kind: str, folder: Path) -> None:
    """Rendered streets, made ready for a kind of training."""
    recipe = recipe_of(KINDS[kind])
    for number in range(PICTURES):
        made = recipe.make(render_scene(number, 240, 320).image, f"{number}.png")
        write_arrays(folder / f"{number:02}.npz", made)


def endless(samples: Any) -> Iterator[Batch]:
    """All batches, epoch after epoch."""
    epoch = 0
    while True:
        for chunk in range(samples.chunks):
            yield from samples.batches(epoch, chunk)
        epoch += 1


def train_for(kind: str, prepared: Path, seconds: float) -> dict[str, float]:
    """Samples a second of all processes, and the share of the steps in the time of this one."""
    recipe = recipe_of(KINDS[kind])
    files = sorted(prepared.glob("*.npz"))
    with TemporaryDirectory() as folder, stop_on_signals() as stop, join_processes() as processes:
        context = RunContext(processes, RunFolder(Path(folder)), stop, True)
        if hasattr(recipe, "_prepared"):
            recipe._prepared = prepared  # type: ignore[attr-defined]  # as `survey` sets it
        samples, network = (
            recipe.samples(files, {}, 0, None, context),
            recipe.network(0, None).train(),
        )
        average = AverageWeights(network, KINDS[kind].descent.average)
        setup = TrainingSetup(
            *(network, average, make_optimiser(network, KINDS[kind].descent), samples),
            *(recipe.error_function, KINDS[kind].descent, KINDS[kind].stopping),
        )
        batches = endless(samples)
        for _ in range(WARM_UP):
            step(setup, next(batches), processes)
        count, spent, steps, start = 0, 0.0, 0, time.perf_counter()
        while not processes.any(time.perf_counter() - start > seconds):
            batch = next(batches)
            before = time.perf_counter()
            step(setup, batch, processes)
            steps += 1
            average.add(network, steps)
            spent += time.perf_counter() - before
            count += batch.count
        elapsed = time.perf_counter() - start
    return {"rate": count / elapsed, "share": spent / elapsed}


def run(kind: str, prepared: Path, processes: int, threads: int) -> dict[str, float]:
    """``train_for`` in new processes, as the first of them tells it."""
    words = [sys.executable, *(["-m", "torch.distributed.run"] if processes > 1 else [])]
    words += [f"--nproc-per-node={processes}"] if processes > 1 else []
    environment = os.environ | {"OMP_NUM_THREADS": str(threads)} | BRIEF_WAITS
    done = subprocess.run(
        [*words, str(Path(__file__)), kind, str(prepared)],
        stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, check=True, env=environment,
    )  # fmt: skip
    return json.loads(done.stdout.splitlines()[-1])


def measure(kind: str, threads: int, rounds: int) -> list[dict[str, Any]]:
    """One process on one thread and on two, and two processes on one each, in turn."""
    from scripts.bench_figures import figure
    from scripts.bench_parts import ratio, shown

    part, ways = f"training-{kind}", {"1 process": (1, 1), "2 processes": (2, 1)}
    ways |= {"1 process, 2 threads": (1, 2)}
    found: dict[str, list[dict[str, float]]] = {way: [] for way in ways}
    with TemporaryDirectory() as folder:
        prepare(kind, Path(folder))
        for _ in range(TURNS):
            for way, (processes, each) in ways.items():
                found[way].append(run(kind, Path(folder), processes, each))
    rates = {way: [one["rate"] for one in runs] for way, runs in found.items()}
    return [
        one
        for way, runs in found.items()
        for one in (
            shown(part, way, f"{kind} a second", rates[way], f"{kind}/s"),
            shown(part, way, "of one process", ratio(rates[way], rates["1 process"]), ""),
            shown(part, way, "the network's share", [run["share"] for run in runs], ""),
            figure(part, way, "turns", TURNS, "kernels"),
        )
    ]


PARTS = {f"training-{kind}": partial(measure, kind) for kind in KINDS}

if __name__ == "__main__":
    told = train_for(sys.argv[1], Path(sys.argv[2]), SECONDS)
    if os.environ.get("RANK", "0") == "0":
        print(json.dumps(told))
