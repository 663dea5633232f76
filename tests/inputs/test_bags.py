"""Images in bags: every format, every encoding, topics, time stamps, damage."""

import sqlite3
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import torch

from roadtorch.base.errors import ConfigError, InputError
from roadtorch.inputs.bags import bag_source, camera_info, image_topic, is_bag
from roadtorch.inputs.image_messages import decode_message
from roadtorch.inputs.item import Selection
from tests.inputs.bags import (
    FIRST,
    ROS1,
    ROS2,
    STEP,
    calibration,
    compressed_image,
    raw_image,
    write_bag,
)

TOPIC = "/camera/image_raw"


def scene(seed: int, size: tuple[int, int] = (48, 64)) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, (*size, 3)).astype(np.uint8)


def store_of(form: str) -> Any:
    return ROS1 if form == "bag" else ROS2


def written(folder: Path, form: str, count: int = 5, size: tuple[int, int] = (48, 64)) -> Path:
    """Write a bag of scenes whose header stamps are half a second later than the recording's."""
    store = store_of(form)
    images = [
        raw_image(store, scene(n, size), "rgb8", FIRST + STEP * n + STEP * 5) for n in range(count)
    ]
    infos = [calibration(store, FIRST)]
    topics = {TOPIC: images, "/camera/camera_info": infos}
    return write_bag(folder / ("drive.bag" if form == "bag" else "drive"), topics, form)


@pytest.mark.parametrize("form", ["bag", "sqlite3", "mcap"])
def test_gives_the_images_with_their_time_stamps_and_the_camera(tmp_path: Path, form: str):
    path = str(written(tmp_path, form))
    source, info = bag_source(path), camera_info(path)
    assert is_bag(path)
    assert source.count == 5
    assert source.rate == pytest.approx(10)
    for number, frame in enumerate(source.items()):
        assert (frame.name, frame.number) == (f"drive/{number:06}", number)
        assert frame.stamp == FIRST + STEP * (number + 5)
        assert frame.seconds == pytest.approx(number / 10)
        pixels = (frame.read() * 255).round().to(torch.uint8).permute(1, 2, 0).numpy()
        assert np.array_equal(pixels, scene(number))
    frames = bag_source(path, Selection(every=2, start=0.1, limit=2, topic=TOPIC)).items()
    assert [frame.number for frame in frames] == [1, 3]
    assert info.matrix.tolist() == [[300, 0, 32], [0, 300, 24], [0, 0, 1]]
    assert info.coefficients == (0.1, -0.2, 0, 0, 0)
    assert (info.model, info.width, info.height) == ("plumb_bob", 64, 48)


@pytest.mark.parametrize("form", ["bag", "mcap"])
def test_reads_compressed_images(tmp_path: Path, form: str):
    store = store_of(form)
    data = [cv2.imencode(".png", scene(n)[..., ::-1])[1].tobytes() for n in range(2)]
    data.append(cv2.imencode(".jpg", scene(2)[..., ::-1])[1].tobytes())
    images = [compressed_image(store, encoded, 0) for encoded in data]
    topics = {f"{TOPIC}/compressed": images, "/camera/camera_info": [calibration(store, 0)]}
    path = str(write_bag(tmp_path / ("a.bag" if form == "bag" else "a"), topics, form))
    frames = list(bag_source(path).items())
    assert torch.equal(frames[1].read(), torch.from_numpy(scene(1)).permute(2, 0, 1) / 255)
    assert frames[2].read().shape == (3, 48, 64)
    # Headers without a time: that of the recording.
    assert [frame.stamp for frame in frames] == [FIRST, FIRST + STEP, FIRST + 2 * STEP]
    assert camera_info(path).width == 64


@pytest.mark.parametrize(
    ("topic", "model", "focal", "coefficients"),
    [
        ("/camera/image_raw", "plumb_bob", 300, (0.1, -0.2, 0, 0, 0)),
        ("/camera/image_rect_color", "plumb_bob", 250, ()),
        ("/camera/image_rect_color", "equidistant", 250, ()),
        ("/camera/image_rect/compressed", "plumb_bob", 250, ()),
        ("/camera/correct", "plumb_bob", 300, (0.1, -0.2, 0, 0, 0)),
    ],
)
def test_rectified_images_have_the_lens_p(
    topic: str, model: str, focal: float, coefficients: tuple[float, ...], tmp_path: Path
) -> None:
    info, data = calibration(ROS2, FIRST), cv2.imencode(".png", scene(0))[1].tobytes()
    info.p[:] = [250, 0, 31, -9, 0, 260, 23, 0, 0, 0, 1, 0]
    info.distortion_model = model
    is_compressed = topic.endswith("compressed")
    image = compressed_image(ROS2, data, 0) if is_compressed else IMAGES[0]
    path = write_bag(tmp_path / "a", {topic: [image], "/camera/camera_info": [info]})

    lens = camera_info(str(path), topic)

    assert (lens.focal_x, lens.coefficients) == (focal, coefficients)


