"""Messages of ROS 2, made of what was found; their classes are of the user's ROS."""

import importlib
from collections.abc import Mapping
from typing import Any

import numpy as np

from roadtorch.base.errors import ConfigError
from roadtorch.camera.ground_grid import Grid
from roadtorch.run.writers.bag import CLASS_NAMES

HINT = "source the setup.bash of ROS 2 first, or pip install 'roadtorch[ros]'"

OK, WARN = 0, 1
"""diagnostic_msgs/DiagnosticStatus, as numbers: its constants are bytes."""


def ros_module(name: str) -> Any:
    """A module of ROS 2, ``sensor_msgs.msg``; ConfigError where it cannot be imported."""
    try:
        return importlib.import_module(name)
    except ImportError:
        raise ConfigError("ros", f"{name.partition('.')[0]} is not installed", HINT) from None


def image_message(header: Any, pixels: np.ndarray) -> Any:
    """sensor_msgs/Image with that header: mono8 of pixels uint8 (H,W), rgb8 of (H,W,3)."""
    message = ros_module("sensor_msgs.msg").Image(header=header)
    message.height, message.width = pixels.shape[:2]
    message.encoding = "mono8" if pixels.ndim == 2 else "rgb8"
    message.step = pixels[0].size
    message.data.frombytes(np.ascontiguousarray(pixels).tobytes())
    return message


def grid_message(header: Any, grid: Grid, frame_id: str) -> Any:
    """nav_msgs/OccupancyGrid: 0 free, 100 not road, -1 unknown; in the robot's frame."""
    message = ros_module("nav_msgs.msg").OccupancyGrid()
    message.header.stamp, message.header.frame_id = header.stamp, frame_id
    about = message.info
    about.map_load_time, about.resolution = header.stamp, grid.resolution
    about.height, about.width = grid.cells.shape
    about.origin.position.x, about.origin.position.y = map(float, grid.origin)
    about.origin.orientation.w = 1.0
    message.data.frombytes(np.ascontiguousarray(grid.cells.cpu().numpy(), np.int8).tobytes())
    return message


def label_info_message(threshold: float) -> Any:
    """vision_msgs/LabelInfo with the names of the mask's numbers."""
    kinds = ros_module("vision_msgs.msg")
    classes = [kinds.VisionClass(class_id=n, class_name=name) for n, name in CLASS_NAMES.items()]
    return kinds.LabelInfo(class_map=classes, threshold=float(threshold))


def diagnostics_message(stamp: Any, words: str, values: Mapping[str, object]) -> Any:
    """diagnostic_msgs/DiagnosticArray with one status; a warning where there are words."""
    kinds = ros_module("diagnostic_msgs.msg")
    pairs = [kinds.KeyValue(key=key, value=str(value)) for key, value in values.items()]
    level = bytes([WARN if words else OK])
    status = kinds.DiagnosticStatus(
        level=level, name="roadtorch: road", message=words or "OK", values=pairs
    )
    message = kinds.DiagnosticArray(status=[status])
    message.header.stamp = stamp
    return message
