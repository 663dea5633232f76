"""Images in ROS bags: ROS 1 (.bag), ROS 2 (folder, .db3, .mcap); ROS itself is not needed.

``rosbags`` (extra ``bags``) reads them by the message definitions in the bag.
"""

import statistics
from collections.abc import Generator, Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from itertools import islice, pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from roadtorch.base.bounded import read_regular, reason
from roadtorch.base.errors import ConfigError, InputError, unknown_name_error
from roadtorch.camera.calibration import lens_from_camera_info
from roadtorch.camera.ground import Lens
from roadtorch.inputs.clock import FrameClock
from roadtorch.inputs.image_messages import COMPRESSED_TYPE, RAW_IMAGE_TYPE, decode_message
from roadtorch.inputs.item import Item, Selection, Source, raise_error

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader

BAG_SUFFIXES = (".bag", ".db3", ".mcap")
METADATA, METADATA_KEY = "metadata.yaml", "rosbag2_bagfile_information"
CAMERA_INFO_TYPE = "sensor_msgs/msg/CameraInfo"
RATE_MESSAGES = 16  # messages from which the rate is estimated
DEFAULT_STEP = 0.1  # seconds between images whose stamps and times of recording are all the same


@dataclass(frozen=True)
class ImageTopic:
    """A topic with images: name, number of messages, coordinate frame of the first one.

    rate: messages per second, estimated; None for a single message.
    """

    name: str
    count: int
    frame_id: str
    rate: float | None


def is_bag(origin: str) -> bool:
    """Return whether a path is a bag by its suffix, or a folder with a ROS 2 recording."""
    path = Path(origin)
    if path.is_dir():
        return bool(listed_recordings(origin) or _recording_files(path))
    return path.suffix.lower() in BAG_SUFFIXES


def listed_recordings(folder: str) -> set[str]:
    """Return the names of the files of a bag that is a folder: its list, and what that names."""
    try:
        data = read_regular(Path(folder, METADATA)).decode(errors="replace")
    except OSError:
        return set()
    if METADATA_KEY not in data:
        return set()
    return {METADATA, *(file.name for file in _recording_files(Path(folder)) if file.name in data)}


def bag_source(
    origin: str,
    selection: Selection = Selection(),  # noqa: B008  # it is frozen
    name: str = "",
) -> Source:
    """Make a source of the images of the selection's topic, by default of the only one.

    Images come in the order of recording. Time stamps are those of the headers, or of the recording
    where a header has none; where they step, ``seconds`` go on by the time of recording. A message
    that cannot be decoded raises when its item is read. name: of the results, by default the bag's.

    Raises:
        InputError: if it is no bag or has no images.
        ConfigError: if the topic does not exist or has to be chosen.
    """
    images = image_topic(origin, selection.topic)
    count = None
    if not selection.start and selection.end is None:
        count = len(range(images.count)[:: selection.every][: selection.limit])
    step = 1 / images.rate if images.rate else DEFAULT_STEP
    path = Path(origin)
    name = name or (path.name if path.is_dir() else path.stem)
    every = partial(_bag_frames, origin, name, images.name, step)
    return Source(
        name=name,
        origin=origin,
        items=lambda: selection.select(every()),
        rate=images.rate and images.rate / selection.every,
        count=count,
        path=path,
    )


def image_topic(origin: str, topic: str | None = None) -> ImageTopic:
    """Return the image topic of a name, or the only one; raises as ``bag_source``."""
    with _open_bag(origin) as bag:
        name = _choose_topic(origin, bag, topic)
        messages: list[BagMessage] = []
        with suppress(InputError), closing(_read_messages(origin, bag, name)) as every:
            messages.extend(islice(every, RATE_MESSAGES))
        if not messages:
            raise InputError(origin, f"has no images on {name}", "give another --topic or bag")
        stamps = sorted(message.stamp for message in messages)
        steps = [late - early for early, late in pairwise(stamps)]
        step = statistics.median(steps) if steps else 0
        count = sum(link.msgcount for link in bag.connections if link.topic == name)
        first = next((message.content for message in messages if message.content), None)
        frame_id = first.header.frame_id if first is not None else ""
        return ImageTopic(name, count, frame_id, 1e9 / step if step > 0 else None)


def camera_info(origin: str, topic: str | None = None) -> Lens:
    """Return the lens by the first ``camera_info`` message that belongs to an image topic.

    ``/camera/image_raw`` and ``/camera/image_raw/compressed`` have ``/camera/camera_info``
    (image_transport).

    Raises:
        InputError: if there is no such topic, or its K is empty.
        ConfigError: if it describes no lens of that topic's images.
    """
    with _open_bag(origin) as bag:
        name = _choose_topic(origin, bag, topic)
        types = {link.topic: link.msgtype for link in bag.connections}
        base = name.removesuffix("/compressed") if types[name] == COMPRESSED_TYPE else name
        sibling = f"{base.rpartition('/')[0]}/camera_info"
        infos = sorted(entry for entry in types if types[entry] == CAMERA_INFO_TYPE)
        if sibling not in infos:
            hint = f"there is {', '.join(infos)}" if infos else "pass a calibration"
            raise InputError(origin, f"has no camera_info {sibling} beside {name}", hint)
        message = next(_read_messages(origin, bag, sibling), None)
        if message is None or message.content is None:
            problem = f"has no readable message on {sibling}"
            raise InputError(origin, problem, "pass a calibration")
        return lens_from_camera_info(f"{origin}:{sibling}", message.content, base)


