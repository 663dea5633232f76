"""Bags of detections, in the format of Nav2's semantic segmentation layer.

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

from roadtorch.base.atomic import make_folder, write_error
from roadtorch.base.errors import ConfigError, InputError
from roadtorch.camera.ground_grid import Grid
from roadtorch.detectors.detection import Detection
from roadtorch.inputs.item import Item

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

IMAGE_TYPE, LABEL_INFO_TYPE = "sensor_msgs/msg/Image", "vision_msgs/msg/LabelInfo"
GRID_TYPE = "nav_msgs/msg/OccupancyGrid"
MASK_CLASS_NAMES: Mapping[int, str] = {0: "background", 1: "road"}

VISION_MESSAGES = {
    "vision_msgs/msg/VisionClass": "uint16 class_id\nstring class_name\n",
    LABEL_INFO_TYPE: (
        "std_msgs/Header header\nvision_msgs/VisionClass[] class_map\nfloat32 threshold\n"
    ),
}
"""Message definitions of ros-perception/vision_msgs, branch ros2, without comments."""

MASK_TOPIC, CONFIDENCE_TOPIC = "/segmentation/mask", "/segmentation/confidence"
OVERLAY_TOPIC, LABELS_TOPIC = "/segmentation/overlay", "/segmentation/label_info"
GRID_TOPIC, POINTS_TOPIC = "/segmentation/grid", "/segmentation/points"

MAX_DRIFT = 1_000_000_000  # nanoseconds by which a camera's clock and ours may drift apart

BAG_VERSION = 8  # version of the ROS 2 metadata: the newest whose QoS profiles Humble reads too


class BagWriter:
    """A bag written frame by frame, and renamed to its final path when it is closed.

    It is written in a sibling folder ``NAME.….unfinished``. ``close`` finishes and renames it, also
    after an error or Ctrl-C, and replaces an earlier bag. The first frame removes such folders of
    killed runs.

    Args:
        path: ``NAME.bag`` becomes a ROS 1 bag, any other name the folder of a ROS 2 bag (MCAP with
            zstd).
        frame_id: frame of the camera, of the headers of images.
        threshold: likelihood threshold of the mask, for the label info.
        draw: returns the overlay of a detection, uint8 RGB, shape (H, W, 3); None for no overlay.

    Raises:
        ConfigError: where rosbags is not installed.
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
            self.types = load_message_types(self._generation)
        except ImportError:
            problem = "cannot be written, as rosbags is not installed"
            raise ConfigError(str(path), problem, "pip install 'roadtorch[bags]'") from None
        make_folder(path.absolute().parent)
        self.path, self._frame_id, self._threshold, self._draw = path, frame_id, threshold, draw
        self._folder = path.with_name(f"{path.name}.{secrets.token_hex(4)}.unfinished")
        self._writer: Any = None
        self._connections: dict[str, object] = {}
        self._start: int | None = None
        self._latest = 0

    def write(self, item: Item, detection: Detection) -> Mapping[str, str]:
        """Write mask, confidence and overlay of a frame; InputError when it cannot be written."""
        types: Any = self.types.types
        stamp, time = item.nanoseconds, self.log_time(item)
        if LABELS_TOPIC not in self._connections:
            kind = types["vision_msgs/msg/VisionClass"]
            names = [kind(class_id=n, class_name=name) for n, name in MASK_CLASS_NAMES.items()]
            header = _make_header(self.types, stamp, "")
            info = types[LABEL_INFO_TYPE](header, names, self._threshold)
            self._add(LABELS_TOPIC, LABEL_INFO_TYPE, time, info)
        mask, confidence = mask_and_confidence(detection)
        images = {MASK_TOPIC: mask, CONFIDENCE_TOPIC: confidence}
        images |= {OVERLAY_TOPIC: self._draw(detection)} if self._draw else {}
        for topic, pixels in images.items():
            image = types[IMAGE_TYPE](
                header=_make_header(self.types, stamp, self._frame_id),
                height=pixels.shape[0],
                width=pixels.shape[1],
                encoding="mono8" if pixels.ndim == 2 else "rgb8",
                is_bigendian=0,
                step=pixels[0].size,
                data=np.ascontiguousarray(pixels).reshape(-1),
            )
            self._add(topic, IMAGE_TYPE, time, image)
        return {}

    def log_time(self, item: Item) -> int:
        """Return the time of recording of an item's messages, in nanoseconds; players sort by it.

        That is its stamp; where stamps step, the time since the first item.
        """
        stamp, elapsed = item.nanoseconds, round(1e9 * item.clock)
        self._start = stamp - elapsed if self._start is None else self._start
        is_regular = abs(self._start + elapsed - stamp) < MAX_DRIFT
        self._latest = max(self._latest, stamp if is_regular else self._start + elapsed)
        return self._latest

    def write_grid(self, item: Item, grid: Grid, frame_id: str) -> None:
        """Write the grid of a frame; InputError when it cannot be written."""
        kinds: Any = self.types.types
        header = _make_header(self.types, item.nanoseconds, frame_id)
        pose = kinds["geometry_msgs/msg/Pose"](
            kinds["geometry_msgs/msg/Point"](*map(float, grid.origin), 0.0),
            kinds["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0),
        )
        rows, columns = grid.cells.shape
        metadata = kinds["nav_msgs/msg/MapMetaData"]
        info = metadata(header.stamp, grid.resolution, columns, rows, pose)
        message = kinds[GRID_TYPE](header, info, grid.occupancy.cpu().numpy())
        self._add(GRID_TOPIC, GRID_TYPE, self.log_time(item), message)

    def close(self) -> None:
        """Finish and rename a bag with messages; on InputError its unfinished folder stays."""
        if self._writer is None:
            return
        writer, self._writer = self._writer, None
        try:
            writer.close()
            if self.path.exists():
                os.replace(self.path, self._folder / "earlier")
            os.replace(self._folder / self.path.name, self.path)
        except OSError as error:
            raise self._write_error(error) from None
        shutil.rmtree(self._folder, ignore_errors=True)

    def _add(self, topic: str, kind: str, stamp: int, message: object) -> None:
        try:
            writer = self._open() if self._writer is None else self._writer
            if topic not in self._connections:
                self._connections[topic] = self._connect(topic, kind)
            is_ros1 = self._generation == 1
            pack = self.types.serialize_ros1 if is_ros1 else self.types.serialize_cdr
            writer.write(self._connections[topic], stamp, pack(message, kind))
        except OSError as error:
            raise self._write_error(error) from None

    def _open(self) -> Any:
        hexadecimal = "[0-9a-f]" * 8
        pattern = f"{glob.escape(self.path.name)}.{hexadecimal}.unfinished"
        for leftover in self.path.absolute().parent.glob(pattern):
            shutil.rmtree(leftover, ignore_errors=True)
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

    def _connect(self, topic: str, kind: str) -> object:
        """Add the connection of a topic; the label info is latched for late subscribers."""
        is_latched = topic == LABELS_TOPIC
        if self._generation == 1:
            options: dict[str, object] = {"callerid": "/roadtorch", "latching": int(is_latched)}
        else:
            durability, depth = ("TRANSIENT_LOCAL", 1) if is_latched else ("VOLATILE", 10)
            options = {"offered_qos_profiles": [_qos_profile(durability, depth)]}
        return self._writer.add_connection(topic, kind, typestore=self.types, **options)

    def _write_error(self, error: OSError) -> InputError:
        failure = write_error(self.path, error)
        saved = f"; finished frames are in {self._folder}" if self._folder.exists() else ""
        return InputError(self.path, failure.problem + saved, failure.hint)


def _qos_profile(durability: str, depth: int) -> object:
    """Return a reliable QoS profile (DDS) with a history of ``depth`` messages."""
    from rosbags import interfaces

    forever = interfaces.QosTime(9223372036, 854775807)  # rosbag2's value for no limit
    return interfaces.Qos(
        history=interfaces.QosHistory.KEEP_LAST,
        depth=depth,
        reliability=interfaces.QosReliability.RELIABLE,
        durability=interfaces.QosDurability[durability],
        deadline=forever,
        lifespan=forever,
        liveliness=interfaces.QosLiveliness.AUTOMATIC,
        liveliness_lease_duration=forever,
        avoid_ros_namespace_conventions=False,
    )


# --- messages ---------------------------------------------------------------------------


def mask_and_confidence(detection: Detection) -> tuple[np.ndarray, np.ndarray]:
    """Return class numbers, see ``MASK_CLASS_NAMES``, and confidences 0…255, both uint8, (H, W).

    The confidence is the likelihood on the road and 1 minus the likelihood elsewhere, as in
    navigation2_tutorials, segmentation_node.py.
    """
    likely = detection.likelihood.where(detection.mask, 1 - detection.likelihood)
    confidence = likely.clamp(0, 1).mul(255).round().cpu().numpy().astype(np.uint8)
    return detection.mask.cpu().numpy().astype(np.uint8), confidence


def load_message_types(generation: int) -> "Typestore":
    """Load the message types of ROS 1 (Noetic) or 2 (Humble and later), with vision_msgs."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    types = get_typestore(Stores.ROS1_NOETIC if generation == 1 else Stores.ROS2_HUMBLE)
    for name, text in VISION_MESSAGES.items():
        types.register(get_types_from_msg(text, name))
    return types


def _make_header(types: "Typestore", stamp: int, frame_id: str) -> Any:
    """Return a std_msgs/Header; stamp in nanoseconds."""
    kind: Any = types.types["std_msgs/msg/Header"]
    time = types.types["builtin_interfaces/msg/Time"](*divmod(stamp, 10**9))
    sequence = {"seq": 0} if "seq" in kind.__dataclass_fields__ else {}  # ROS 1
    return kind(**sequence, stamp=time, frame_id=frame_id)
