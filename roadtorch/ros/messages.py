"""ROS 2 messages of detections, with the message classes of the installed ROS."""

import importlib
from collections.abc import Mapping
from typing import Any

import numpy as np

from roadtorch.base.errors import ConfigError
from roadtorch.camera.ground_grid import Grid
from roadtorch.run.writers.bag import MASK_CLASS_NAMES

INSTALL_HINT = "source the setup.bash of ROS 2 first, or pip install 'roadtorch[ros]'"

OK, WARN = 0, 1
"""Levels of diagnostic_msgs/DiagnosticStatus as numbers: its own constants are bytes."""


def import_ros(name: str) -> Any:
    """Import a module of ROS 2, such as ``sensor_msgs.msg``; ConfigError where it is missing."""
    try:
        return importlib.import_module(name)
    except ImportError:
        problem = f"{name.partition('.')[0]} is not installed"
        raise ConfigError("ros", problem, INSTALL_HINT) from None


def image_message(header: Any, pixels: np.ndarray) -> Any:
    """Return a sensor_msgs/Image: mono8 of uint8 pixels (H, W), rgb8 of (H, W, 3)."""
    message = import_ros("sensor_msgs.msg").Image(header=header)
    message.height, message.width = pixels.shape[:2]
    message.encoding = "mono8" if pixels.ndim == 2 else "rgb8"
    message.step = pixels[0].size
    message.data.frombytes(np.ascontiguousarray(pixels).tobytes())
    return message


def grid_message(header: Any, grid: Grid, frame_id: str) -> Any:
    """Return a nav_msgs/OccupancyGrid: 0 free, 100 not road, -1 unknown."""
    message = import_ros("nav_msgs.msg").OccupancyGrid()
    message.header.stamp, message.header.frame_id = header.stamp, frame_id
    info = message.info
    info.map_load_time, info.resolution = header.stamp, grid.resolution
    info.height, info.width = grid.cells.shape
    info.origin.position.x, info.origin.position.y = map(float, grid.origin)
    info.origin.orientation.w = 1.0
    message.data.frombytes(np.ascontiguousarray(grid.cells.cpu().numpy(), np.int8).tobytes())
    return message


def points_message(header: Any, points: np.ndarray) -> Any:
    """Return an organised sensor_msgs/PointCloud2 of points, float32, shape (H, W, 3)."""
    messages = import_ros("sensor_msgs.msg")
    message = messages.PointCloud2(header=header, point_step=12, is_dense=False)
    message.height, message.width = points.shape[:2]
    message.row_step = 12 * points.shape[1]
    message.fields = [
        messages.PointField(name=name, offset=offset, datatype=messages.PointField.FLOAT32, count=1)
        for name, offset in (("x", 0), ("y", 4), ("z", 8))
    ]
    message.data.frombytes(np.ascontiguousarray(points, "<f4").tobytes())
    return message


def label_info_message(threshold: float) -> Any:
    """Return a vision_msgs/LabelInfo with the names of the mask's classes."""
    messages = import_ros("vision_msgs.msg")
    names = MASK_CLASS_NAMES.items()
    classes = [messages.VisionClass(class_id=number, class_name=name) for number, name in names]
    return messages.LabelInfo(class_map=classes, threshold=float(threshold))


def diagnostic_status(name: str, warning: str, values: Mapping[str, object]) -> Any:
    """Return a diagnostic_msgs/DiagnosticStatus, OK without a warning."""
    messages = import_ros("diagnostic_msgs.msg")
    pairs = [messages.KeyValue(key=key, value=str(value)) for key, value in values.items()]
    level = bytes([WARN if warning else OK])
    return messages.DiagnosticStatus(
        level=level, name=f"roadtorch: {name}", message=warning or "OK", values=pairs
    )
