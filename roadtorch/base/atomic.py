"""Atomic writes, locks on folders, the ledger of results, and text formats: JSON and CSV."""

import csv
import errno
import glob
import hashlib
import io
import json
import os
import re
import secrets
import tempfile
from bisect import bisect_left
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from fnmatch import fnmatchcase
from functools import cache
from pathlib import Path
from time import monotonic, sleep

from roadtorch.base.bounded import read_regular, to_printable
from roadtorch.base.errors import ConfigError, InputError, UnwritableError

LEFTOVER = re.compile(r"\..+\.[0-9a-f]{8}\.part")
"""Pattern of the names of temporary files, including those of earlier versions."""

LOCK_TIMEOUT = 1.0
"""Seconds to wait for a lock; ours: the workers of a killed run end within an image."""

HINTS = {
    errno.ENAMETOOLONG: "give it a shorter name",
    **dict.fromkeys((errno.ENOSPC, errno.EDQUOT), "make room, or choose a folder with room"),
    None: "check that the disk has room and is intact",
}
"""Hints for files that cannot be written, by errno; None for errors without a number."""

OUT_HINT = "give another --out"

FORMULA_STARTS = ("=", "+", "-", "@", "\t", "\r", "'")
"""First characters of cells that spreadsheets take for a formula, and of escaped cells."""


def file_digest(path: Path, data: bytes | None = None) -> str:
    """Return the SHA-256 of ``data``, else of a file's bytes; "" if it is no readable file."""
    if data is not None:
        return hashlib.sha256(data).hexdigest()
    with suppress(OSError):
        if path.is_file():
            with path.open("rb") as file:
                return hashlib.file_digest(file, "sha256").hexdigest()
    return ""


def folder_digest(path: Path) -> str:
    """Return the SHA-256 of the names and digests of the files in a folder; "" without a file."""
    digest, result = hashlib.sha256(), ""
    for file in sorted(path.iterdir()):
        if checksum := file_digest(file):
            digest.update(f"{checksum} {file.name}\n".encode("utf-8", "surrogateescape"))
            result = digest.hexdigest()
    return result


# --- folders and files ------------------------------------------------------------------


def make_folder(path: Path, hint: str = "give another folder") -> None:
    """Make a folder and its parents; raise UnwritableError with the hint if that fails."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UnwritableError(path, f"cannot be created: {error.strerror}", hint) from None


@contextmanager
def atomic_write(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield a temporary path in the folder of ``path``, and rename it to ``path`` at the end.

    Whatever happens, ``path`` holds its old content or all of the new one, and no temporary
    file stays; ``remove_leftovers`` removes those of a killed process. The temporary name is
    short, whatever the name of ``path``. Raises UnwritableError if it cannot be written.
    """
    path = Path(path)
    temporary = path.with_name(f".roadtorch.{secrets.token_hex(4)}.part")
    try:
        yield temporary
        os.replace(temporary, path)
    except OSError as error:
        raise write_error(path, error) from None
    finally:
        with suppress(OSError):  # if even looking for it fails, there is none to remove
            temporary.unlink(missing_ok=True)


def write_error(path: Path, error: OSError) -> UnwritableError:
    """Return the UnwritableError, with a hint, for an OSError at a file."""
    hint = HINTS.get(error.errno, "choose a folder that you may write to")
    return UnwritableError(path, f"cannot be written: {error.strerror or error}", hint)


def remove_leftovers(folders: Iterable[Path]) -> None:
    """Remove temporary files of killed processes; no process may be writing to the folders."""
    for folder in folders:
        with suppress(OSError):
            for path in folder.iterdir():
                if LEFTOVER.fullmatch(path.name):
                    path.unlink(missing_ok=True)


# --- locks ------------------------------------------------------------------------------


