"""What a person did to the labels of a picture, one event at a time, and the logs of it on disk.

A log is DIR/PICTURE.strokes.jsonl, PICTURE with its ending and its sub-folders. Its first line
says which picture; then comes a line for each event, only ever appended. A line is on
disk (fsync) before anybody is told that it is. What has no whole first line, after a crash or on a
full disk, is no log: the next event begins it anew.

Positions are in pixels of the picture, x to the right, y down, pixel centres at whole numbers.
Regions are runs: start, length, start, length, … of pixels counted row by row.
"""

import os
import threading
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from io import FileIO
from pathlib import Path, PurePosixPath
from typing import Annotated, Literal, Self

import cv2
import numpy as np
import pydantic
from pydantic import Field, model_validator

from roadtorch.base.atomic import make_folder
from roadtorch.base.decoding import check_pixels
from roadtorch.base.errors import DatasetError, InputError, UnwritableError
from roadtorch.base.settings import Settings
from roadtorch.data.correction_labels import LABELS, after_saying
from roadtorch.data.imported import Side, first_mistake, imported
from roadtorch.data.polygons import fill_polygon

ENDING = ".strokes.jsonl"

MAX_POINTS = 20_000  # of one stroke; ours: a hand draws some hundreds

MAX_RADIUS = 2000  # pixels of a brush

MAX_SECONDS = 600.0  # seconds that one event may have taken; the page counts no idle minute

Place = Annotated[float, Field(ge=-1e5, le=1e5)]
Point = tuple[Place, Place]
Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]{1,64}$")]
Saying = Literal["road", "not_road", "void", "sky", "vertical", "horizontal"]
Number = Annotated[int, Field(ge=0, lt=2**31)]  # of a pixel or a superpixel
Runs = Annotated[tuple[Number, ...], Field(description="start, length, …")]
Label = Annotated[str, Field(pattern=f"^({'|'.join(LABELS)})$")]


class Event(Settings):
    """One line of a log.

    id: made where it was done; the same id twice is the same event, sent again. time: seconds
    since 1970. seconds: how long the person was at it.
    """

    id: Name
    time: float = Field(default=0.0, ge=0)
    seconds: float = Field(default=0.0, ge=0, le=MAX_SECONDS)


class SuperpixelStroke(Event):
    """Superpixels clicked or dragged over; ``runs`` are their pixels, whoever cuts them later."""

    kind: Literal["superpixel"]
    saying: Saying
    segments: tuple[Number, ...]
    cut: str = Field(default="", max_length=64, description="digest of the segmentation")
    runs: Runs = ()


class PolygonStroke(Event):
    """A closed polygon, its border included."""

    kind: Literal["polygon"]
    saying: Saying
    points: tuple[Point, ...] = Field(min_length=3, max_length=MAX_POINTS)


class BrushStroke(Event):
    """A line drawn with a round brush."""

    kind: Literal["brush"]
    saying: Saying
    points: tuple[Point, ...] = Field(min_length=1, max_length=MAX_POINTS)
    radius: float = Field(gt=0, le=MAX_RADIUS)


class Confirm(Event):
    """ "Right as it is": what was not said is as shown; ``runs`` are the pixels shown as road."""

    kind: Literal["right"]
    runs: Runs = ()


class Import(Event):
    """Labels from another program: the runs of each label, by its name."""

    kind: Literal["brought"]
    labels: dict[Label, Runs]


class Undo(Event):
    """Take an event back."""

    kind: Literal["undo"]
    of: Name


class Redo(Event):
    """Do an event again that was taken back."""

    kind: Literal["redo"]
    of: Name


Stroke = SuperpixelStroke | PolygonStroke | BrushStroke
LastingEvent = Stroke | Confirm | Import
AnyEvent = LastingEvent | Undo | Redo

_ADAPTER: pydantic.TypeAdapter[AnyEvent] = pydantic.TypeAdapter(
    Annotated[AnyEvent, Field(discriminator="kind")]
)


def parse_event(text: str | bytes, where: object) -> AnyEvent:
    """An event from its JSON; InputError naming ``where`` and the first thing that is wrong."""
    try:
        return _ADAPTER.validate_json(text)
    except pydantic.ValidationError as problem:
        message = f"is no event of a correction: {first_mistake(problem)}"
        raise InputError(where, message, "give one as docs/annotate.md has it") from None


# --- regions ----------------------------------------------------------------------------


