"""Bags as results: what is written is read again by rosbags, bit for bit."""

import errno
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
import torch
from rosbags.highlevel import AnyReader
from rosbags.interfaces import QosDurability, QosReliability

from roadtorch.base.errors import InputError
from roadtorch.detectors.detector import Detection
from roadtorch.inputs.bags import bag_source, image_topic
from roadtorch.inputs.item import Item
from roadtorch.run.writers.bag import BagWriter, message_types, occupancy_message
from tests.inputs.bags import ROS2, raw_image, write_bag

STAMP = 1_700_000_000_123_456_789


def detection(seed: int, size: tuple[int, int] = (48, 64)) -> Detection:
    likelihood = torch.rand(size, generator=torch.Generator().manual_seed(seed))
    return Detection(likelihood, likelihood > 0.6, {})


def item(stamp: int) -> Item:
    return Item(f"{stamp}", f"{stamp}", torch.rand, stamp=stamp)


def overlay(seen: Detection) -> np.ndarray:
    return np.repeat((seen.likelihood * 255).byte().numpy()[..., None], 3, 2)


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
    with closing(BagWriter(path, "camera_optical", 0.6, overlay)) as bag:
        for number in range(7):
            bag.write(item(STAMP + number), detection(number))
    topic = image_topic(str(path), "/segmentation/mask")
    generation = 1 if path.suffix == ".bag" else 2
    assert (topic.frame_id, topic.count, topic.generation) == ("camera_optical", 7, generation)
    frames = list(bag_source(str(path), "/segmentation/mask").items())
    assert torch.equal(frames[1].read()[0] * 255, detection(1).mask.float())
    found = list(read_bag(path))
    for topic in ("/segmentation/mask", "/segmentation/confidence", "/segmentation/overlay"):
        of_topic = [one for one in found if one.topic == topic]
        assert [one.stamp for one in of_topic] == [STAMP + number for number in range(7)]
        for number, one in enumerate(of_topic):
            head = one.message.header
            assert head.stamp.sec * 10**9 + head.stamp.nanosec == STAMP + number
            assert head.frame_id == "camera_optical"
            shape = (one.message.height, one.message.width)
            assert shape == (48, 64)
            seen = detection(number)
            if topic.endswith("mask"):
                assert one.message.encoding == "mono8"
                assert np.array_equal(one.message.data.reshape(shape), seen.mask.numpy())
            elif topic.endswith("confidence"):
                likely = torch.where(seen.mask, seen.likelihood, 1 - seen.likelihood)
                expected = likely.mul(255).round().to(torch.uint8).numpy()
                assert one.message.encoding == "mono8"
                assert np.array_equal(one.message.data.reshape(shape), expected)
            else:
                assert one.message.encoding == "rgb8"
                assert np.array_equal(one.message.data.reshape(*shape, 3), overlay(seen))


def test_labels_come_once_before_the_first_mask_and_are_latched(path: Path):
    with closing(BagWriter(path, "camera", 0.6)) as bag:
        bag.write(item(STAMP), detection(0))
        bag.write(item(STAMP + 1), detection(1))
    found = list(read_bag(path))
    assert [one.topic for one in found].count("/segmentation/label_info") == 1
    assert found[0].topic == "/segmentation/label_info"
    labels = found[0].message
    named = [(one.class_id, one.class_name) for one in labels.class_map]
    assert named == [(0, "background"), (1, "road")]
    assert labels.threshold == pytest.approx(0.6)
    with AnyReader([path]) as reader:
        ext: Any = {link.topic: link.ext for link in reader.connections}
    if path.suffix == ".bag":
        assert ext["/segmentation/label_info"].latching == 1
        assert not ext["/segmentation/mask"].latching
        return
    profile = ext["/segmentation/label_info"].offered_qos_profiles[0]
    assert profile.durability == QosDurability.TRANSIENT_LOCAL
    assert profile.reliability == QosReliability.RELIABLE
    mask = ext["/segmentation/mask"].offered_qos_profiles[0]
    assert mask.durability == QosDurability.VOLATILE