@pytest.mark.parametrize("form", ["sqlite3", "mcap"])
def test_reads_a_single_file_and_a_folder_without_its_list(tmp_path: Path, form: str):
    folder = written(tmp_path, form)
    file = next(path for path in folder.iterdir() if path.suffix in (".db3", ".mcap"))
    assert is_bag(str(file))
    assert bag_source(str(file)).count == 5
    (folder / "metadata.yaml").unlink()
    assert is_bag(str(folder))
    assert len(list(bag_source(str(folder)).items())) == 5


IMAGES, INFOS = [raw_image(ROS2, scene(0), "rgb8", FIRST)], [calibration(ROS2, 0)]
Topics = dict[str, list[Any]]
TWO = {"/left/image": IMAGES, "/right/image": IMAGES}
NO_P = {"/camera/image_rect": IMAGES, "/camera/camera_info": INFOS}
UNKNOWN = {TOPIC: IMAGES, "/camera/camera_info": [calibration(ROS2, 0, 0.0)]}


@pytest.mark.parametrize(
    ("read", "topics", "topic", "error"),
    [
        (image_topic, TWO, None, r"has 2 topics with images \(--topic: give one of /left/image,"),
        (image_topic, TWO, "/right/imag", r"/right/imag: unknown topic \(did you mean /right/im"),
        (image_topic, {"/camera/camera_info": INFOS}, None, "has no images .there is /camera/came"),
        (image_topic, UNKNOWN, "/camera/camera_info", "has sensor_msgs/msg/CameraInfo on /camera"),
        (camera_info, {"/image": IMAGES}, None, "has no camera_info /camera_info beside /image"),
        (camera_info, NO_P, "/camera/image_rect", "has D but no P, and /camera/image_rect"),
        (camera_info, UNKNOWN, None, "bag:/camera/camera_info: has no calibration"),
    ],
)
def test_what_is_not_there_or_has_to_be_chosen(
    tmp_path: Path, read: Callable[..., object], topics: Topics, topic: str | None, error: str
) -> None:
    path = str(write_bag(tmp_path / "bag", topics))

    with pytest.raises((InputError, ConfigError), match=error):
        read(path, topic)


