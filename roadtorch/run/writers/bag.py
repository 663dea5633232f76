"""A bag of what was found in footage, as Nav2's semantic segmentation layer reads it.

The masks are those of kiwicampus/semantic_segmentation_layer (README, "Required Topics and Message
Types"): class numbers and confidences 0…255, both mono8, and vision_msgs/LabelInfo with the names
of the classes. The layer pairs masks, confidences and point clouds whose time stamps are equal to
the nanosecond.
"""

import glob
import os
import secrets
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from roadtorch.base.atomic import make_folder, unwritable
from roadtorch.base.errors import ConfigError, InputError
from roadtorch.detectors.detection import Detection
from roadtorch.inputs.item import Item

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

MASK, CONFIDENCE = "/segmentation/mask", "/segmentation/confidence"
OVERLAY, LABELS = "/segmentation/overlay", "/segmentation/label_info"
GRIDS = "/segmentation/grid"

BAG_VERSION = 8
"""Of the ROS 2 metadata: the newest whose quality-of-service profiles Humble reads too."""


class BagWriter:
    """A bag that is written frame by frame, and has its name once it is closed.

    path: ``NAME.bag`` becomes a bag of ROS 1, any other name the folder of one of ROS 2 (MCAP with
    zstd). frame_id: of the camera, as in the input's headers. threshold: of the mask. draw: of the
    overlay uint8 (H,W,3) RGB, where there is to be one.

    While it is written it lies in a folder ``NAME.….unfinished`` beside; ``close`` ends it and
    gives it its name, after an error or Ctrl-C too, with the frames that were written. An earlier
    bag of ours is replaced by ``close``; such folders that killed runs left go with the first
    frame. Raises InputError when ``path`` is anything else, ConfigError without rosbags.
    """

    def __init__(
        self,
        path: Path,
        frame_id: str,
        threshold: float,
        draw: Callable[[Detection], np.ndarray] | None = None,
    ) -> None:
        self._generation = 1 if path.suffix == ".bag" else 2
        try:
            self.types = message_types(self._generation)
        except ImportError:
            problem = "cannot be written without the package rosbags"
            raise ConfigError(str(path), problem, "pip install 'roadtorch[bags]'") from None
        if path.exists() and not is_result(path):
            problem = "exists already, and is no bag of ours"
            raise InputError(path, problem, "remove it, or give another name")
        make_folder(path.absolute().parent)
        self.path, self._frame_id, self._threshold, self._draw = path, frame_id, threshold, draw
        self._folder = path.with_name(f"{path.name}.{secrets.token_hex(4)}.unfinished")
        self._writer: Any = None
        self._links: dict[str, Any] = {}

    def write(self, item: Item, detection: Detection) -> Mapping[str, str]:
        """Add a frame: mask, confidence, overlay. InputError when it cannot be written."""
        types: Any = self.types.types
        stamp = item.nanoseconds
        if LABELS not in self._links:
            kind = types["vision_msgs/msg/VisionClass"]
            names = [kind(class_id=number, class_name=name) for number, name in CLASSES.items()]
            info = types[LABEL_INFO](header(self.types, stamp, ""), names, self._threshold)
            self._add(LABELS, LABEL_INFO, stamp, info)
        mask, confidence = pixels_of(detection)
        images = {MASK: mask, CONFIDENCE: confidence}
        images |= {OVERLAY: self._draw(detection)} if self._draw else {}
        for topic, pixels in images.items():
            image = types[IMAGE](
                header=header(self.types, stamp, self._frame_id),
                height=pixels.shape[0],
                width=pixels.shape[1],
                encoding="mono8" if pixels.ndim == 2 else "rgb8",
                is_bigendian=0,
                step=pixels[0].size,
                data=np.ascontiguousarray(pixels).reshape(-1),
            )
            self._add(topic, IMAGE, stamp, image)
        return {}

    def write_grid(
        self,
        grid: np.ndarray,
        resolution: float,
        origin: tuple[float, float],
        stamp: int,
        frame_id: str,
    ) -> None:
        """Add a grid as ``occupancy_message`` has it; InputError when it cannot be written."""
        message = occupancy_message(self.types, grid, resolution, origin, stamp, frame_id)
        self._add(GRIDS, GRID, stamp, message)

    def close(self) -> None:
        """End the bag and give it its name; there is none where nothing was written.

        Raises InputError when it cannot be written; what there is of it stays.
        """
        if self._writer is None:
            return
        writer, self._writer = self._writer, None
        try:
            writer.close()
            if self.path.exists():
                os.replace(self.path, self._folder / "earlier")
            os.replace(self._folder / self.path.name, self.path)
        except OSError as error:
            raise self._unwritable(error) from None
        shutil.rmtree(self._folder, ignore_errors=True)

    # --- inside -------------------------------------------------------------------------

    def _add(self, topic: str, kind: str, stamp: int, message: Any) -> None:
        try:
            writer = self._begin() if self._writer is None else self._writer
            if topic not in self._links:
                self._links[topic] = self._link(topic, kind)
            is_ros1 = self._generation == 1
            pack = self.types.serialize_ros1 if is_ros1 else self.types.serialize_cdr
            writer.write(self._links[topic], stamp, pack(message, kind))
        except OSError as error:
            raise self._unwritable(error) from None

    def _begin(self) -> Any:
        hexadecimal = "[0-9a-f]" * 8
        pattern = f"{glob.escape(self.path.name)}.{hexadecimal}.unfinished"
        for left in self.path.absolute().parent.glob(pattern):
            shutil.rmtree(left, ignore_errors=True)
        make_folder(self._folder)
        inside = self._folder / self.path.name
        if self._generation == 1:
            from rosbags.rosbag1 import Writer as Writer1

            writer: Any = Writer1(inside)
            writer.set_compression(Writer1.CompressionFormat.LZ4)
        else:
            from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
            from rosbags.rosbag2 import Writer as Writer2

            writer = Writer2(inside, version=BAG_VERSION, storage_plugin=StoragePlugin.MCAP)
            writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        writer.open()
        self._writer = writer
        return writer

    def _link(self, topic: str, kind: str) -> Any:
        """The connection of a topic; labels are kept for those who come late (latched)."""
        is_kept = topic == LABELS
        if self._generation == 1:
            options: dict[str, Any] = {"callerid": "/roadtorch", "latching": int(is_kept)}
        else:
            profile = _profile("TRANSIENT_LOCAL", 1) if is_kept else _profile("VOLATILE", 10)
            options = {"offered_qos_profiles": [profile]}
        return self._writer.add_connection(topic, kind, typestore=self.types, **options)

    def _unwritable(self, error: OSError) -> InputError:
        failure = unwritable(self.path, error)
        rest = f"; what there is lies in {self._folder}" if self._folder.exists() else ""
        return InputError(self.path, failure.problem + rest, failure.hint)


