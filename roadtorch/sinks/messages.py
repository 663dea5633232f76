"""What a robot reads of a detection, as ROS messages.

The masks are those of Nav2's semantic segmentation layer (kiwicampus/semantic_segmentation_layer,
README, "Required Topics and Message Types"): class numbers and confidences 0…255, both mono8, and
vision_msgs/LabelInfo with the names of the classes. The layer pairs masks, confidences and point
clouds whose time stamps are equal to the nanosecond.
"""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from roadtorch.detection import Detection

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

IMAGE, LABEL_INFO = "sensor_msgs/msg/Image", "vision_msgs/msg/LabelInfo"
GRID = "nav_msgs/msg/OccupancyGrid"
CLASSES: Mapping[int, str] = {0: "background", 1: "road"}

VISION_MESSAGES = {
    "vision_msgs/msg/VisionClass": "uint16 class_id\nstring class_name\n",
    LABEL_INFO: (
        "std_msgs/Header header\nvision_msgs/VisionClass[] class_map\nfloat32 threshold\n"
    ),
}
"""Definitions (ros-perception/vision_msgs, branch ros2, without its comments)."""


def message_types(generation: int) -> "Typestore":
    """The message types of ROS 1 (Noetic) or 2 (Humble; the same in later ones), labels among them.

    generation: 1 or 2. Raises ImportError without rosbags.
    """
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    types = get_typestore(Stores.ROS1_NOETIC if generation == 1 else Stores.ROS2_HUMBLE)
    for name, text in VISION_MESSAGES.items():
        types.register(get_types_from_msg(text, name))
    return types


def header(types: "Typestore", stamp: int, frame_id: str) -> Any:
    """std_msgs/Header; stamp in nanoseconds."""
    kind: Any = types.types["std_msgs/msg/Header"]
    time = types.types["builtin_interfaces/msg/Time"](*divmod(stamp, 10**9))
    numbered = {"seq": 0} if "seq" in kind.__dataclass_fields__ else {}  # ROS 1
    return kind(**numbered, stamp=time, frame_id=frame_id)


def image_of_pixels(types: "Typestore", pixels: np.ndarray, stamp: int, frame_id: str) -> Any:
    """Pixels uint8 (H,W) or (H,W,3) RGB as sensor_msgs/Image, mono8 or rgb8."""
    height, width = pixels.shape[:2]
    return types.types[IMAGE](
        header=header(types, stamp, frame_id),
        height=height,
        width=width,
        encoding="mono8" if pixels.ndim == 2 else "rgb8",
        is_bigendian=0,
        step=pixels[0].size,
        data=np.ascontiguousarray(pixels).reshape(-1),
    )


def confidences(detection: Detection) -> np.ndarray:
    """How likely each pixel's class is, uint8 (H,W): 255 is certain.

    Of road the likelihood, of the rest what is missing to 1: the probability of the class that the
    mask has, as the tutorial's node gives it (navigation2_tutorials, segmentation_node.py).
    """
    likely = detection.likelihood.where(detection.mask, 1 - detection.likelihood)
    return likely.clamp(0, 1).mul(255).round().cpu().numpy().astype(np.uint8)


def label_info(types: "Typestore", stamp: int, threshold: float) -> Any:
    """vision_msgs/LabelInfo: the names of ``CLASSES``, and the threshold of the decision."""
    kind: Any = types.types["vision_msgs/msg/VisionClass"]
    info: Any = types.types[LABEL_INFO]
    classes = [kind(class_id=number, class_name=name) for number, name in CLASSES.items()]
    return info(header(types, stamp, ""), classes, threshold)


def occupancy_message(
    types: "Typestore",
    grid: np.ndarray,
    resolution: float,
    origin: tuple[float, float],
    stamp: int,
    frame_id: str,
) -> Any:
    """A grid int8 (H,W) as nav_msgs/OccupancyGrid: 0 free, 100 not road, -1 unknown.

    Row 0, column 0 is the cell whose corner is ``origin``, (x, y) in metres in ``frame_id``;
    columns go along x, rows along y (REP 103: x ahead, y left). resolution: metres a cell. Raises
    ValueError for a grid of another type or other values.
    """
    values = np.ascontiguousarray(grid)
    if values.ndim != 2 or values.dtype != np.int8 or values.min() < -1 or values.max() > 100:
        raise ValueError(f"a grid is int8 (H,W) from -1 to 100, not {grid.dtype} {grid.shape}")
    found = types.types
    pose = found["geometry_msgs/msg/Pose"](
        found["geometry_msgs/msg/Point"](*map(float, origin), 0.0),
        found["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0),
    )
    head = header(types, stamp, frame_id)
    height, width = values.shape
    about = found["nav_msgs/msg/MapMetaData"](head.stamp, resolution, width, height, pose)
    return found[GRID](head, about, values.reshape(-1))
