"""Journals: everything one person did to one picture, a line for each act, only ever appended.

DIR/PICTURE.USER.strokes.jsonl, PICTURE with its ending and its sub-folders. The first line says
which picture and who. A line is on disk (fsync) before anybody is told that it is.
"""

import json
import os
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

import pydantic
from pydantic import Field

from roadtorch.data.strokes import AnyAct, Name, act_text, parse_act
from roadtorch.errors import DatasetError, InputError
from roadtorch.io.atomic import make_folder
from roadtorch.io.bounded import read_regular
from roadtorch.settings import Settings

ENDING = ".strokes.jsonl"


class JournalHead(Settings):
    """The first line of a journal.

    picture: its path as it is written from the folder of all journals. height, width: its pixels.
    """

    roadtorch: int = Field(default=1, ge=1, le=1, description="version of the format")
    picture: str
    user: Name
    height: int = Field(ge=1)
    width: int = Field(ge=1)


@dataclass(frozen=True)
class Journal:
    """A journal as it was read. whole: bytes up to the end of the last whole line."""

    head: JournalHead
    acts: tuple[AnyAct, ...]
    whole: int


def journal_path(folder: Path, picture: str, user: str) -> Path:
    """The journal of a user for a picture, by its relative name with ending."""
    return folder / f"{PurePosixPath(picture)}.{user}{ENDING}"


def read_journal(path: Path) -> Journal:
    """Read a journal; a last line that was cut off by a crash is passed over.

    Raises DatasetError naming file and line for anything else that is wrong.
    """
    try:
        data = read_regular(path)
    except OSError as problem:
        raise DatasetError(path, f"cannot be read: {problem.strerror}", "give journals") from None
    whole = data.rfind(b"\n") + 1
    lines = data[:whole].splitlines()
    if not lines:
        raise DatasetError(path, "has no first line", "remove the file")
    try:
        head = JournalHead.model_validate_json(lines[0])
        acts = tuple(
            parse_act(line, f"{path}:{number}") for number, line in enumerate(lines[1:], start=2)
        )
    except pydantic.ValidationError as problem:
        what = f"does not begin as a journal of corrections: {problem.errors()[0]['msg']}"
        raise DatasetError(path, what, "give journals that roadtorch wrote") from None
    except InputError as problem:
        raise DatasetError(problem.where, problem.what, "mend or remove that line") from None
    return Journal(head, acts, whole)


def start_journal(path: Path, head: JournalHead) -> None:
    """Write the first line, unless the journal is there; InputError when that cannot be done."""
    if path.exists() and path.stat().st_size:
        return
    make_folder(path.parent, "give a folder that you may write to with --out")
    _append(path, json.dumps(head.model_dump()))
    _sync_folder(path.parent)


def append_act(path: Path, act: AnyAct) -> None:
    """Add an act at the end; on disk when this returns. InputError when it cannot be written."""
    _append(path, act_text(act))


def _append(path: Path, line: str) -> None:
    try:
        with path.open("ab+") as file:
            _cut_torn(file.fileno())
            file.write(line.encode() + b"\n")
            file.flush()
            os.fsync(file.fileno())
    except OSError as problem:
        what = f"cannot be written: {problem.strerror or problem}"
        raise InputError(path, what, "make room, or give another folder with --out") from None


def _cut_torn(handle: int) -> None:
    """Drop what follows the last line end of a file that is open: half a line of a crash."""
    end = size = os.fstat(handle).st_size
    while end:
        start = max(0, end - 65536)
        found = os.pread(handle, end - start, start).rfind(b"\n")
        if found >= 0:
            end = start + found + 1
            break
        end = start
    if end != size:
        os.ftruncate(handle, end)


def _sync_folder(folder: Path) -> None:
    """Have a new file's name on disk as well, where the system can."""
    if not hasattr(os, "O_DIRECTORY"):
        return
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def find_journals(folder: Path) -> list[Path]:
    """All journals below a folder, sorted; DatasetError where it is no folder."""
    if not folder.is_dir():
        raise DatasetError(folder, "is no folder", "give the folder with corrections")
    return sorted(path for path in folder.rglob(f"*{ENDING}") if path.is_file())