def runs_of(mask: np.ndarray) -> tuple[int, ...]:
    """The runs of a mask bool (H,W)."""
    edges = np.flatnonzero(np.diff(mask.reshape(-1), prepend=False, append=False))
    starts, ends = edges[::2], edges[1::2]
    return tuple(np.stack([starts, ends - starts], 1).reshape(-1).tolist())


def mask_of(runs: Sequence[int], size: tuple[int, int]) -> np.ndarray:
    """The mask bool (H,W) of runs; InputError where they do not fit the picture, or overlap."""
    if len(runs) % 2:
        raise InputError("runs", "have an odd number of values", "give start, length, …")
    borders = np.array(runs, np.int64).reshape(-1, 2).cumsum(1).reshape(-1)
    lengths = np.diff(borders, prepend=0, append=size[0] * size[1])
    if (lengths < 0).any():
        message = f"overlap, or reach beyond {size[0] * size[1]} pixels"
        raise InputError("runs", message, "give those of this picture, in order")
    return np.repeat(np.arange(len(lengths)) % 2 == 1, lengths).reshape(size)


def stroke_mask(stroke: Stroke, size: tuple[int, int]) -> np.ndarray:
    """The mask bool (H,W) that a stroke speaks of; what is outside the picture is cut off."""
    if isinstance(stroke, SuperpixelStroke):
        return mask_of(stroke.runs, size)
    height, width = size
    points = np.array(stroke.points, np.float64)
    points = points.clip([-width, -height], [2 * width, 2 * height])
    canvas = np.zeros(size, np.uint8)
    if isinstance(stroke, PolygonStroke):
        fill_polygon(points, canvas, 1)
        return canvas > 0
    corners, radius = np.floor(points + 0.5).astype(np.int32), round(stroke.radius)
    cv2.polylines(canvas, [corners], isClosed=False, color=1, thickness=2 * radius + 1)
    for corner in (corners[0], corners[-1]):
        cv2.circle(canvas, (int(corner[0]), int(corner[1])), radius, 1, -1)
    return canvas > 0


# --- folding ----------------------------------------------------------------------------


def standing(events: Iterable[AnyEvent]) -> list[LastingEvent]:
    """The events that hold, in their order: each once, without those taken back."""
    lasting: dict[str, LastingEvent] = {}
    undone: set[str] = set()
    for event in events:
        if isinstance(event, Undo):
            undone.add(event.of)
        elif isinstance(event, Redo):
            undone.discard(event.of)
        else:
            lasting.setdefault(event.id, event)
    return [event for event in lasting.values() if event.id not in undone]


def taken_back(events: Iterable[AnyEvent]) -> list[str]:
    """The events that can be done again: taken back last comes last, none after a new one."""
    stack: list[str] = []
    for event in events:
        of = event.of if isinstance(event, Undo | Redo) else None
        stack = [identity for identity in stack if identity != of] if of else []
        if isinstance(event, Undo):
            stack.append(event.of)
    return stack


def click_count(events: Iterable[Event]) -> int:
    """How many strokes were made, those that were taken back included, each counted once."""
    return len({event.id for event in events if isinstance(event, Stroke)})


def apply_event(labels: np.ndarray, event: LastingEvent) -> None:
    """Change labels uint8 (H,W) in place as one event says; InputError for what does not fit."""
    size = (labels.shape[0], labels.shape[1])
    match event:
        case Confirm():
            road = mask_of(event.runs, size)
            for silent, other in (("untouched", "not_road"), ("horizontal", "not_road_horizontal")):
                is_silent = labels == LABELS.index(silent)
                labels[is_silent & road] = LABELS.index("road")
                labels[is_silent & ~road] = LABELS.index(other)
        case Import():
            for name, runs in event.labels.items():
                labels[mask_of(runs, size)] = LABELS.index(name)
        case SuperpixelStroke() | PolygonStroke() | BrushStroke():
            mask = stroke_mask(event, size)
            labels[mask] = after_saying(labels[mask], event.saying)


def folded(events: Iterable[AnyEvent], size: tuple[int, int]) -> np.ndarray:
    """The labels uint8 (H,W) that all events come to."""
    labels = np.zeros(size, np.uint8)
    for event in standing(events):
        apply_event(labels, event)
    return labels


# --- logs -------------------------------------------------------------------------------


class LogHead(Settings):
    """The first line of a log.

    picture: its path as it is written from the folder of all logs. height, width: its pixels.
    """

    roadtorch: int = Field(default=1, ge=1, le=1, description="version of the format")
    picture: Annotated[str, Field(pattern=r"^[^\x00]+$")]
    height: Side
    width: Side

    @model_validator(mode="after")
    def _bounded(self) -> Self:
        check_pixels(self.width, self.height)
        return self


