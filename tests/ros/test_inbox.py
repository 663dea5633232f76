"""Queues of images, and a missing ROS, without ROS."""

import sys
import threading
from typing import Any

import pytest

from roadtorch.base.errors import ConfigError
from roadtorch.cli.ros import ros_command
from roadtorch.ros.inbox import BURST, Inbox
from tests.command import invoke_command


def fill(inbox: Inbox, *numbers: int, camera: str = "") -> None:
    for number in numbers:
        inbox.put(camera, number)


def taken(inbox: Inbox, count: int) -> list[Any]:
    return [arrival.message for _ in range(count) if (arrival := inbox.take())]


def test_a_burst_is_processed_in_order() -> None:
    inbox = Inbox([""])

    fill(inbox, *range(BURST))

    assert taken(inbox, BURST + 1) == [*range(BURST)]
    assert inbox.dropped == {"": 0}


def test_lasting_overload_keeps_the_newest_image_until_none_waits() -> None:
    inbox = Inbox([""])

    fill(inbox, *range(BURST + 1))
    first = taken(inbox, 1)
    fill(inbox, 10, 11)
    second = taken(inbox, 2)  # the second finds none, and a burst is kept again
    fill(inbox, 20, 21)

    assert (first, second, taken(inbox, 2)) == ([BURST], [11], [20, 21])
    assert inbox.dropped == {"": BURST + 1}


def test_cameras_take_turns_and_a_slow_one_is_not_starved() -> None:
    inbox = Inbox(["front", "rear"])

    fill(inbox, *range(BURST), camera="front")
    fill(inbox, 10, 11, camera="rear")

    assert taken(inbox, BURST + 2) == [0, 10, 1, 11, 2]
    fill(inbox, *range(9), camera="front")
    assert inbox.dropped["rear"] == 0


def test_a_message_is_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("roadtorch.ros.inbox.POLL_PERIOD", 60)
    inbox = Inbox([""])
    threading.Timer(0.05, fill, (inbox, 7)).start()

    assert taken(inbox, 1) == [7]


def test_without_ros_a_line_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rclpy", None)

    with pytest.raises(ConfigError, match=r"ros: rclpy is not installed \(source the setup\.bash"):
        invoke_command(ros_command)
