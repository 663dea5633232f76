"""What much footage costs, from the time that one processor spends on a picture.

    python scripts/scale.py measure PICTURES --json measured.json   # processor time, by stage
    python scripts/scale.py table measured.json --price 0.04        # a million frames, 1,000 hours
    python scripts/scale.py engines PICTURES --rounds 3             # threads against Ray

Processor time depends less on what else the machine does than pictures/s do.
The price of a processor-hour is yours.
"""

import argparse
import json
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TypeVar

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # for roadtorch in a checkout

Result = TypeVar("Result")
STAGES = ("read", "detect", "write")
MILLION, HOURS = 10**6, 1000


def processor_ms(work: Callable[[], Result]) -> tuple[Result, float]:
    """What the work gives, and the milliseconds that processors spent on it."""
    start = time.process_time()
    result = work()
    return result, 1000 * (time.process_time() - start)


def measure(pictures: Path, detector: str, most: int) -> dict[str, float]:
    """Median milliseconds of one processor for each stage of ``infer`` as it is by default."""
    import cv2
    import torch

    from roadtorch.detectors.catalogue import load_detector
    from roadtorch.io.image import read_image, write_map, write_mask, write_overlay
    from roadtorch.sources.pictures import find_images

    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    loaded, spent = load_detector(detector), {stage: [] for stage in STAGES}
    found = find_images([str(pictures)])
    with TemporaryDirectory() as folder:
        for at, picture in enumerate(found[:: max(len(found) // most, 1)][: most + 1]):
            image, read = processor_ms(lambda path=picture.path: read_image(path))
            seen, detect = processor_ms(lambda image=image: loaded.detect(image))
            out = Path(folder, "x")

            def write(image=image, seen=seen, out=out) -> None:
                write_map(out.with_suffix(".png"), seen.likelihood)
                write_mask(out.with_suffix(".mask.png"), seen.mask)
                write_overlay(out.with_suffix(".jpg"), image, seen.mask)

            written = processor_ms(write)[1]
            if at:  # the first one warms up
                for stage, ms in zip(STAGES, (read, detect, written), strict=True):
                    spent[stage].append(ms)
    return {stage: round(statistics.median(values), 2) for stage, values in spent.items()}


def measure_video(video: Path, most: int) -> float:
    """Mean milliseconds of one processor to decode a frame of a video, on one thread."""
    import av

    with av.open(str(video)) as container:
        container.streams.video[0].thread_type = "NONE"
        container.streams.video[0].thread_count = 1

        def decode() -> int:
            count = 0
            for frame in container.decode(video=0):
                frame.to_ndarray(format="rgb24")
                count += 1
                if count == most:
                    break
            return count

        count, spent = processor_ms(decode)
    return round(spent / count, 2)


def processor_hours(ms: float, frames: float) -> float:
    """Processor-hours for so many frames of so many milliseconds each."""
    return ms * frames / 3_600_000


def table(measured: dict[str, float], price: float, rate: float, every: int) -> str:
    """A Markdown table: processor-hours and price of what is asked for most.

    rate: frames a second of a video, all of which are decoded, and of which each ``every``-th is
    looked at.
    """
    looked = measured["detect"] + measured["write"]
    frames = HOURS * 3600 * rate
    decoded = processor_hours(measured.get("decode", measured["read"]), frames)
    lines = ["| | processor-hours | price |", "|---|---:|---:|"]
    jobs = {
        "a million pictures": processor_hours(measured["read"] + looked, MILLION),
        f"1,000 hours of video at {rate:g}/s, every frame": decoded
        + processor_hours(looked, frames),
        f"1,000 hours of video at {rate:g}/s, every {every}th frame": decoded
        + processor_hours(looked, frames / every),
    }
    lines += [f"| {name} | {hours:,.1f} | {hours * price:,.2f} |" for name, hours in jobs.items()]
    return "\n".join(lines)


def engines(pictures: Path, detector: str, rounds: int) -> dict[str, list[float]]:
    """Seconds of whole runs with two threads of one process and two actors, in turn."""
    ways = {"local": ["--jobs", "2"], "ray": ["--engine", "ray", "--workers", "2"]}
    taken: dict[str, list[float]] = {name: [] for name in ways}
    for _ in range(rounds):
        for name, options in ways.items():
            with TemporaryDirectory() as out:
                words = [sys.executable, "-m", "roadtorch", "infer", str(pictures), "--out", out]
                words += ["--detector", detector, "--threads", "1", "--quiet", *options]
                start = time.monotonic()
                subprocess.run(words, check=True)
                taken[name].append(round(time.monotonic() - start, 2))
    return taken


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description="What much footage costs.")
    commands = parser.add_subparsers(dest="command", required=True)
    measuring = commands.add_parser("measure")
    tabling = commands.add_parser("table")
    racing = commands.add_parser("engines")
    for one in (measuring, racing):
        one.add_argument("pictures", type=Path)
        one.add_argument("--detector", default="fusion")
    measuring.add_argument("--most", type=int, default=20)
    measuring.add_argument("--video", type=Path)
    measuring.add_argument("--json", type=Path)
    racing.add_argument("--rounds", type=int, default=3)
    tabling.add_argument("measured", type=Path)
    tabling.add_argument("--price", type=float, required=True, help="of a processor-hour")
    tabling.add_argument("--rate", type=float, default=25.0)
    tabling.add_argument("--every", type=int, default=10)
    given = parser.parse_args(arguments)
    if given.command == "measure":
        measured = measure(given.pictures, given.detector, given.most)
        if given.video:
            measured["decode"] = measure_video(given.video, given.most)
        print(json.dumps(measured))
        if given.json:
            given.json.write_text(json.dumps(measured) + "\n")
    elif given.command == "table":
        print(table(json.loads(given.measured.read_text()), given.price, given.rate, given.every))
    else:
        for name, seconds in engines(given.pictures, given.detector, given.rounds).items():
            print(f"{name:<6} median {statistics.median(seconds):.1f} s of {seconds}")


if __name__ == "__main__":
    main()