# --- topics -----------------------------------------------------------------------------


def _choose_topic(origin: str, reader: "AnyReader", topic: str | None) -> str:
    """Return the name of the image topic; ConfigError or InputError that lists the topics."""
    types = {link.topic: link.msgtype for link in reader.connections}
    images = sorted(name for name in types if types[name] in (RAW_IMAGE_TYPE, COMPRESSED_TYPE))
    images = [name for name in images if not name.endswith("/compressedDepth")]
    if not images:
        topics = ", ".join(f"{name} ({msgtype})" for name, msgtype in sorted(types.items()))
        hint = f"there is {topics}" if topics else "the bag is empty"
        raise InputError(origin, "has no images", hint)
    hint = f"give one of {', '.join(images)}"
    if topic is None and len(images) > 1:
        raise ConfigError(origin, f"has {len(images)} topics with images", f"--topic: {hint}")
    if topic is not None and topic not in images:
        if topic not in types:
            raise unknown_name_error("topic", topic, images)
        raise InputError(origin, f"has {types[topic]} on {topic}, no images", hint)
    return topic or images[0]


# --- messages ---------------------------------------------------------------------------


class BagMessage(NamedTuple):
    """A message: times in nanoseconds, and its content or the reason why it has none."""

    stamp: int
    recorded: int
    content: Any
    damage: str


def _bag_frames(origin: str, source: str, topic: str, step: float) -> Generator[Item]:
    with _open_bag(origin) as bag:
        clock, first, recorded = FrameClock(origin, step), None, 0
        for number, message in enumerate(_read_messages(origin, bag, topic)):
            first = message.stamp if first is None else first
            elapsed = max(0, message.recorded - recorded) / 1e9
            seconds = clock.seconds((message.stamp - first) / 1e9, elapsed)
            recorded = message.recorded
            where = f"{origin}:{topic}#{number}"
            damage = InputError(where, f"cannot be read: {message.damage}", "record it again")
            is_whole = message.content is not None
            decode = partial(decode_message, message.content, where)
            read = decode if is_whole else partial(raise_error, damage)
            name = f"{source}/{number:06d}"
            yield Item(name, where, read, number=number, seconds=seconds, stamp=message.stamp)


def _read_messages(origin: str, bag: "AnyReader", topic: str) -> Generator[BagMessage]:
    """Yield the messages of a topic as recorded; InputError at the end where some are missing."""
    links = [link for link in bag.connections if link.topic == topic]
    waiting = bag.messages(connections=links)
    count, total, ending = 0, sum(link.msgcount for link in links), ""
    while True:
        try:
            link, time, data = next(waiting)
        except StopIteration:
            break
        except Exception as error:  # zlib, struct, sqlite, …
            ending = f": {reason(error)}"
            break
        count += 1
        try:
            content: Any = bag.deserialize(data, link.msgtype)
            stamp = content.header.stamp
        except Exception as error:  # damaged bytes make the deserialiser raise anything
            yield BagMessage(time, time, None, reason(error))
        else:
            yield BagMessage(stamp.sec * 10**9 + stamp.nanosec or time, time, content, "")
    if ending or count < total:
        problem = f"only {count} of {total} frames can be read{ending}"
        raise InputError(origin, problem, "they were used")


# --- bags -------------------------------------------------------------------------------


def _recording_files(folder: Path) -> list[Path]:
    return sorted(path for path in folder.iterdir() if path.suffix.lower() in BAG_SUFFIXES[1:])


@contextmanager
def _open_bag(origin: str) -> "Iterator[AnyReader]":
    """Open a bag; InputError if rosbags cannot read it, ConfigError if rosbags is missing."""
    path = Path(origin)
    if not path.exists():
        raise InputError(origin, "does not exist", "check the name")
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        problem = "cannot be read without the package rosbags"
        raise ConfigError(origin, problem, "pip install 'roadtorch[bags]'") from None
    paths = [path]
    if path.is_dir() and not listed_recordings(origin):
        paths = _recording_files(path)
        if len(paths) > 1:
            problem = f"holds {len(paths)} recordings and no {METADATA} that lists them"
            raise InputError(origin, problem, "give one of them, or ros2 bag reindex")
    if not all(file.is_file() or file.is_dir() for file in paths):
        raise InputError(origin, "is or contains a pipe or a device", "give a bag")
    try:
        # Bags without definitions are older than ROS 2 Iron; images are the same in all of them.
        reader = AnyReader(paths, default_typestore=get_typestore(Stores.ROS2_HUMBLE))
        reader.open()
    except Exception as error:  # zlib, struct, sqlite, …
        problem = f"cannot be read as a bag: {reason(error)}"
        hint = f"if its end is missing: {_repair_command(path)}"
        raise InputError(origin, problem, hint) from None
    with closing(reader):
        yield reader


def _repair_command(path: Path) -> str:
    """Return the command that repairs a bag, or the first recording in a folder."""
    files = _recording_files(path) if path.is_dir() else [path]
    commands = {".bag": "rosbag reindex", ".mcap": "mcap recover"}
    return commands.get(files[0].suffix if files else "", "ros2 bag reindex")
