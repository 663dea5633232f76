"""Pictures a second of the commands, with one job and with two, here and in another checkout.

    python scripts/bench_throughput.py DATA
    python scripts/bench_throughput.py DATA --against ../before --only infer video --rounds 9

In each round every command runs as a process of its own, on few pictures and on all of them. Its
rate is that of the pictures between, so that imports, weights and the start of workers do not
count. What is compared runs one after the other, the order turning from round to round; times are
medians over the rounds. Shares are those of this checkout's rates. Beside `infer` stands what two
processes do that only detect, on one thread each, what they have in memory. Training gets as many
processors instead of jobs.
"""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from functools import partial
from itertools import product
from pathlib import Path
from statistics import median

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # for the package beside

import torch

from roadtorch import load_detector, read_image
from scripts.freeze import write_bags

HERE = Path(__file__).resolve().parents[1]
COMMANDS = {
    "infer": "infer pictures",
    "video": "infer clip.mp4 --limit {pictures}",
    "bag": "infer drive",
    "grid": "grid pictures --height 1.5 --pitch 3 --fov 60",
    "label": "label pictures",
    "submit": "submit kitti",
    "evaluate": "evaluate camvid camvid --limit {pictures}",
    "train": "train --config adapt --images pictures --set stopping.epochs=1 "
    "--set samples_per_epoch=1",  # what is left of it is the preparation
}
FEW = 4
KEEP_MEMORY = dict.fromkeys(("MALLOC_MMAP_THRESHOLD_", "MALLOC_TRIM_THRESHOLD_"), str(2**28))
"""For glibc, which is told the same by the commands."""


def make_inputs(data: Path, folder: Path, pictures: int) -> None:
    """So many pictures, alone, as frames of a bag, and with calibration; a video, and CamVid."""
    files = sorted((data / "camvid/train").glob("*.jpg"))[:pictures]
    street, lens = (next((data / "kitti_road" / name).iterdir()) for name in ("image_2", "calib"))
    for name in ("pictures", "kitti/image_2", "kitti/calib"):
        (folder / name).mkdir(parents=True)
    for number, file in enumerate(files):
        (folder / "pictures" / file.name).symlink_to(file)
        (folder / f"kitti/image_2/um_{number:06}.png").symlink_to(street)
        (folder / f"kitti/calib/um_{number:06}.txt").symlink_to(lens)
    (folder / "camvid").symlink_to(data / "camvid")
    (folder / "clip.mp4").symlink_to(data / "clips/us_rural_damp.mp4")
    write_bags(folder, slice(pictures))


def seconds(checkout: Path, line: str, jobs: int, folder: Path) -> float:
    """Wall time of a command of a checkout, run in a folder of inputs."""
    words = [sys.executable, "-m", "roadtorch", *line.split(), "--out", "out"]
    if line.startswith("train"):
        processors = sorted(os.sched_getaffinity(0))[:jobs]
        words = ["taskset", "--cpu-list", ",".join(map(str, processors)), *words]
    else:
        words += ["--jobs", str(jobs)]
    start = time.perf_counter()
    environment = {**os.environ, "PYTHONPATH": str(checkout.resolve())}
    subprocess.run(words, cwd=folder, env=environment, capture_output=True, check=True)
    taken = time.perf_counter() - start
    shutil.rmtree(folder / "out")
    return taken


def ceiling(folder: Path, pictures: int) -> float:
    """Pictures a second of two processes that only detect, side by side."""
    words = [sys.executable, __file__, str(folder), "--pictures", str(pictures // 2), "--alone"]
    start = partial(subprocess.Popen, words, env=os.environ | KEEP_MEMORY, stdout=subprocess.PIPE)
    return sum(float(process.communicate()[0]) for process in (start(), start()))


def alone(folder: Path, pictures: int) -> float:
    """Pictures a second of this process, which detects on one thread what it has in memory."""
    torch.set_num_threads(1)
    detector = load_detector("fusion")
    images = [read_image(file) for file in sorted((folder / "pictures").iterdir())[:FEW]]
    for image in images:
        detector.detect(image)
    start = time.perf_counter()
    for number in range(pictures):
        detector.detect(images[number % len(images)])
    return pictures / (time.perf_counter() - start)


def rows(options: argparse.Namespace, inputs: Path) -> Iterator[Sequence[str | float]]:
    """Of each command and checkout the rates with one job and two, and the shares of this one's."""
    checkouts, counts = [HERE, *options.against], (FEW, options.pictures)
    for count in counts:
        make_inputs(options.data.resolve(), inputs / str(count), count)
    ways = list(product(checkouts, (1, 2), counts))
    for name in options.only:
        times: dict[tuple[Path, int, int], list[float]] = {way: [] for way in ways}
        ceilings: list[float] = []
        for turn in range(options.rounds):
            for way in ways[turn % len(ways) :] + ways[: turn % len(ways)]:
                checkout, jobs, count = way
                line = COMMANDS[name].format(pictures=count)
                times[way].append(seconds(checkout, line, jobs, inputs / str(count)))
            if name == "infer":
                ceilings.append(ceiling(inputs / str(options.pictures), options.pictures))
        rates: dict[tuple[Path, int], float] = {}
        for way in product(checkouts, (1, 2)):
            few, every = (median(times[*way, count]) for count in counts)
            rates[way] = (options.pictures - FEW) / (every - few)
        for checkout in checkouts:
            one, two = rates[checkout, 1], rates[checkout, 2]
            shares = (one / rates[HERE, 1], two / rates[HERE, 2])
            yield name, checkout.name, one, two, two / one, *shares
        if ceilings:
            most = median(ceilings)
            yield name, "two detectors alone", "", most, "", "", most / rates[HERE, 2]


def main(words: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("data", type=Path, help="the development data")
    parser.add_argument("--against", type=Path, nargs="*", default=[], help="other checkouts")
    parser.add_argument("--only", nargs="+", choices=COMMANDS, default=COMMANDS)
    parser.add_argument("--pictures", type=int, default=100)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--alone", action="store_true", help="detect only: the script itself asks")
    options = parser.parse_args(words)
    if options.alone:
        print(alone(options.data, options.pictures))
        return 0
    print("| command | checkout | 1 job | 2 jobs | ratio | 1 job, share | 2 jobs, share |")
    with tempfile.TemporaryDirectory() as folder:
        for row in rows(options, Path(folder)):
            cells = (cell if isinstance(cell, str) else f"{cell:.2f}" for cell in row)
            print(f"| {' | '.join(cells)} |", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
