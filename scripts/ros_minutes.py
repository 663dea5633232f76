"""The node of ROS 2 for minutes: ages of its answers, memory, drops; then restarts of both sides.

    python scripts/ros_minutes.py PICTURE [--minutes 10] [--talkers 50] [--nodes 20]

The talker of tests/ros publishes PICTURE as 640x480 at 30 Hz. The time of `detect` alone is
measured in a process of its own before and after, with nothing beside it. It needs rclpy
(docs/ros.md).
"""

import argparse
import json
import os
import re
import signal
import statistics
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

TALKER = Path(__file__).resolve().parents[1] / "tests/ros/talker.py"
SIZE, RATE = "640x480", "30"
EVERY = 30.0  # seconds between two looks at the memory
TURN = 4.0  # seconds of a talker that comes and goes
PATIENCE = 60.0  # seconds within which everything starts and ends
ENVIRONMENT = {
    **os.environ,
    "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
    "ROS_DOMAIN_ID": str(1 + os.getpid() % 100),
}
ALONE = """
import statistics, sys, time
import cv2
from roadtorch.detectors.catalogue import load_detector
detector = load_detector("fusion", order="rgb")
image = cv2.resize(cv2.imread(sys.argv[1]), (640, 480))[..., ::-1].copy()
times = []
for _ in range(220):
    start = time.perf_counter()
    detector.detect(image)
    times.append(1000 * (time.perf_counter() - start))
print(statistics.median(times[20:]))
"""


def detect_alone(picture: Path) -> float:
    """Median milliseconds of a picture, 200 times, in a process of its own."""
    return float(subprocess.check_output([sys.executable, "-c", ALONE, str(picture)], text=True))


def node_started() -> "subprocess.Popen[str]":
    """The node, once it listens."""
    command = [sys.executable, "-m", "roadtorch", "ros"]
    node = subprocess.Popen(command, env=ENVIRONMENT, stderr=subprocess.PIPE, text=True)
    assert node.stderr is not None
    while "looks at" not in node.stderr.readline():
        if node.poll() is not None:
            sys.exit("the node did not start")
    return node


def talker_started(picture: Path, seconds: float) -> "subprocess.Popen[str]":
    """A talker for some seconds."""
    words = ["--rate", RATE, "--size", SIZE, "--encodings", "rgb8", "--picture", str(picture)]
    command = [sys.executable, str(TALKER), str(seconds), *words]
    return subprocess.Popen(command, env=ENVIRONMENT, stdout=subprocess.PIPE, text=True)


def answers(talker: "subprocess.Popen[str]", seconds: float) -> dict[str, Any]:
    """What a talker was told; TimeoutExpired where it does not end in time."""
    output, _ = talker.communicate(timeout=seconds)
    return json.loads(output.splitlines()[-1])


def memory(process: "subprocess.Popen[str]") -> float:
    """Resident MiB of a process."""
    status = Path(f"/proc/{process.pid}/status").read_text(encoding="ascii")
    kib = re.search(r"VmRSS:\s+(\d+)", status)
    return int(kib[1]) / 1024 if kib else 0.0


def run(picture: Path, minutes: float) -> None:
    """Minutes of a talker at 30 Hz: print ages, drops and memory."""
    before = detect_alone(picture)
    node = node_started()
    talker, sizes, told = talker_started(picture, 60 * minutes), [], None
    while told is None:
        with suppress(subprocess.TimeoutExpired):
            told = answers(talker, EVERY)
        sizes.append(memory(node))
    node.send_signal(signal.SIGINT)
    start = time.monotonic()
    node.communicate(timeout=PATIENCE)
    ended = time.monotonic() - start
    alone = statistics.mean([before, detect_alone(picture)])
    ages = sorted(told["rgb8"])
    median, late = statistics.median(ages), ages[int(0.99 * len(ages))]
    print(
        f"{minutes:g} minutes: {told['sent']} sent, {len(ages)} answered, diagnostics say "
        f"{told['diagnostics']['dropped']} dropped"
    )
    print(
        f"detect alone {alone:.1f} ms; age: median {median:.1f} ms ({median / alone:.2f} times), "
        f"99th percentile {late:.1f} ms ({late / alone:.2f} times), most {ages[-1]:.1f} ms"
    )
    half = len(sizes) // 2
    print(
        f"memory after {EVERY:.0f} s {sizes[0]:.0f} MiB, halfway {sizes[half]:.0f} MiB, at the end "
        f"{sizes[-1]:.0f} MiB; ended {ended:.1f} s after SIGINT"
    )


def restarts(picture: Path, talkers: int, nodes: int) -> None:
    """Talkers that come and go before one node; nodes that come and go before talkers."""
    node, answered = node_started(), 0
    for _ in range(talkers):
        answered += bool(answers(talker_started(picture, TURN), TURN + PATIENCE).get("rgb8"))
    node.send_signal(signal.SIGINT)
    node.communicate(timeout=PATIENCE)
    print(f"{talkers} restarts of the talker: {answered} answered")
    ended, answered = 0, 0
    for number in range(nodes):
        node = node_started()
        answered += bool(answers(talker_started(picture, TURN), TURN + PATIENCE).get("rgb8"))
        node.send_signal(signal.SIGKILL if number % 2 else signal.SIGINT)
        ended += node.wait(PATIENCE) in (130, -signal.SIGKILL)
    print(
        f"{nodes} restarts of the node, every second by SIGKILL: {answered} answered, {ended} ended"
    )


def main() -> None:
    """Print what was measured."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("picture", type=Path)
    parser.add_argument("--minutes", type=float, default=10)
    parser.add_argument("--talkers", type=int, default=50)
    parser.add_argument("--nodes", type=int, default=20)
    options = parser.parse_args()
    run(options.picture, options.minutes)
    restarts(options.picture, options.talkers, options.nodes)


if __name__ == "__main__":
    main()
