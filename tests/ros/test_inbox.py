"""The queue of the newest message, without ROS."""

import sys
import threading
from itertools import islice
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from roadtorch.base.errors import ConfigError
from roadtorch.base.signals import StopRequest
from roadtorch.cli.ros import ros_command
from roadtorch.detectors.detection import Detection
from roadtorch.ros.node import Inbox
from roadtorch.run.writers.bag import mask_and_confidence
from tests.command import invoke_command


def message(number: int) -> Any:
    header = SimpleNamespace(stamp=SimpleNamespace(sec=number, nanosec=5), frame_id="camera")
    pixels = np.full((16, 16), number, np.uint8)
    return SimpleNamespace(
        header=header, encoding="mono8", height=16, width=16, step=16, data=pixels.reshape(-1)
    )


def test_the_newest_message_is_taken_and_the_others_are_counted() -> None:
    inbox, stop = Inbox(), StopRequest()
    for number in range(3):
        inbox.put(message(number))
    frames = inbox.source("/image", stop).items()

    first = next(frames)
    inbox.put(message(7))
    second = next(frames)

    assert (inbox.dropped, first.stamp, second.stamp) == (2, 2 * 10**9 + 5, 7 * 10**9 + 5)
    assert first.read().mul(255).round().unique().tolist() == [2]
    assert inbox.header.frame_id == "camera"


def test_frames_end_when_somebody_asks_to_stop() -> None:
    inbox, stop = Inbox(), StopRequest()
    threading.Timer(0.2, stop.request, (15,)).start()

    assert [*islice(inbox.source("/image", stop).items(), 1)] == []


def test_confidence_is_of_each_pixels_own_class() -> None:
    likelihood = torch.tensor([[0.0, 0.2], [0.9, 1.0]])

    mask, confidence = mask_and_confidence(Detection(likelihood, likelihood > 0.5, {}))

    assert mask.tolist() == [[0, 0], [1, 1]]
    assert confidence.tolist() == [[255, 204], [230, 255]]


def test_without_ros_a_line_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rclpy", None)

    with pytest.raises(ConfigError, match=r"ros: rclpy is not installed \(source the setup\.bash"):
        invoke_command(ros_command)
