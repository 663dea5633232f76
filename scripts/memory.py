"""Does `infer` need more memory the more pictures it is given?

    python scripts/memory.py                         # 100, 1,000 and 5,000 pictures
    python scripts/memory.py --counts 20 40 --detector prior:rows

For each count a folder of rendered streets (a few, under many names) is given to `roadtorch infer`
in a process of its own, whose memory is looked at four times a second: the resident set when a
tenth of the pictures is done, when nine tenths are, and the most that it ever was. Linux only.
"""

import argparse
import math
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # for the package beside

from roadtorch.scenes.street import render_scene, write_picture

COUNTS = (100, 1_000, 5_000)
STREETS = 20  # rendered; the rest are further names of theirs
EVERY = 0.25  # seconds from look to look
DONE_BY = ".mask.png"  # the last file that is written of a picture


class Look(NamedTuple):
    """How many pictures were done, and the resident set then, in MiB."""

    done: int
    resident: float


class Memory(NamedTuple):
    """Of one run: seconds, and the resident set in MiB early, late and at most; NaN if not seen."""

    pictures: int
    seconds: float
    early: float
    late: float
    peak: float


def lay_out(folder: Path, count: int, size: tuple[int, int]) -> None:
    """So many pictures in a folder: a few rendered ones, and links to them."""
    for number in range(count):
        path = folder / f"{number:05}.png"
        if number < STREETS:
            write_picture(path, render_scene(number, *size))
        else:
            os.link(folder / f"{number % STREETS:05}.png", path)


def looks(process: subprocess.Popen[bytes], out: Path) -> Iterator[Look]:
    """What is seen of a process until it ends."""
    status = Path(f"/proc/{process.pid}/status")
    while process.poll() is None:
        kept = [line for line in status.read_text().splitlines() if line.startswith("VmRSS")]
        if kept and out.is_dir():
            done = sum(entry.name.endswith(DONE_BY) for entry in os.scandir(out))
            yield Look(done, int(kept[0].split()[1]) / 1024)
        time.sleep(EVERY)


def measure(given: argparse.Namespace, count: int, folder: Path) -> Memory:
    """Run over so many pictures and watch; CalledProcessError where the run fails."""
    lay_out(folder / "pictures", count, (120, 160))
    words = [sys.executable, "-m", "roadtorch", "infer", str(folder / "pictures"), "--quiet"]
    words += ["--detector", given.detector, "--save", "mask", "--jobs", str(given.jobs)]
    start, out = time.monotonic(), folder / "out"
    process = subprocess.Popen([*words, "--out", str(out)])
    seen = list(looks(process, out))
    if process.wait():
        raise subprocess.CalledProcessError(process.returncode, words)
    early = next((one.resident for one in seen if one.done >= count / 10), math.nan)
    late = next((one.resident for one in reversed(seen) if one.done <= count * 0.9), math.nan)
    peak = max((one.resident for one in seen), default=math.nan)
    return Memory(count, time.monotonic() - start, early, late, peak)


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--counts", type=int, nargs="+", default=COUNTS)
    parser.add_argument("--detector", default="fusion")
    parser.add_argument("--jobs", type=int, default=1)
    return parser.parse_args()


def compare(given: argparse.Namespace) -> None:
    """Print a row for each count."""
    print(f"{'pictures':>8} {'seconds':>8} {'MiB at 10 %':>12} {'at 90 %':>8} {'peak':>8}")
    for count in given.counts:
        with tempfile.TemporaryDirectory() as folder:
            found = measure(given, count, Path(folder))
        figures = f"{found.early:12.0f} {found.late:8.0f} {found.peak:8.0f}"
        print(f"{found.pictures:8} {found.seconds:8.0f} {figures}", flush=True)


if __name__ == "__main__":
    compare(_arguments())
