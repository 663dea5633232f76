"""The node, with a ROS 2 talker in another process on localhost."""

import json
import math
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from roadtorch.base.errors import ConfigError
from roadtorch.camera.ground import camera_pose
from roadtorch.camera.ground_grid import GridSettings
from roadtorch.ros.parameters import declare_parameters
from roadtorch.run.writers.bag import MASK_CLASS_NAMES
from tests.command import Call
from tests.reference.semantic_layer import NAV2_PARAMETERS, count_stray_cells, mark_cells

pytest.importorskip("rclpy", reason="rclpy is not installed (docs/ros.md)")

pytestmark = pytest.mark.filterwarnings("ignore:module 'sre_:DeprecationWarning")  # lark

TALKER = Path(__file__).with_name("talker.py")
STARTED, PATIENCE = 180.0, 300.0  # seconds for a start, and for everything else

Talk = Callable[..., dict[str, Any]]
Start = Callable[..., "subprocess.Popen[str]"]


@pytest.fixture
def environment() -> dict[str, str]:
    """Return an environment with a ROS domain for this test only."""
    domain = str(1 + (os.getpid() + time.monotonic_ns() // 1000) % 100)
    return {**os.environ, "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "ROS_DOMAIN_ID": domain}


@pytest.fixture
def start(environment: dict[str, str]) -> Iterator[Start]:
    """Return ``start("-p", "grid.height:=1.2")``, which waits until the node subscribes."""
    nodes: list[subprocess.Popen[str]] = []

    def begun(*words: str) -> "subprocess.Popen[str]":
        command = [sys.executable, "-m", "roadtorch", "ros", "--ros-args", *words]
        node = subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, text=True)
        nodes.append(node)
        assert node.stderr is not None
        end = time.monotonic() + STARTED
        while "subscribes to" not in node.stderr.readline():
            assert node.poll() is None
            assert time.monotonic() < end
        return node

    yield begun
    for node in nodes:
        node.kill()
        node.communicate()


@pytest.fixture
def talk(environment: dict[str, str]) -> Talk:
    """Return ``talk(5, "--rate", 10)``, which runs the talker and returns its results."""

    def run(*words: object) -> dict[str, Any]:
        command = [sys.executable, str(TALKER), *map(str, words)]
        output = subprocess.check_output(command, env=environment, text=True, timeout=PATIENCE)
        return json.loads(output.splitlines()[-1])

    return run


@pytest.fixture
def declare() -> Iterator[Callable[..., Any]]:
    """Return ``declare("grid.height:=1")``: a node with these parameters, and their values."""
    import rclpy

    def run(*texts: str) -> tuple[Any, Any]:
        words = [word for text in texts for word in ("-p", text)]
        rclpy.init(args=["roadtorch", "--ros-args", *words])
        node = rclpy.create_node("roadtorch")
        return node, declare_parameters(node)

    yield run
    rclpy.try_shutdown()


def test_whole_numbers_are_read_and_parameters_are_read_only(declare: Callable[..., Any]) -> None:
    from rclpy.parameter import Parameter

    node, values = declare(
        "grid.height:=1", "grid.fov:=60", "cameras:=['front']", "front.grid.pitch:=5"
    )
    grid = values["front"].grid

    assert (grid.height, grid.fov, grid.pitch) == (1.0, 60.0, 5.0)
    for name in ("grid.height", "front.grid.pitch", "smoothing"):
        (result,) = node.set_parameters([Parameter(name, value=2.0)])
        assert not result.successful
        assert "read-only" in result.reason


@pytest.mark.parametrize("text", ["smoothing:=0", "cameras:=front", "cameras:=[1]", "detector:=5"])
def test_a_parameter_of_another_type_is_refused_with_an_example(
    text: str, declare: Callable[..., Any]
) -> None:
    with pytest.raises(
        ConfigError, match=f"^{text.partition(':')[0]}.* was given .*-p grid.height:=1.2"
    ):
        declare(text)


@pytest.mark.parametrize("words", ["-r image:=", "-r __node:=a/b", "-p x", "--params-file gone"])
def test_words_that_ros_cannot_parse_are_one_line(words: str, call: Call) -> None:
    result = call("ros", "--ros-args", *words.split())

    assert (result.exit_code, result.stderr.count("\n")) == (2, 1)
    assert result.stderr.startswith("roadtorch: error: --ros-args: Failed to parse")


def test_every_encoding_is_answered_with_its_stamp_and_frame(start: Start, talk: Talk) -> None:
    start("-p", "grid.height:=1.2", "-p", "grid.pitch:=5.0", "-p", "detector:=prior:triangle")

    results = talk(8)

    encodings = {"rgb8", "bgr8", "rgba8", "bgra8", "rgb16", "mono8", "mono16", "yuv422"}
    assert {*encodings, "bayer_rggb8", "yuv422_yuy2", "compressed"} <= results.keys()
    assert results["mask"] == ["camera_optical", 120, 160, "mono8"]
    assert results["values"] == [0, 1]
    assert results["confidence"] == ["camera_optical", 120, 160]
    assert results["grid"] == ["base_link", 300, 300]
    assert {-1, 0} <= {*results["cells"]} <= {-1, 0, 100}
    assert results["diagnostics"].keys() == {"trust", "doubt", "rate", "age", "dropped", "refused"}


def test_nav2_marks_the_cells_of_the_published_grid(
    start: Start, talk: Talk, tmp_path: Path
) -> None:
    """The layer of tests/reference/semantic_layer.py reads topics of one stamp."""
    values = ("grid.height:=1.2", "grid.pitch:=15.0", "grid.cell:=0.2", "detector:=prior:triangle")
    start(*(word for value in values for word in ("-p", value)))
    settings, pose = GridSettings(cell=0.2), camera_pose(1.2, 15)
    reach = math.sqrt(0.2 * 240 * 1.2)  # a pixel is r² / (f h) metres long
    layer = NAV2_PARAMETERS | {"max_obstacle_distance": reach}

    results = talk(5, "--encodings", "rgb8", "--size", "240x180", "--save", tmp_path / "topics.npz")

    names = dict(results.get("labels", MASK_CLASS_NAMES.items()))
    topics = np.load(tmp_path / "topics.npz")
    mask, confidence, points = (topics[name] for name in ("mask", "confidence", "points"))
    marked = mark_cells(mask, confidence, points, names, layer, pose, settings)
    assert topics["frame"] == "camera_optical"
    assert min((marked == 0).sum(), (marked == 254).sum()) > 20
    assert count_stray_cells(marked, topics["grid"], settings, reach - 0.5) == 0


def test_the_talker_may_leave_and_come_back_with_another_size(start: Start, talk: Talk) -> None:
    start("-p", "detector:=prior:triangle")

    for width, height in ((160, 120), (64, 48), (320, 240)):
        results = talk(4, "--size", f"{width}x{height}", "--encodings", "rgb8")
        assert results["mask"][1:3] == [height, width]


def test_two_cameras_have_topics_and_parameters_of_their_own(start: Start, talk: Talk) -> None:
    values = ("cameras:=['front','rear']", "detector:=prior:triangle", "grid.pitch:=5.0")
    values += ("rear.grid.height:=1.5", "rear.grid.frame:=rear_link")
    start(*(word for value in values for word in ("-p", value)))

    def run(name: str, size: str) -> dict[str, Any]:
        words = ("--encodings", "rgb8", "--size", size, "--ros-args", "-r", f"__ns:=/{name}")
        return talk(6, *words)

    with ThreadPoolExecutor(2) as pool:
        front, rear = pool.map(run, ("front", "rear"), ("160x120", "64x48"))

    assert (front["mask"][1:3], rear["mask"][1:3]) == ([120, 160], [48, 64])
    assert all(0 < len(camera["rgb8"]) <= camera["sent"] for camera in (front, rear))
    assert "grid" not in front
    assert rear["grid"] == ["rear_link", 300, 300]


@pytest.mark.parametrize("words", ["cameras:=['9']", "grid.height:=-1.0"])
def test_impossible_parameters_are_refused_in_a_line(
    environment: dict[str, str], words: str
) -> None:
    command = [sys.executable, "-m", "roadtorch", "ros", "--ros-args", "-p", words]

    node = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)

    assert node.returncode == 2
    assert node.stderr.startswith(f"roadtorch: error: {words.partition(':')[0]}")
    assert node.stderr.count("\n") == 1


def test_an_unknown_encoding_is_refused_and_the_others_go_on(start: Start, talk: Talk) -> None:
    node = start("-p", "detector:=prior:triangle")

    results = talk(5, "--encodings", "rgb8,32FC1")
    node.send_signal(signal.SIGINT)
    _, words = node.communicate(timeout=PATIENCE)

    assert results["rgb8"]
    assert int(results["diagnostics"]["refused"]) > 0
    assert "32FC1" not in results
    assert words.count("has the encoding '32FC1', which is not read") == 1


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_ends_the_node_in_seconds(start: Start, number: signal.Signals, code: int) -> None:
    node = start("-p", "detector:=prior:rows")
    began = time.monotonic()

    node.send_signal(number)

    assert node.wait(PATIENCE) == code
    assert time.monotonic() - began < 60
