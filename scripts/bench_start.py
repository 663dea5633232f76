"""How long a start takes: the package, a command on one picture, the first picture in Python."""

import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from roadtorch.scenes.street import render_scene, write_picture
from scripts.bench import run_rounds, time_call
from scripts.bench_figures import Figure, Parts
from scripts.bench_parts import ratio, shown

IMPORT = "import time; a = time.perf_counter(); import roadtorch; print(time.perf_counter() - a)"

FIRST = """
import sys, time, torch
torch.set_num_threads(int(sys.argv[1]))
from roadtorch import load_detector
from roadtorch.scenes.street import render_scene
image, detector, times = render_scene(0, 480, 640).image.contiguous(), load_detector("fusion"), []
for _ in range(10):
    start = time.perf_counter()
    detector.detect(image)
    times.append(1000 * (time.perf_counter() - start))
print(times[0], sorted(times[1:])[4])
"""


def told(code: str, *arguments: object) -> list[float]:
    """The numbers that a new interpreter prints."""
    words = [sys.executable, "-c", code, *map(str, arguments)]
    return list(map(float, subprocess.check_output(words, text=True, env=environment()).split()))


def environment() -> dict[str, str]:
    """Of this process; modules are compiled once, as where the package is installed."""
    return {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}


def run_quietly(words: Sequence[str]) -> None:
    """A command to its end."""
    subprocess.run(words, check=True, capture_output=True, env=environment())


def measure_start(threads: int, rounds: int) -> list[Figure]:
    """``import roadtorch``, ``import torch`` alone and ``roadtorch infer`` on one picture."""
    with tempfile.TemporaryDirectory() as folder:
        picture = Path(folder, "street.png")
        write_picture(picture, render_scene(0, 480, 640))
        infer = [sys.executable, "-m", "roadtorch", "infer", str(picture), "--out"]
        infer += [str(Path(folder, "out")), "--overwrite"]
        torch_alone = [sys.executable, "-c", "import torch"]
        found = run_rounds(
            [
                lambda: {"package": 1000 * told(IMPORT)[0]},
                lambda: time_call("torch", lambda: run_quietly(torch_alone)),
                lambda: time_call("infer", lambda: run_quietly(infer)),
            ],
            rounds,
            "start",
        )
    times = {name: [one[name] for one in found] for name in found[0]}
    rows = {
        "import roadtorch": "package",
        "python -c 'import torch', from start to exit": "torch",
        "roadtorch infer on one picture, from start to exit": "infer",
    }
    return [
        one
        for row, name in rows.items()
        for one in (
            shown("start", row, "ms", times[name]),
            shown("start", row, "of import torch", ratio(times[name], times["torch"]), ""),
        )
    ]


def measure_first(threads: int, rounds: int) -> list[Figure]:
    """The first ``detect`` after loading, against the median of nine later ones."""
    figures = []
    for count in (1, 2):
        runs = [told(FIRST, count) for _ in range(max(rounds // 2, 1))]
        first, later = map(list, zip(*runs, strict=True))
        row = f"fusion, {count} thread{'s' if count > 1 else ''}"
        figures += [
            shown("first", row, "first, ms", first),
            shown("first", row, "later, ms", later),
            shown("first", row, "first / later", ratio(first, later), ""),
        ]
    return figures


PARTS: Parts = {"start": measure_start, "first": measure_first}