@contextmanager
def lock_folder(folder: Path) -> Iterator[None]:
    """Make a folder, hold its exclusive lock, and remove what killed runs left in it.

    The lock is on the folder itself (flock): it needs no file, and ends with the process and
    its workers, however they end; a run waits ``LOCK_TIMEOUT`` for those of a killed one.
    If the system or the disk has no locks, other runs are not excluded. Raises InputError where
    the folder cannot be written, or another run holds a lock.
    """
    if re.match(r"[A-Za-z0-9+.-]{2,}:/", str(folder)):
        raise InputError(folder, "is an address", "give a local folder, then copy or sync it")
    make_folder(folder, OUT_HINT)
    try:
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        raise InputError(folder, f"cannot be written: {error.strerror}", OUT_HINT) from None
    with _open_folder(folder) as handle:
        end = monotonic() + LOCK_TIMEOUT
        while _lock(handle, exclusive=True) is False:
            if monotonic() > end:
                hint = f"wait for it, or {OUT_HINT}"
                raise InputError(folder, "another run is writing here", hint)
            sleep(LOCK_TIMEOUT / 50)
        remove_leftovers([folder])
        yield


@contextmanager
def share_folder(folder: Path) -> Iterator[None]:
    """Make a folder and hold its shared lock, with which several runs may write into it.

    A run that finds no other removes the temporary files of killed runs, also in subfolders that
    no run has locked. Without locks nothing is removed.
    """
    make_folder(folder)
    with _open_folder(folder) as handle:
        if _lock(handle, exclusive=True):
            for parent, subfolders, _ in os.walk(folder):
                remove_leftovers([Path(parent)])
                subfolders[:] = [name for name in subfolders if _is_unlocked(Path(parent, name))]
        _lock(handle, exclusive=False)
        yield


def _is_unlocked(folder: Path) -> bool:
    """Return whether no run holds a lock of a folder."""
    with _open_folder(folder) as handle:
        return bool(_lock(handle, exclusive=True))


@contextmanager
def _open_folder(folder: Path) -> Iterator[int]:
    handle = os.open(folder, os.O_RDONLY)
    try:
        yield handle
    finally:
        os.close(handle)


def _lock(handle: int, *, exclusive: bool) -> bool | None:
    """Take the lock of a folder, or change its kind; None where there are no locks.

    Returns False for an exclusive lock while any other is held; a shared one waits for an
    exclusive one.
    """
    try:
        import fcntl

        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB if exclusive else fcntl.LOCK_SH)
    except BlockingIOError:
        return False
    except (ImportError, OSError):
        return None
    return True


# --- results ----------------------------------------------------------------------------

RESULTS_FILE = ".roadtorch.json"
"""Ledger of the files below its folder that roadtorch wrote: their names, each with its input."""


def read_results(folder: Path) -> dict[str, str]:
    """Return the input of each result in the ledger of a folder; empty where it is unreadable."""
    with suppress(OSError, ValueError, AttributeError):
        ledger = json.loads(read_regular(folder / RESULTS_FILE))
        return {name: str(origin) for name, origin in ledger.items()}
    return {}


@contextmanager
def claim_results(
    folder: Path,
    results: Mapping[str, str],
    overwrite: bool | None = None,
    is_same: Callable[[str], bool] = lambda name: False,
    hint: str = OUT_HINT,
) -> Iterator[None]:
    """Refuse to replace files that are no earlier results of the same input; list the new ones.

    The ledger of the folder lists all of them in the block, so that a killed run can be resumed,
    and afterwards those that exist. Raises ConfigError for the first file that would be replaced.

    results: the input of each file by its name; ``{}`` stands for any text, and a name that ends in
    ``/`` is a folder. overwrite: replace results of other inputs; None where no option does.
    is_same: returns whether the input of a result, though elsewhere, has the earlier one's bytes.
    """
    ledger, find = read_results(folder), _make_finder(folder)
    for name, origin in results.items():
        owner = ledger.get(name)
        if owner == origin or not (file := find(name)):
            continue
        if owner is None:
            raise ConfigError(folder / file, "exists and was not written by roadtorch", hint)
        if not overwrite and not is_same(name):
            hint += ", or --overwrite" * (overwrite is False)
            raise ConfigError(folder / file, f"is a result of {owner or 'another input'}", hint)
    _write_results(folder, {**ledger, **results})
    try:
        yield
    finally:
        find = _make_finder(folder)
        ledger = {**read_results(folder), **results}
        with suppress(InputError):  # the file written above lists all of them
            names = [name for name in ledger if name not in results or find(name)]
            _write_results(folder, {name: ledger[name] for name in names})


