"""Bags for tests: images of one topic or several, in all formats."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

FIRST = 1_700_000_000_000_000_000  # ns
STEP = 100_000_000

ROS1 = get_typestore(Stores.ROS1_NOETIC)
ROS2 = get_typestore(Stores.ROS2_HUMBLE)


def header(store: Any, stamp: int, frame_id: str = "camera_optical") -> Any:
    kind, time = store.types["std_msgs/msg/Header"], store.types["builtin_interfaces/msg/Time"]
    numbered = {"seq": 0} if store is ROS1 else {}
    return kind(**numbered, stamp=time(*divmod(stamp, 10**9)), frame_id=frame_id)


def raw_image(store: Any, pixels: np.ndarray, encoding: str, stamp: int, **replaced: Any) -> Any:
    """Return uint8 or uint16 (H, W[, C]) as sensor_msgs/Image, some fields replaced."""
    height, width = pixels.shape[:2]
    fields = {
        "header": header(store, stamp),
        "height": height,
        "width": width,
        "encoding": encoding,
        "is_bigendian": 0,
        "step": pixels[0].nbytes,
        "data": np.frombuffer(pixels.tobytes(), np.uint8),
    }
    return store.types["sensor_msgs/msg/Image"](**(fields | replaced))


def compressed_image(store: Any, data: bytes, stamp: int, form: str = "jpeg") -> Any:
    kind = store.types["sensor_msgs/msg/CompressedImage"]
    return kind(header(store, stamp), form, np.frombuffer(data, np.uint8))


def calibration(
    store: Any,
    stamp: int,
    focal: float = 300.0,
    size: tuple[int, int] = (48, 64),
    bent: Sequence[float] = (0.1, -0.2, 0, 0, 0),
) -> Any:
    """Return a sensor_msgs/CameraInfo; size: height and width."""
    height, width = size
    kind = store.types["sensor_msgs/msg/CameraInfo"]
    matrix = np.array([focal, 0, width / 2, 0, focal, height / 2, 0, 0, 1], float)
    region = store.types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
    values = (np.array(bent, float), matrix, np.eye(3).ravel(), np.zeros(12))
    return kind(header(store, stamp), height, width, "plumb_bob", *values, 0, 0, region)


def write_bag(path: Path, topics: Mapping[str, Sequence[Any]], form: str = "mcap") -> Path:
    """Write a ``bag``, ``sqlite3`` or ``mcap`` with a message every 0.1 s on each topic."""
    if form == "bag":
        writer, store = Writer1(path), ROS1
    else:
        writer, store = Writer2(path, version=8, storage_plugin=StoragePlugin[form.upper()]), ROS2
    with writer as bag:
        links = {
            name: bag.add_connection(name, messages[0].__msgtype__, typestore=store)
            for name, messages in topics.items()
        }
        entries = [
            (FIRST + STEP * number, name, message)
            for name, messages in topics.items()
            for number, message in enumerate(messages)
        ]
        pack = store.serialize_ros1 if form == "bag" else store.serialize_cdr
        for stamp, name, message in sorted(entries, key=lambda entry: entry[:2]):
            bag.write(links[name], stamp, pack(message, message.__msgtype__))
    return path


def write_drive(
    folder: Path,
    form: str,
    images: Sequence[np.ndarray],
    focal: float,
    stamps: Sequence[int] | None = None,
) -> Path:
    """Write images uint8 (H, W, 3) of a pinhole to the bag ``drive`` or ``drive.bag``.

    stamps: of the headers, by default 7 ns after the times of recording.
    """
    store = ROS1 if form == "bag" else ROS2
    stamps = stamps or [FIRST + STEP * number + 7 for number in range(len(images))]
    messages = [
        raw_image(store, pixels, "rgb8", stamp)
        for pixels, stamp in zip(images, stamps, strict=True)
    ]
    info = calibration(store, FIRST, focal, images[0].shape[:2], (0.0,) * 5)
    topics = {"/camera/image_raw": messages, "/camera/camera_info": [info]}
    return write_bag(folder / ("drive.bag" if form == "bag" else "drive"), topics, form)
