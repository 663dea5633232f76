"""Bags as results: read by rosbags, they are equal bit for bit."""

import errno
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
import torch
from rosbags.highlevel import AnyReader
from rosbags.interfaces import QosDurability, QosReliability

from roadtorch.base.errors import InputError
from roadtorch.detectors.detection import Detection
from roadtorch.inputs.bags import image_topic
from roadtorch.inputs.item import Item
from roadtorch.run.writers.bag import BagWriter, load_message_types

STAMP = 1_700_000_000_123_456_789


def detection(seed: int, size: tuple[int, int] = (48, 64)) -> Detection:
    likelihood = torch.rand(size, generator=torch.Generator().manual_seed(seed))
    return Detection(likelihood, likelihood > 0.6, {})


def item(stamp: int) -> Item:
    return Item(f"{stamp}", f"{stamp}", torch.rand, stamp=stamp)


def overlay(result: Detection) -> np.ndarray:
    return np.repeat((result.likelihood * 255).byte().numpy()[..., None], 3, 2)


class Written(NamedTuple):
    topic: str
    stamp: int  # of the recording
    message: Any


def read_bag(path: Path) -> Iterator[Written]:
    with AnyReader([path]) as reader:
        for link, stamp, data in reader.messages():
            yield Written(link.topic, stamp, reader.deserialize(data, link.msgtype))