def test_frames_come_in_the_order_of_recording_whatever_their_stamps(tmp_path: Path) -> None:
    stamps = [5 - FIRST // STEP, 6 - FIRST // STEP, 2, 3, 4]  # 1970, then today
    images = [raw_image(ROS2, scene(n), "rgb8", FIRST + STEP * at) for n, at in enumerate(stamps)]
    path = str(write_bag(tmp_path / "drive", {TOPIC: images}))

    with pytest.warns(UserWarning, match=r"drive: the clock steps by [+-]\d+\.\d s at") as caught:
        frames = list(bag_source(path).items())

    assert len(caught) == 1
    assert [frame.seconds for frame in frames] == pytest.approx([0, 0.1, 0.2, 0.3, 0.4])
    assert [frame.stamp for frame in frames] == [FIRST + STEP * at for at in stamps]
    with pytest.warns(UserWarning, match="the clock steps"):
        late = list(bag_source(path, selection=Selection(start=0.15, end=0.35)).items())
    assert [frame.number for frame in late] == [2, 3]


# --- encodings --------------------------------------------------------------------------


def decoded(pixels: np.ndarray, encoding: str, **replaced: Any) -> np.ndarray:
    message = raw_image(ROS2, pixels, encoding, 0, **replaced)
    return decode_message(message, "a frame").permute(1, 2, 0).numpy()


@pytest.mark.parametrize(
    ("encoding", "order"),
    [("rgb8", [0, 1, 2]), ("bgr8", [2, 1, 0]), ("rgba8", [0, 1, 2, 0]), ("bgra8", [2, 1, 0, 1])],
)
def test_colours_are_in_their_places(encoding: str, order: list[int]):
    assert np.array_equal(decoded(scene(1)[..., order], encoding), scene(1) / np.float32(255))


def test_grey_of_8_and_16_bits():
    grey = scene(2)[..., 0]
    assert np.array_equal(decoded(grey, "mono8"), np.stack([grey] * 3, -1) / np.float32(255))
    deep = grey.astype(np.uint16) * 256 + 7
    little, big = decoded(deep.astype("<u2"), "mono16"), decoded(deep.astype(">u2"), "mono16")
    assert np.allclose(little, (deep / 65535)[..., None], atol=1e-6)
    assert np.array_equal(decoded(deep.astype(">u2"), "mono16", is_bigendian=1), little)
    assert not np.array_equal(big, little)


@pytest.mark.parametrize("pattern", ["rggb", "bggr", "gbrg", "grbg"])
@pytest.mark.parametrize("bits", [8, 16])
def test_mosaics_of_an_even_colour(pattern: str, bits: int):
    colour = {"r": 200, "g": 90, "b": 30}
    mosaic = np.zeros((8, 10), np.uint8)
    for at, letter in enumerate(pattern):
        mosaic[at // 2 :: 2, at % 2 :: 2] = colour[letter]
    deep = mosaic if bits == 8 else mosaic.astype("<u2") * 257
    image = decoded(deep, f"bayer_{pattern}{bits}")
    assert np.allclose(image, np.array([200, 90, 30]) / 255, atol=1e-5)


@pytest.mark.parametrize(
    ("encoding", "luma"), [("yuv422", 1), ("uyvy", 1), ("yuv422_yuy2", 0), ("yuyv", 0)]
)
def test_yuv_of_an_even_colour(encoding: str, luma: int):
    samples = np.zeros((6, 8, 2), np.uint8)
    samples[..., luma] = 81  # BT.601: pure red is (81, 90, 240)
    samples[:, 0::2, 1 - luma], samples[:, 1::2, 1 - luma] = 90, 240
    assert np.allclose(decoded(samples, encoding), [1, 0, 0], atol=0.02)


def test_rows_with_padding():
    padded = np.full((48, 70 * 3), 77, np.uint8)
    padded[:, : 64 * 3] = scene(3).reshape(48, -1)
    whole = padded.ravel()
    for data in (whole, whole[: -6 * 3]):  # the last row with and without its padding
        image = decoded(scene(3), "rgb8", step=210, data=data)
        assert np.array_equal(image, scene(3) / np.float32(255))


@pytest.mark.parametrize(
    ("fields", "match"),
    [
        ({"data": np.zeros(5, np.uint8)}, r"a frame: cannot be read: it has 5 bytes for 64 by 48"),
        ({"step": 7}, "7 a row"),
        ({"width": 10**5, "height": 10**4}, "has 100000 by 10000 pixels"),
        ({"encoding": "32FC1"}, "has the encoding '32FC1', which is not read .record one of mono8"),
    ],
)
def test_a_message_that_cannot_be_an_image_is_told(fields: dict[str, Any], match: str):
    with pytest.raises(InputError, match=match):
        decoded(scene(0), fields.pop("encoding", "rgb8"), **fields)


# --- damage -----------------------------------------------------------------------------


def test_one_bad_message_leaves_the_others(tmp_path: Path):
    images = [raw_image(ROS2, scene(n), "rgb8", FIRST) for n in range(3)]
    images[1].encoding = "magic"
    frames = list(bag_source(str(write_bag(tmp_path / "bag", {TOPIC: images}))).items())
    assert frames[2].read().shape == (3, 48, 64)
    with pytest.raises(InputError, match=r"bag:/camera/image_raw#1: has the encoding 'magic'"):
        frames[1].read()


@pytest.mark.parametrize(
    ("form", "inside", "command"),
    [
        ("bag", False, "rosbag reindex"),
        ("mcap", True, "mcap recover"),
        ("sqlite3", False, "ros2 bag reindex"),
    ],
)
def test_a_cut_bag_names_its_mending(tmp_path: Path, form: str, inside: bool, command: str) -> None:
    path = written(tmp_path, form)
    file = next(path.glob("*.[dm]*[3p]")) if path.is_dir() else path
    file.write_bytes(file.read_bytes()[: file.stat().st_size * 6 // 10])
    origin = str(file if inside else path)

    with pytest.raises(InputError, match=r"can(not)? be read") as caught:
        deque(bag_source(origin).items(), maxlen=0)

    assert caught.value.where == origin
    assert f"if its end is missing: {command}" in caught.value.hint
    assert "\n" not in str(caught.value)


def test_messages_that_are_gone_are_told_in_numbers(tmp_path: Path):
    path = written(tmp_path, "sqlite3", count=12)
    with sqlite3.connect(next(path.glob("*.db3"))) as base:
        base.execute("DELETE FROM messages WHERE id % 4 = 0")
    frames = bag_source(str(path)).items()

    with pytest.raises(InputError, match=r"only [89] of 12 frames can be read"):
        deque(frames, maxlen=0)