def test_an_error_in_between_keeps_the_finished_frames(path: Path):
    BagWriter(path, "camera", 0.5).close()  # nothing written leaves nothing
    assert not list(path.parent.iterdir())
    with pytest.raises(KeyboardInterrupt), closing(BagWriter(path, "camera", 0.5)) as bag:  # noqa: PT012
        bag.write(item(STAMP), detection(0))
        raise KeyboardInterrupt
    assert [one.topic for one in read_bag(path)][1] == "/segmentation/mask"
    assert list(path.parent.iterdir()) == [path]


def test_an_earlier_bag_of_ours_is_replaced_at_the_end(path: Path):
    for seed in (0, 1):
        with closing(BagWriter(path, "camera", 0.5)) as bag:
            bag.write(item(STAMP), detection(seed))
            if seed:
                assert len(list(read_bag(path))) == 3
    (mask,) = [one.message for one in read_bag(path) if one.topic == "/segmentation/mask"]
    assert np.array_equal(mask.data.reshape(48, 64), detection(1).mask.numpy())
    assert list(path.parent.iterdir()) == [path]


def test_what_a_killed_run_left_goes_and_all_else_stays(path: Path):
    left = path.with_name(f"{path.name}.0123abcd.unfinished")
    other = path.with_name(f"other{path.name}.0123abcd.unfinished")
    for folder in (left, other):
        folder.mkdir(parents=True)
        (folder / path.name).touch()
    with closing(BagWriter(path, "camera", 0.5)) as bag:
        assert left.exists()
        bag.write(item(STAMP), detection(0))
    assert sorted(path.parent.iterdir()) == sorted([path, other])


def test_anything_else_of_that_name_is_refused(path: Path, tmp_path: Path):
    path.mkdir(parents=True)
    with pytest.raises(InputError, match="exists already, and is no bag of ours"):
        BagWriter(path, "camera", 0.5)
    images = {"/camera/image": [raw_image(ROS2, overlay(detection(0)), "rgb8", STAMP)]}
    recording = write_bag(tmp_path / "recording", images)
    with pytest.raises(InputError, match="exists already, and is no bag of ours"):
        BagWriter(recording, "camera", 0.5)


def test_a_failing_disk_is_one_line(path: Path, monkeypatch: pytest.MonkeyPatch):
    bag = BagWriter(path, "camera", 0.5)
    bag.write(item(STAMP), detection(0))

    def fail(*_: Any) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(bag._writer, "write", fail)
    with pytest.raises(InputError, match=r"No space left on device; what there is lies in .*unfin"):
        bag.write(item(STAMP), detection(1))
    bag.close()


def test_the_label_list_is_the_type_that_ros_knows():
    # ROS 2's own hash of vision_msgs/msg/LabelInfo (REP 2016), as rosidl_generator_c writes it.
    known = "RIHS01_3d37df4015cdf660cc851c51897f2acd957e1ca6205ba0a99aebffb9406b0783"
    assert message_types(2).hash_rihs01("vision_msgs/msg/LabelInfo") == known


# --- grids ------------------------------------------------------------------------------


@pytest.mark.parametrize("generation", [1, 2])
def test_a_grid_has_its_place(tmp_path: Path, generation: int):
    path = tmp_path / ("grids.bag" if generation == 1 else "grids")
    grid = np.array([[0, 100, -1], [100, 0, 0]], np.int8)
    with closing(BagWriter(path, "camera", 0.5)) as bag:
        bag.write_grid(grid, 0.1, (2.0, -5.0), STAMP, "base_link")
    (found,) = read_bag(path)
    message = found.message
    assert found.topic == "/segmentation/grid"
    assert np.array_equal(message.data.reshape(2, 3), grid)
    assert (message.info.width, message.info.height) == (3, 2)
    assert message.info.resolution == pytest.approx(0.1)
    place, turn = message.info.origin.position, message.info.origin.orientation
    assert (place.x, place.y, place.z) == (2, -5, 0)
    assert (turn.x, turn.y, turn.z, turn.w) == (0, 0, 0, 1)
    assert message.header.frame_id == "base_link"


@pytest.mark.parametrize(
    "grid", [np.zeros((2, 2)), np.full((2, 2), 101, np.int8), np.zeros(4, np.int8)]
)
def test_what_is_no_grid_is_refused(grid: np.ndarray):
    with pytest.raises(ValueError, match="a grid is int8"):
        occupancy_message(message_types(2), grid, 0.1, (0, 0), 0, "map")
