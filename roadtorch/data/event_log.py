"""Event logs: all that one person did to one picture, a line for each event, only ever appended.

DIR/PICTURE.USER.strokes.jsonl, PICTURE with its ending and its sub-folders. The first line says
which picture and who. A line is on disk (fsync) before anybody is told that it is.
"""

import json
import os
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import BinaryIO

import pydantic
from pydantic import Field

from roadtorch.data.events import AnyEvent, Name, parse_event
from roadtorch.errors import DatasetError, InputError
from roadtorch.io.atomic import make_folder
from roadtorch.io.bounded import read_regular
from roadtorch.settings import Settings

ENDING = ".strokes.jsonl"


class LogHead(Settings):
    """The first line of a log.

    picture: its path as it is written from the folder of all logs. height, width: its pixels.
    """

    roadtorch: int = Field(default=1, ge=1, le=1, description="version of the format")
    picture: str
    user: Name
    height: int = Field(ge=1)
    width: int = Field(ge=1)


@dataclass(frozen=True)
class EventLog:
    """A log as it was read. whole: bytes up to the end of the last whole line."""

    head: LogHead
    events: tuple[AnyEvent, ...]
    whole: int


def log_path(folder: Path, picture: str, user: str) -> Path:
    """The log of a user for a picture, by its relative name with ending."""
    return folder / f"{PurePosixPath(picture)}.{user}{ENDING}"


def read_log(path: Path) -> EventLog:
    """Read a log; a last line that was cut off by a crash is passed over.

    Raises DatasetError naming file and line for anything else that is wrong.
    """
    try:
        data = read_regular(path)
    except OSError as problem:
        raise DatasetError(path, f"cannot be read: {problem.strerror}", "give logs") from None
    whole = data.rfind(b"\n") + 1
    lines = data[:whole].splitlines()
    if not lines:
        raise DatasetError(path, "has no first line", "remove the file")
    try:
        head = LogHead.model_validate_json(lines[0])
        events = tuple(
            parse_event(line, f"{path}:{number}") for number, line in enumerate(lines[1:], start=2)
        )
    except pydantic.ValidationError as problem:
        what = f"does not begin as a log of corrections: {problem.errors()[0]['msg']}"
        raise DatasetError(path, what, "give logs that roadtorch wrote") from None
    except InputError as problem:
        raise DatasetError(problem.where, problem.what, "mend or remove that line") from None
    return EventLog(head, events, whole)


def append_event(path: Path, head: LogHead, event: AnyEvent) -> None:
    """Add an event at the end, of a new log behind its head; on disk when this returns.

    InputError when it cannot be written.
    """
    is_new = not path.exists()
    make_folder(path.parent, "give a folder that you may write to with --out")
    try:
        with path.open("ab+") as file:
            lines = [event.model_dump_json()]
            if not _whole_size(file):
                lines.insert(0, json.dumps(head.model_dump()))
            file.write("".join(f"{line}\n" for line in lines).encode())
            file.flush()
            os.fsync(file.fileno())
    except OSError as problem:
        what = f"cannot be written: {problem.strerror or problem}"
        raise InputError(path, what, "make room, or give another folder with --out") from None
    if is_new:
        _sync_folder(path.parent)


def _whole_size(file: BinaryIO) -> int:
    """The bytes of a file after half a line of a crash is dropped, if it ends in one."""
    size = file.seek(0, os.SEEK_END)
    if size:
        file.seek(size - 1)
        if file.read(1) != b"\n":
            file.seek(0)
            size = file.read().rfind(b"\n") + 1
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


def find_logs(folder: Path) -> list[Path]:
    """All logs below a folder, sorted; DatasetError where it is no folder."""
    if not folder.is_dir():
        raise DatasetError(folder, "is no folder", "give the folder with corrections")
    return sorted(path for path in folder.rglob(f"*{ENDING}") if path.is_file())
