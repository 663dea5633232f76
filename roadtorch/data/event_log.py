"""Event logs: all that one person did to one picture, a line for each event, only ever appended.

DIR/PICTURE.USER.strokes.jsonl, PICTURE with its ending and its sub-folders. The first line says
which picture and who. A line is on disk (fsync) before anybody is told that it is. What has no
whole first line, after a crash or on a full disk, is no log: the next event begins it anew.
"""

import os
import threading
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from io import FileIO
from pathlib import Path, PurePosixPath
from typing import Annotated, Self

import numpy as np
from pydantic import Field, model_validator

from roadtorch.data.events import (
    AnyEvent,
    Confirm,
    LastingEvent,
    Name,
    Redo,
    Undo,
    apply_event,
    folded,
    parse_event,
    standing,
)
from roadtorch.data.imported import Side, imported
from roadtorch.errors import DatasetError, InputError
from roadtorch.io.atomic import make_folder
from roadtorch.io.decoding import most_megapixels
from roadtorch.settings import Settings

ENDING = ".strokes.jsonl"


class LogHead(Settings):
    """The first line of a log.

    picture: its path as it is written from the folder of all logs. height, width: its pixels.
    """

    roadtorch: int = Field(default=1, ge=1, le=1, description="version of the format")
    picture: Annotated[str, Field(pattern=r"^[^\x00]+$")]
    user: Name
    height: Side
    width: Side

    @model_validator(mode="after")
    def _bounded(self) -> Self:
        if self.height * self.width > most_megapixels() * 1e6:
            raise ValueError(f"a picture has at most {most_megapixels():g} megapixels")
        return self


@dataclass(eq=False)
class EventLog:
    """One person's work on one picture, as its log has it.

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
            what = f"has an event that does not fit: {problem.where} {problem.what}"
            remedy = "give the picture that was corrected"
            raise DatasetError(self.path, what, remedy) from None

    def add(self, event: AnyEvent) -> None:
        """Take an event and have it on disk; nothing is done for one that is there.

        Raises InputError for one that does not fit the picture, or cannot be written.
        """
        with self._lock:
            if any(event.id == one.id for one in self.events):
                return
            if isinstance(event, Undo | Redo):
                labels = folded([*self.events, event], self.size)
            else:
                labels = self.labels.copy()
                apply_event(labels, event)
            append_event(self.path, self.head, event)
            self.events.append(event)
            self.labels = labels


def log_path(folder: Path, picture: str, user: str) -> Path:
    """The log of a user for a picture, by its relative name with ending."""
    return folder / f"{PurePosixPath(picture)}.{user}{ENDING}"


def read_log(path: Path) -> EventLog | None:
    """Read a log; a last line that was cut off is passed over, None where the first one was.

    Raises DatasetError naming file and line for anything else that is wrong.
    """
    with imported(path, "give logs that roadtorch wrote") as data:
        lines = data[: data.rfind(b"\n") + 1].splitlines()
        if not lines:
            return None
        head = LogHead.model_validate_json(lines[0])
        if not path.name.endswith(f".{head.user}{ENDING}"):
            raise ValueError(f"it is of {head.user}, which its name does not say")
    try:
        events = [parse_event(line, f"{path}:{at}") for at, line in enumerate(lines[1:], start=2)]
    except InputError as problem:
        raise DatasetError(problem.where, problem.what, "mend or remove that line") from None
    return EventLog(path, head, events)


def append_event(path: Path, head: LogHead, event: AnyEvent) -> None:
    """Add an event at the end, of a new log behind its head; on disk when this returns.

    InputError when it cannot be written; then what was there stands, and no more of this event.
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
        what = f"cannot be written: {problem.strerror or problem}"
        raise InputError(path, what, "make room, or give another folder with --out") from None


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
