"""A bag of what was found in footage, as Nav2's semantic segmentation layer reads it."""

import os
import secrets
import shutil
from pathlib import Path
from typing import Any

import numpy as np

from roadtorch.detection import Detection
from roadtorch.errors import ConfigError, InputError
from roadtorch.io.atomic import make_folder, unwritable
from roadtorch.sinks.messages import (
    GRID,
    IMAGE,
    LABEL_INFO,
    confidences,
    image_of_pixels,
    label_info,
    message_types,
    occupancy_message,
)

MASK, CONFIDENCE = "/segmentation/mask", "/segmentation/confidence"
OVERLAY, LABELS = "/segmentation/overlay", "/segmentation/label_info"
GRIDS = "/segmentation/grid"

BAG_VERSION = 8
"""Of the ROS 2 metadata: the newest whose quality-of-service profiles Humble reads too."""

ROOM = 2**24
"""Bytes left on the disk for the last chunk and the index; ours: a chunk has 1 MiB and a frame."""


class BagSink:
    """A bag that is written frame by frame, and has its name once it is closed.

    path: ``NAME.bag`` becomes a bag of ROS 1, any other name the folder of one of ROS 2 (MCAP with
    zstd). frame_id: of the camera, as in the input's headers. threshold: of the mask.

    While it is written it lies in a folder ``NAME.….unfinished`` beside; ``close`` ends it and
    gives it its name, after an error or Ctrl-C too, with the frames that were written. What a
    killed process leaves there is a cut bag, which ``bag_source`` reads. An earlier bag of ours is
    replaced by ``close``. Raises InputError when ``path`` is anything else, ConfigError without
    rosbags.
    """

    def __init__(self, path: Path, frame_id: str, threshold: float) -> None:
        self._generation = 1 if path.suffix == ".bag" else 2
        try:
            self.types = message_types(self._generation)
        except ImportError:
            what = "cannot be written without the package rosbags"
            raise ConfigError(str(path), what, "pip install 'roadtorch[bags]'") from None
        if path.exists() and not is_result(path):
            what = "exists already, and is no bag of ours"
            raise InputError(path, what, "remove it, or give another name")
        make_folder(path.absolute().parent)
        self.path, self._frame_id, self._threshold = path, frame_id, threshold
        self._folder = path.with_name(f"{path.name}.{secrets.token_hex(4)}.unfinished")
        self._writer: Any = None
        self._links: dict[str, Any] = {}

    def write(self, detection: Detection, stamp: int, overlay: np.ndarray | None = None) -> None:
        """Add a frame: its mask and confidence, and an overlay uint8 (H,W,3) RGB where given.

        stamp: of the frame, in nanoseconds. Raises InputError when the disk is full.
        """
        self._room_for(2 * detection.mask.numel() + (0 if overlay is None else overlay.size))
        if LABELS not in self._links:
            self._add(LABELS, LABEL_INFO, stamp, label_info(self.types, stamp, self._threshold))
        for topic, pixels in (
            (MASK, detection.mask.cpu().numpy().astype(np.uint8)),  # the numbers of CLASSES
            (CONFIDENCE, confidences(detection)),
            (OVERLAY, overlay),
        ):
            if pixels is not None:
                image = image_of_pixels(self.types, pixels, stamp, self._frame_id)
                self._add(topic, IMAGE, stamp, image)

    def write_grid(
        self,
        grid: np.ndarray,
        resolution: float,
        origin: tuple[float, float],
        stamp: int,
        frame_id: str,
    ) -> None:
        """Add a grid as ``occupancy_message`` has it; InputError when the disk is full."""
        self._room_for(grid.size)
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
        except OSError as problem:
            raise self._told(problem) from None
        shutil.rmtree(self._folder, ignore_errors=True)

    # --- inside -------------------------------------------------------------------------

    def _add(self, topic: str, kind: str, stamp: int, message: Any) -> None:
        try:
            writer = self._begin() if self._writer is None else self._writer
            if topic not in self._links:
                self._links[topic] = self._link(topic, kind)
            is_first = self._generation == 1
            pack = self.types.serialize_ros1 if is_first else self.types.serialize_cdr
            writer.write(self._links[topic], stamp, pack(message, kind))
        except OSError as problem:
            raise self._told(problem) from None

    def _begin(self) -> Any:
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

    def _room_for(self, size: int) -> None:
        if shutil.disk_usage(self.path.absolute().parent).free < ROOM + 2 * size:
            what = "ends here: there is no room on the disk"
            raise InputError(self.path, what, "make room, or choose a folder with room")

    def _told(self, problem: OSError) -> InputError:
        told = unwritable(self.path, problem)
        rest = f"; what there is lies in {self._folder}" if self._folder.exists() else ""
        return InputError(self.path, told.what + rest, told.remedy)


def is_result(path: Path) -> bool:
    """Whether a path is a bag with nothing but topics that ``BagSink`` writes."""
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
