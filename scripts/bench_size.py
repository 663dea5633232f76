"""Time and memory of ``fusion`` over the size of the picture, from 0.1 to 80 megapixels.

    python scripts/bench.py --only size            # and docs/size.svg
    python scripts/bench_size.py 8                 # one size alone, in megapixels

Every size has a process of its own, on one thread: an image float32 (3,H,W) is made there, 12 bytes
a pixel, and ``detect`` is asked for likelihood and mask, 5 bytes a pixel. The memory is the largest
resident set of the process, which the image is part of. The slope is that of the straight line
through all sizes.
"""

import json
import subprocess
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from torch import Tensor

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # for the scripts beside

from roadtorch.runtime.memory import peak_mebibytes

ROOT = Path(__file__).resolve().parents[1]

SIZES = (0.1, 0.3, 1.0, 3.0, 8.0, 20.0, 40.0, 80.0)
"""Megapixels."""
DEAR = 8.0  # megapixels from which a size is timed fewer times
PART, ASPECT = "size", 4 / 3


def detect_at(megapixels: float) -> dict[str, float]:
    """Of one size: pixels, ms of ``detect``, and the most MiB that the process ever had."""
    import torch

    from roadtorch import load_detector

    torch.set_num_threads(1)
    height = round((megapixels * 1e6 / ASPECT) ** 0.5)
    width = round(height * ASPECT)
    detector, times = load_detector("fusion"), []
    image = enlarged(height, width)
    for _ in range(7 if megapixels < DEAR else 2):
        start = time.perf_counter()
        detector.detect(image)
        times.append(1000 * (time.perf_counter() - start))
    middle = sorted(times)[len(times) // 2]
    return {"ms": middle, "MiB": peak_mebibytes(), "pixels": height * width}


def enlarged(height: int, width: int) -> "Tensor":
    """A rendered street (3,H,W) of any size, its pixels repeated."""
    import torch

    from roadtorch.scenes.street import render_scene

    small = render_scene(0, 240, 320).image
    rows, columns = torch.arange(height) * 240 // height, torch.arange(width) * 320 // width
    large = torch.empty(3, height, width)
    for plane, values in zip(large, small, strict=True):
        for row, place in zip(plane, rows, strict=True):
            row.copy_(values[place][columns])
    return large


def measure_size(threads: int, rounds: int) -> list[dict[str, object]]:
    """Every size in turn, and the straight lines through them; draws the plot too."""
    from scripts.bench_figures import figure

    found = []
    for megapixels in SIZES:
        words = [sys.executable, str(Path(__file__)), str(megapixels)]
        found.append(json.loads(subprocess.check_output(words, text=True).splitlines()[-1]))
    figures = []
    for megapixels, one in zip(SIZES, found, strict=True):
        row = f"{megapixels:g} megapixels"
        figures += [
            figure(PART, row, "ms", one["ms"], "ms"),
            figure(PART, row, "MiB at most", one["MiB"], "MiB"),
            figure(PART, row, "bytes a pixel above the smallest", above(one, found[0]), ""),
        ]
    pixels = [one["pixels"] for one in found]
    per_pixel = slope(pixels, [one["MiB"] * 2**20 for one in found])
    per_megapixel = slope(pixels, [one["ms"] for one in found]) * 1e6
    draw(found, ROOT / "docs" / "size.svg")
    return [
        *figures,
        figure(PART, "straight line", "ms", f"{per_megapixel:.1f} a megapixel"),
        figure(PART, "straight line", "bytes a pixel above the smallest", per_pixel),
    ]


def above(one: dict[str, float], smallest: dict[str, float]) -> float:
    """Bytes for each pixel more than the smallest picture has; 0 for that one."""
    more = one["pixels"] - smallest["pixels"]
    return (one["MiB"] - smallest["MiB"]) * 2**20 / more if more else 0.0


def slope(over: list[float], values: list[float]) -> float:
    """Of the straight line of least squares."""
    mean, level = sum(over) / len(over), sum(values) / len(values)
    apart = [one - mean for one in over]
    rise = sum(a * (b - level) for a, b in zip(apart, values, strict=True))
    return rise / sum(a * a for a in apart)


def draw(found: list[dict[str, float]], path: Path) -> None:
    """Time and memory over megapixels, both axes of each logarithmic."""
    import matplotlib as mpl

    mpl.use("Agg")
    mpl.rcParams["svg.hashsalt"] = "size"
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(1, 2, figsize=(8, 3), layout="constrained")
    figure.patch.set_facecolor("white")  # a card that stays white on dark pages
    over = [one["pixels"] / 1e6 for one in found]
    titles = {"ms": "time, ms", "MiB": "largest resident set, MiB"}
    for axis, (key, title) in zip(axes, titles.items(), strict=True):
        axis.loglog(over, [one[key] for one in found], "o-", color="#1f6feb")
        axis.set(title=title, xlabel="megapixels")
        axis.grid(True, which="major", color="#dddddd")
        axis.xaxis.set_major_formatter("{x:g}")
        axis.yaxis.set_major_formatter("{x:g}")
        axis.yaxis.set_minor_formatter("")
    figure.savefig(path, metadata={"Date": None})
    plt.close(figure)


PARTS = {PART: measure_size}

if __name__ == "__main__":
    print(json.dumps(detect_at(float(sys.argv[1]))))