@pytest.fixture(params=["drive_road", "drive_road.bag"])
def path(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    return tmp_path / "out" / request.param


def test_masks_are_equal_bit_for_bit_and_stamps_to_the_nanosecond(path: Path):
    results = [detection(number) for number in range(4)]
    with closing(BagWriter(path, "camera_optical", 0.6, overlay)) as bag:
        for number, result in enumerate(results):
            bag.write(item(STAMP + number), result)

    topic = image_topic(str(path), "/segmentation/mask")
    assert (topic.frame_id, topic.count) == ("camera_optical", 4)
    sure = [result.likelihood.where(result.mask, 1 - result.likelihood) for result in results]
    for name, encoding, expected in (
        ("mask", "mono8", [result.mask.numpy() for result in results]),
        ("confidence", "mono8", [part.mul(255).round().byte().numpy() for part in sure]),
        ("overlay", "rgb8", [overlay(result) for result in results]),
    ):
        messages = [entry for entry in read_bag(path) if entry.topic == f"/segmentation/{name}"]
        assert [entry.stamp for entry in messages] == [STAMP + number for number in range(4)]
        for entry, pixels in zip(messages, expected, strict=True):
            message, stamp = entry.message, entry.message.header.stamp
            assert stamp.sec * 10**9 + stamp.nanosec == entry.stamp
            assert message.header.frame_id == "camera_optical"
            assert (message.encoding, message.height, message.width) == (encoding, 48, 64)
            assert np.array_equal(message.data.reshape(pixels.shape), pixels)


@pytest.mark.parametrize(
    ("stamps", "seconds", "expected"),
    [
        ([0, 5, 7], [0, 5, 7], [0, 5, 7]),  # a gap
        ([4, 4, 3.5], [0, 0.1, 0.2], [4, 4, 4]),  # less than MAX_DRIFT back: never backwards
        ([9000, 3, 4], [0, 1, 2], [9000, 9001, 9002]),  # a step: the time since the first
    ],
)
def test_messages_are_recorded_in_order_whatever_their_stamps(
    path: Path, stamps: list[float], seconds: list[float], expected: list[float]
):
    with closing(BagWriter(path, "camera", 0.6)) as bag:
        for number, (stamp, clock) in enumerate(zip(stamps, seconds, strict=True)):
            frame = item(STAMP + round(1e9 * stamp))
            bag.write(replace(frame, seconds=clock), detection(number))

    masks = [entry for entry in read_bag(path) if entry.topic == "/segmentation/mask"]
    assert [entry.stamp for entry in masks] == [STAMP + round(1e9 * at) for at in expected]
    headers = [entry.message.header.stamp for entry in masks]
    assert [time.sec * 10**9 + time.nanosec for time in headers] == [
        STAMP + round(1e9 * stamp) for stamp in stamps
    ]


def test_labels_come_once_before_the_first_mask_and_are_latched(path: Path):
    with closing(BagWriter(path, "camera", 0.6)) as bag:
        bag.write(item(STAMP), detection(0))
        bag.write(item(STAMP + 1), detection(1))
    messages = list(read_bag(path))
    assert [entry.topic for entry in messages].count("/segmentation/label_info") == 1
    assert messages[0].topic == "/segmentation/label_info"
    labels = messages[0].message
    classes = [(entry.class_id, entry.class_name) for entry in labels.class_map]
    assert classes == [(0, "background"), (1, "road")]
    assert labels.threshold == pytest.approx(0.6)
    with AnyReader([path]) as reader:
        ext: Any = {link.topic.rpartition("/")[2]: link.ext for link in reader.connections}
    if path.suffix == ".bag":
        assert (ext["label_info"].latching, ext["mask"].latching or 0) == (1, 0)
    else:
        labels, mask = (ext[name].offered_qos_profiles[0] for name in ("label_info", "mask"))
        assert labels.durability == QosDurability.TRANSIENT_LOCAL
        assert labels.reliability == QosReliability.RELIABLE
        assert mask.durability == QosDurability.VOLATILE


def test_an_error_in_between_keeps_the_finished_frames_and_the_next_run_replaces_it(path: Path):
    BagWriter(path, "camera", 0.5).close()  # nothing written leaves nothing
    assert not list(path.parent.iterdir())
    with pytest.raises(KeyboardInterrupt), closing(BagWriter(path, "camera", 0.5)) as bag:  # noqa: PT012
        bag.write(item(STAMP), detection(0))
        raise KeyboardInterrupt
    assert [entry.topic for entry in read_bag(path)][1] == "/segmentation/mask"

    with closing(BagWriter(path, "camera", 0.5)) as bag:
        bag.write(item(STAMP), detection(1))
        assert len(list(read_bag(path))) == 3

    (mask,) = [entry.message for entry in read_bag(path) if entry.topic == "/segmentation/mask"]
    assert np.array_equal(mask.data.reshape(48, 64), detection(1).mask.numpy())
    assert list(path.parent.iterdir()) == [path]


def test_what_a_killed_run_left_goes_and_all_else_stays(path: Path):
    leftover = path.with_name(f"{path.name}.0123abcd.unfinished")
    sibling = path.with_name(f"other{path.name}.0123abcd.unfinished")
    for folder in (leftover, sibling):
        folder.mkdir(parents=True)
        (folder / path.name).touch()
    with closing(BagWriter(path, "camera", 0.5)) as bag:
        assert leftover.exists()
        bag.write(item(STAMP), detection(0))
    assert sorted(path.parent.iterdir()) == sorted([path, sibling])


def test_a_failing_disk_is_one_line(path: Path, monkeypatch: pytest.MonkeyPatch):
    bag = BagWriter(path, "camera", 0.5)
    bag.write(item(STAMP), detection(0))

    def fail(*_: Any) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(bag._writer, "write", fail)
    with pytest.raises(
        InputError, match=r"No space left on device; finished frames are in .*unfin"
    ):
        bag.write(item(STAMP), detection(1))
    bag.close()


def test_the_label_list_is_the_type_that_ros_knows():
    # ROS 2's own hash of vision_msgs/msg/LabelInfo (REP 2016), as rosidl_generator_c writes it.
    expected = "RIHS01_3d37df4015cdf660cc851c51897f2acd957e1ca6205ba0a99aebffb9406b0783"
    assert load_message_types(2).hash_rihs01("vision_msgs/msg/LabelInfo") == expected