def _write_results(folder: Path, ledger: Mapping[str, str]) -> None:
    """Write the ledger of a folder, unless it is up to date; remove one that would be empty."""
    if not ledger:
        (folder / RESULTS_FILE).unlink(missing_ok=True)
    elif ledger != read_results(folder):
        write_text(folder / RESULTS_FILE, json.dumps(ledger, indent=0, sort_keys=True) + "\n")


def _make_finder(folder: Path) -> Callable[[str], str | None]:
    """Return a function that finds the first file of a name of ``claim_results`` in a folder."""

    @cache
    def names_in(parent: str) -> list[str]:
        with suppress(OSError):
            names = os.listdir(folder / parent)
            return sorted(name for name in names if not LEFTOVER.fullmatch(name))
        return []

    def find(name: str) -> str | None:
        name += "{}" * name.endswith("/")
        parent, start = os.path.split(name.partition("{}")[0])
        names, pattern = names_in(parent), _pattern(name)
        for number in range(bisect_left(names, start), len(names)):
            path = f"{parent}/{names[number]}".lstrip("/")
            if fnmatchcase(path, pattern):
                return path
            if not names[number].startswith(start):
                break
        return None

    return find


def _pattern(name: str) -> str:
    """Return the pattern of ``fnmatchcase`` of a name of ``claim_results``."""
    return glob.escape(name).replace("{}", "*")


def relative_name(path: str | os.PathLike[str], folder: Path) -> str:
    """Return the name of a file seen from a folder; links to folders are resolved, to files not."""
    parent, name = os.path.split(os.path.abspath(path))
    path = os.path.join(os.path.realpath(parent), name)
    with suppress(ValueError):  # on another drive of Windows
        path = os.path.relpath(path, os.path.realpath(folder))
    return Path(path).as_posix()


def make_result_filter() -> Callable[[str], bool]:
    """Return a function that tells whether a path is listed in a ledger beside or above it."""
    results_in = cache(lambda folder: read_results(Path(folder)))
    patterns_in = cache(lambda folder: [_pattern(n) for n in results_in(folder) if "{}" in n])

    def is_result(path: str) -> bool:
        path = folder = os.path.abspath(path)
        while folder != (folder := os.path.dirname(folder)):
            if results := results_in(folder):
                name = Path(path).relative_to(folder).as_posix()
                is_listed = name in results or f"{name}/" in results
                if is_listed or any(fnmatchcase(name, pattern) for pattern in patterns_in(folder)):
                    return True
        return False

    return is_result


def write_text(path: str | os.PathLike[str], text: str) -> None:
    r"""Write UTF-8 text, line ends unchanged, bytes of names that are not UTF-8 as ``\xff``."""
    with atomic_write(path) as temporary:
        temporary.write_bytes(to_printable(text).encode())


def write_json(path: str | os.PathLike[str], document: object) -> None:
    """Write JSON, indented by two, the same bytes each time; ValueError for NaN and infinity."""
    write_text(path, json.dumps(document, indent=2, ensure_ascii=False, allow_nan=False) + "\n")


def csv_text(columns: Sequence[str], rows: Iterable[Mapping[str, object]]) -> str:
    """Return rows as CSV with a header; lines end in a line feed.

    A column that a row lacks stays empty; a key that is no column raises ValueError. Text that
    spreadsheets would take for a formula gets an apostrophe in front (``unescape_cell``).
    """
    # The csv module quotes only the line ends that it writes: with both, it quotes a carriage
    # return in a name, which readers would take for the end of a row.
    lines: list[str] = []
    for row in ({name: name for name in columns}, *rows):
        text = io.StringIO(newline="")
        cells = {name: _escape_cell(value) for name, value in row.items()}
        csv.DictWriter(text, columns, lineterminator="\r\n").writerow(cells)
        lines.append(text.getvalue().removesuffix("\r\n") + "\n")
    return "".join(lines)


def _escape_cell(value: object) -> object:
    if isinstance(value, str) and value.startswith(FORMULA_STARTS):
        with suppress(ValueError):
            float(value)
            return value
        return f"'{value}"
    return value


def unescape_cell(text: str) -> str:
    """Return the text of a cell of ``csv_text`` without its escaping apostrophe."""
    return text[1:] if text[:1] == "'" and text[1:].startswith(FORMULA_STARTS) else text