@dataclass(eq=False)
class EventLog:
    """The work on one picture, as its log has it.

    head: the first line, written with the first event. events: all of them.
    """

    path: Path
    head: LogHead
    events: list[AnyEvent] = field(default_factory=list)
    _lock: threading.Lock = field(default_factory=threading.Lock, repr=False)

    @property
    def size(self) -> tuple[int, int]:
        """(height, width) of the picture."""
        return self.head.height, self.head.width

    @property
    def standing(self) -> list[LastingEvent]:
        """The events that hold."""
        return standing(self.events)

    @property
    def confirmed(self) -> bool:
        """Whether the person said that it is right as it is."""
        return any(isinstance(event, Confirm) for event in self.standing)

    @cached_property
    def labels(self) -> np.ndarray:
        """What the events come to, uint8 (H,W); DatasetError where one does not fit the picture."""
        try:
            return folded(self.events, self.size)
        except InputError as problem:
            message = f"has an event that does not fit: {problem.where} {problem.what}"
            raise DatasetError(self.path, message, "give the picture that was corrected") from None

    def add(self, event: AnyEvent) -> None:
        """Take an event and have it on disk; nothing is done for one that is there.

        Raises InputError for one that does not fit the picture, UnwritableError for a full disk.
        """
        with self._lock:
            if any(event.id == known.id for known in self.events):
                return
            if isinstance(event, Undo | Redo):
                labels = folded([*self.events, event], self.size)
            else:
                labels = self.labels.copy()
                apply_event(labels, event)
            append_event(self.path, self.head, event)
            self.events.append(event)
            self.labels = labels


def log_path(folder: Path, picture: str) -> Path:
    """Return the path of the log for a picture, by its relative name with ending."""
    return folder / f"{PurePosixPath(picture)}{ENDING}"


def read_log(path: Path) -> EventLog | None:
    """Read a log; a last line that was cut off is passed over, None where the first one was.

    Raises DatasetError naming file and line for anything else that is wrong.
    """
    with imported(path, "give logs that roadtorch wrote") as data:
        lines = data[: data.rfind(b"\n") + 1].splitlines()
        if not lines:
            return None
        head = LogHead.model_validate_json(lines[0])
    try:
        events = [parse_event(line, f"{path}:{at}") for at, line in enumerate(lines[1:], 2)]
    except InputError as problem:
        raise DatasetError(problem.where, problem.what, "mend or remove that line") from None
    return EventLog(path, head, events)


def append_event(path: Path, head: LogHead, event: AnyEvent) -> None:
    """Add an event at the end, of a new log behind its head; on disk when this returns.

    UnwritableError when it cannot be; then what was there stands, and no more of this event.
    """
    make_folder(path.parent, "give a folder that you may write to with --out")
    try:
        with path.open("ab+", buffering=0) as file:
            size = _whole_size(file)
            lines = [*([] if size else [head.model_dump_json()]), event.model_dump_json(), ""]
            try:
                left = memoryview("\n".join(lines).encode())
                while left:
                    left = left[file.write(left) :]
                os.fsync(file.fileno())
                if not size:
                    _sync_folder(path.parent)
            except OSError:
                with suppress(OSError):
                    file.truncate(size)
                raise
    except OSError as problem:
        message = f"cannot be written: {problem.strerror or problem}"
        raise UnwritableError(
            path, message, "make room, or give another folder with --out"
        ) from None


def _whole_size(file: FileIO) -> int:
    """The bytes of a file after half a line of a crash is dropped, if it ends in one."""
    size = file.seek(0, os.SEEK_END)
    if size:
        file.seek(size - 1)
        if file.read(1) != b"\n":
            file.seek(0)
            size = file.readall().rfind(b"\n") + 1
            file.truncate(size)
    return size


def _sync_folder(folder: Path) -> None:
    """Have a new file's name on disk as well, where the system can."""
    if hasattr(os, "O_DIRECTORY"):
        handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def read_logs(folder: Path) -> list[EventLog]:
    """All logs below a folder, sorted; DatasetError where it is no folder, or as ``read_log``."""
    if not folder.is_dir():
        raise DatasetError(folder, "is no folder", "give the folder with corrections")
    paths = sorted(path for path in folder.rglob(f"*{ENDING}") if path.is_file())
    return [log for path in paths if (log := read_log(path)) is not None]
