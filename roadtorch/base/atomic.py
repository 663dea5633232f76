"""Files that are never half-written, and the folders they go to."""

import csv
import errno
import hashlib
import io
import json
import os
import re
import secrets
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from time import monotonic, sleep

from roadtorch.base.bounded import printable
from roadtorch.base.errors import InputError, UnwritableError

LEFTOVER = re.compile(r"\..+\.[0-9a-f]{8}\.part")
"""The names of temporary files, those of earlier versions among them."""

LAST_BREATH = 1.0
"""Seconds after which the workers of a killed run are gone; ours: they end within one image."""

REMEDIES = {
    errno.ENAMETOOLONG: "give it a shorter name",
    errno.ENOSPC: "make room, or choose a folder with room",
    errno.EDQUOT: "make room, or choose a folder with room",
    None: "see whether the disk has room and is whole",
}
"""What helps when a file cannot be written, by the number of the error, which some errors lack."""

FORMULA = ("=", "+", "-", "@", "\t", "\r", "'")
"""What a cell begins with that spreadsheets take for a formula, and the sign against that."""

# --- in ---------------------------------------------------------------------------------


def digest_of(path: Path) -> str:
    """SHA-256 of a file's bytes; empty where it is no regular file that can be read."""
    try:
        if path.is_file():
            with path.open("rb") as file:
                return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError:
        pass
    return ""


def digest_of_folder(path: Path) -> str:
    """SHA-256 of the names and digests of the files right in a folder; empty without a file."""
    digest, found = hashlib.sha256(), ""
    for file in sorted(path.iterdir()):
        if own := digest_of(file):
            digest.update(f"{own} {file.name}\n".encode("utf-8", "surrogateescape"))
            found = digest.hexdigest()
    return found


# --- out --------------------------------------------------------------------------------


def make_folder(path: Path, hint: str = "give another folder") -> None:
    """Make a folder and those above it; UnwritableError with the remedy when it cannot be made."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        problem = f"cannot be made a folder: {error.strerror}"
        raise UnwritableError(path, problem, hint) from None


@contextmanager
def atomic(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield a temporary path in the folder of ``path``; rename it at the end, if all went well.

    Whatever happens, ``path`` holds its old content or all of the new one, and no temporary
    file stays; ``remove_leftovers`` takes those of a process that was killed. The temporary
    name is short, whatever the name of ``path``. Raises UnwritableError when it cannot be written.
    """
    path = Path(path)
    temporary = path.with_name(f".roadtorch.{secrets.token_hex(4)}.part")
    try:
        yield temporary
        os.replace(temporary, path)
    except OSError as error:
        raise unwritable(path, error) from None
    finally:
        # Where even looking for the file fails there is none to remove.
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


def unwritable(path: Path, error: OSError, problem: str = "cannot be written") -> UnwritableError:
    """Return the error for a file that cannot be written, with what helps."""
    hint = REMEDIES.get(error.errno, "choose a folder that you may write to")
    return UnwritableError(path, f"{problem}: {error.strerror or error}", hint)


def remove_leftovers(folders: Iterable[Path]) -> None:
    """Remove what killed processes left in the folders; no process may be writing there now."""
    for folder in folders:
        with suppress(OSError):
            for path in folder.iterdir():
                if LEFTOVER.fullmatch(path.name):
                    path.unlink(missing_ok=True)


@contextmanager
def locked(folder: Path, hint: str = "wait for it, or give another folder") -> Iterator[None]:
    """Keep other runs out of a folder during the block; InputError where one is in it already.

    The lock is on the folder itself (flock): no file is made for it, and it ends with the
    process and its workers, however they end; those of a killed run get ``LAST_BREATH`` for it.
    Where a system or a disk has no such locks, nobody is kept out.
    """
    with _lock_of(folder) as lock:
        end = monotonic() + LAST_BREATH
        while True:
            try:
                lock(alone=True)
            except BlockingIOError:
                if monotonic() > end:
                    raise InputError(folder, "another run is writing here", hint) from None
                sleep(LAST_BREATH / 50)
                continue
            except OSError:
                pass  # a system or a disk without locks
            break
        yield


@contextmanager
def shared(folder: Path) -> Iterator[None]:
    """Write into a folder, which is made, beside other runs that do so with this function.

    Who finds nobody there removes what killed runs left, in all folders below as well but those
    that a run has for itself. Where a system or a disk has no locks, nobody does.
    """
    make_folder(folder)
    with _lock_of(folder) as lock:
        with suppress(OSError):
            lock(alone=True)
            for below, folders, _ in os.walk(folder):
                remove_leftovers([Path(below)])
                folders[:] = [one for one in folders if _is_free(Path(below, one))]
        with suppress(OSError):
            lock(alone=False)
        yield


def _is_free(folder: Path) -> bool:
    """Whether no run has a folder for itself; OSError where there are no locks."""
    with _lock_of(folder) as lock:
        try:
            lock(alone=True)
        except BlockingIOError:
            return False
    return True


@contextmanager
def _lock_of(folder: Path) -> Iterator[Callable[..., None]]:
    """``lock(alone=…)`` takes the lock of a folder, or changes it, until the block ends.

    alone: with nobody else, BlockingIOError where one has it; otherwise with others, and it
    waits for one who is alone. OSError where there are no locks.
    """

    def lock(*, alone: bool) -> None:
        try:
            import fcntl
        except ImportError:  # not a Unix
            raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK)) from None
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB if alone else fcntl.LOCK_SH)

    handle = os.open(folder, os.O_RDONLY)
    try:
        yield lock
    finally:
        os.close(handle)


def write_text(path: str | os.PathLike[str], text: str) -> None:
    """Write UTF-8 text with the line ends as they are; other bytes of names as ``\\xff``."""
    with atomic(path) as temporary:
        temporary.write_bytes(printable(text).encode())


def write_json(path: str | os.PathLike[str], document: object) -> None:
    """Write JSON, indented by two; the same document gives the same bytes.

    Raises ValueError for numbers that are not finite, which JSON does not have.
    """
    text = json.dumps(document, indent=2, ensure_ascii=False, allow_nan=False)
    write_text(path, text + "\n")


def csv_text(columns: Sequence[str], rows: Iterable[Mapping[str, object]]) -> str:
    """Rows as CSV under a line with the names of the columns; lines end in a line feed.

    A column that a row lacks stays empty; ValueError for a row with a key that is no column.
    A text that spreadsheets would take for a formula has an apostrophe before it; ``from_cell``
    takes it away.
    """
    # The csv module quotes only the line ends that it is told to write: told of both, it quotes
    # a carriage return in a name, which readers would take for the end of a row.
    lines: list[str] = []
    for row in ({name: name for name in columns}, *rows):
        text = io.StringIO(newline="")
        cells = {name: _cell(value) for name, value in row.items()}
        csv.DictWriter(text, columns, lineterminator="\r\n").writerow(cells)
        lines.append(text.getvalue().removesuffix("\r\n") + "\n")
    return "".join(lines)


def _cell(value: object) -> object:
    if isinstance(value, str) and value.startswith(FORMULA):
        with suppress(ValueError):
            float(value)
            return value
        return f"'{value}"
    return value


def from_cell(text: str) -> str:
    """The text of a cell of ours, without an apostrophe that keeps it from being a formula."""
    return text[1:] if text[:1] == "'" and text[1:].startswith(FORMULA) else text