def is_result(path: Path) -> bool:
    """Whether a path is a bag with nothing but topics that ``BagWriter`` writes."""
    from rosbags.highlevel import AnyReader

    try:
        with AnyReader([path]) as reader:
            names = {link.topic for link in reader.connections}
    except Exception:  # it is no bag
        return False
    return bool(names) and names <= {MASK, CONFIDENCE, OVERLAY, LABELS, GRIDS}


def _profile(durability: str, depth: int) -> Any:
    """A reliable quality of service that keeps so many messages (QoS of DDS)."""
    from rosbags.interfaces import (
        Qos,
        QosDurability,
        QosHistory,
        QosLiveliness,
        QosReliability,
        QosTime,
    )

    forever = QosTime(9223372036, 854775807)  # what rosbag2 records for no limit
    return Qos(
        history=QosHistory.KEEP_LAST,
        depth=depth,
        reliability=QosReliability.RELIABLE,
        durability=QosDurability[durability],
        deadline=forever,
        lifespan=forever,
        liveliness=QosLiveliness.AUTOMATIC,
        liveliness_lease_duration=forever,
        avoid_ros_namespace_conventions=False,
    )


# --- messages ---------------------------------------------------------------------------


def pixels_of(detection: Detection) -> tuple[np.ndarray, np.ndarray]:
    """The numbers of ``CLASSES`` and how sure each pixel's is, both uint8 (H,W).

    As the tutorial's node has it (navigation2_tutorials, segmentation_node.py): of road the
    likelihood, of the rest what is missing to 1.
    """
    likely = detection.likelihood.where(detection.mask, 1 - detection.likelihood)
    confidence = likely.clamp(0, 1).mul(255).round().cpu().numpy().astype(np.uint8)
    return detection.mask.cpu().numpy().astype(np.uint8), confidence


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
    kinds = types.types
    pose = kinds["geometry_msgs/msg/Pose"](
        kinds["geometry_msgs/msg/Point"](*map(float, origin), 0.0),
        kinds["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0),
    )
    head = header(types, stamp, frame_id)
    height, width = values.shape
    about = kinds["nav_msgs/msg/MapMetaData"](head.stamp, resolution, width, height, pose)
    return kinds[GRID](head, about, values.reshape(-1))
