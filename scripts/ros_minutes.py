"""Count what the ROS 2 node answers in minutes of images, then in restarts of their publisher.

    python scripts/ros_minutes.py IMAGE [--minutes 10] [--talkers 50] [--parts one,two] [--write]

IMAGE is published as 640x480 on the cores of the node: on one topic at 30 Hz with Fast DDS as it is
(part "default") and with the profile of ros/ ("one"), on two at 15 Hz ("two"), and by publishers
that come and go ("restarts"). Ages are from the publication of an image to the arrival of its mask,
beside the time of `detect` in a process of its own before and after. It needs rclpy (docs/ros.md).
"""

import json
import os
import re
import signal
import subprocess
import sys
import time
from argparse import ArgumentParser, RawTextHelpFormatter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from statistics import mean, median
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # for the package beside

from scripts.readme_figures import keep_records

ROOT = Path(__file__).resolve().parents[1]
COMMAND = "python scripts/ros_minutes.py IMAGE --write"
PROFILE = ROOT / "ros/roadtorch_ros/config/large_messages.xml"
SAMPLES = 20  # of the node's memory
TURN = 4.0  # seconds of a talker that comes and goes
PARTS = {"default": [""], "one": [""], "two": ["front", "rear"]}  # names of cameras
PATIENCE = 60.0  # seconds within which everything starts and ends
ENVIRONMENT = {
    **os.environ,
    "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
    "ROS_DOMAIN_ID": str(1 + os.getpid() % 100),
}
DETECT = """
import statistics, sys, time
import cv2
from roadtorch import load_detector
from roadtorch.run.workers import configure_threads
configure_threads(1)
detector = load_detector("fusion", order="rgb")
image = cv2.resize(cv2.imread(sys.argv[1]), (640, 480))[..., ::-1].copy()
times = []
for _ in range(120):
    start = time.perf_counter()
    detector.detect(image)
    times.append(1000 * (time.perf_counter() - start))
print(statistics.median(times[20:]))
"""


def time_detect(image: Path) -> float:
    """Return the median milliseconds of `detect` on an image, in a process of its own."""
    return float(subprocess.check_output([sys.executable, "-c", DETECT, str(image)], text=True))


@contextmanager
def running_node(cameras: Sequence[str] = ("",)) -> Iterator["subprocess.Popen[str]"]:
    """Start the node and wait for its subscriptions; end it by SIGINT."""
    words = ["-p", f"cameras:={[*cameras]}".replace(" ", "")] if any(cameras) else []
    command = [sys.executable, "-m", "roadtorch", "ros", "--ros-args", *words]
    node = subprocess.Popen(command, env=ENVIRONMENT, stderr=subprocess.PIPE, text=True)
    assert node.stderr is not None
    while "subscribes to" not in node.stderr.readline():
        if node.poll() is not None:
            sys.exit("the node did not start")
    yield node
    node.send_signal(signal.SIGINT)
    node.communicate(timeout=PATIENCE)


def start_talker(image: Path, seconds: float, rate: float, camera: str) -> "subprocess.Popen[str]":
    """Start a talker for some seconds, in the namespace of a camera."""
    words = ["--rate", str(rate), "--size", "640x480", "--encodings", "rgb8", "--image", image]
    command = [sys.executable, ROOT / "tests/ros/talker.py", str(seconds), *words]
    command += ["--ros-args", "-r", f"__ns:=/{camera}"]
    return subprocess.Popen(command, env=ENVIRONMENT, stdout=subprocess.PIPE, text=True)


def answers(talker: "subprocess.Popen[str]") -> dict[str, Any]:
    """Wait for a talker and return its counts."""
    return json.loads(talker.communicate(timeout=PATIENCE)[0].splitlines()[-1])


def resident(process: "subprocess.Popen[str]") -> float:
    """Return the resident MiB of a process."""
    status = Path(f"/proc/{process.pid}/status").read_text(encoding="ascii")
    match = re.search(r"VmRSS:\s+(\d+)", status)
    return int(match[1]) / 1024 if match else 0.0


def count(image: Path, seconds: float, part: str) -> dict[str, float]:
    """Print and return the counts, ages and memory of a part."""
    cameras, sizes, values = PARTS[part], list[float](), dict[str, float]()
    alone = [time_detect(image)]
    with running_node(cameras) as node:
        talkers = [start_talker(image, seconds, 30 / len(cameras), name) for name in cameras]
        for _ in range(SAMPLES):  # not until they end: their reports are longer than a pipe holds
            time.sleep(seconds / SAMPLES)
            sizes.append(resident(node))
        reports = [answers(talker) for talker in talkers]
    alone.append(time_detect(image))
    for name, report in zip(cameras, reports, strict=True):
        ages, dropped = sorted(report["rgb8"]), int(report["diagnostics"]["dropped"])
        figures = {
            "sent": report["sent"],
            "answered": len(ages),
            "dropped": dropped,
            "lost": report["sent"] - len(ages) - dropped,
            "median": median(ages),
            "late": ages[int(0.99 * len(ages))],
            "most": ages[-1],
            "detect": mean(alone),
            "median_of_detect": median(ages) / mean(alone),
            "late_of_detect": ages[int(0.99 * len(ages))] / mean(alone),
            "mib": sizes[SAMPLES // 10],
            "mib_at_the_end": sizes[-1],
        }
        values |= {f"ros.{name or part}.{key}": value for key, value in figures.items()}
        print(name or part, {key: round(value, 2) for key, value in figures.items()}, flush=True)
    return values


def main() -> None:
    """Print the counts; keep them for the documents."""
    parser = ArgumentParser(description=__doc__, formatter_class=RawTextHelpFormatter)
    parser.add_argument("image", type=Path)
    parser.add_argument("--minutes", type=float, default=10)
    parser.add_argument("--talkers", type=int, default=50)
    parser.add_argument("--parts", default="default,one,two,restarts")
    parser.add_argument("--write", action="store_true", help="into docs/figures/ros.json")
    options = parser.parse_args()
    values, parts = {"ros.minutes": options.minutes}, options.parts.split(",")
    for part in parts:
        if part != "default":
            ENVIRONMENT["FASTDDS_DEFAULT_PROFILES_FILE"] = str(PROFILE)
        if part != "restarts":
            values |= count(options.image, 60 * options.minutes, part)
            continue
        with running_node():
            talkers = (start_talker(options.image, TURN, 30, "") for _ in range(options.talkers))
            answered = sum(bool(answers(talker).get("rgb8")) for talker in talkers)
        values |= {"ros.restarts": options.talkers, "ros.restarts.answered": answered}
        print(f"{options.talkers} restarts of the talker: {answered} answered", flush=True)
    if options.write:
        keep_records("ros", COMMAND, values)


if __name__ == "__main__":
    main()
