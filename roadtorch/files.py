"""Files that are never half-written, and the folders they go to."""

import csv
import errno
import io
import os
import re
import secrets
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from roadtorch.errors import InputError

LEFTOVER = re.compile(r"\..+\.[0-9a-f]{8}\.part")
"""The names of temporary files, those of earlier versions among them."""

REMEDIES = {
    errno.ENAMETOOLONG: "give it a shorter name",
    errno.ENOSPC: "make room, or choose a folder with room",
    errno.EDQUOT: "make room, or choose a folder with room",
}
"""What helps when a file cannot be written, by the number of the error."""

# --- out --------------------------------------------------------------------------------


def make_folder(path: Path, remedy: str = "give another folder") -> None:
    """Make a folder and those above it; InputError with the remedy when that is not possible."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as problem:
        what = f"cannot be made a folder: {problem.strerror}"
        raise InputError(path, what, remedy) from None


@contextmanager
def atomic(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield a temporary path in the folder of ``path``; rename it at the end, if all went well.

    Whatever happens, ``path`` holds its old content or all of the new one, and no temporary
    file stays; ``remove_leftovers`` takes those of a process that was killed. The temporary
    name is short, whatever the name of ``path``. Raises InputError when it cannot be written.
    """
    path = Path(path)
    temporary = path.with_name(f".roadtorch.{secrets.token_hex(4)}.part")
    try:
        yield temporary
        os.replace(temporary, path)
    except OSError as problem:
        what = f"cannot be written: {problem.strerror or problem}"
        remedy = REMEDIES.get(problem.errno or 0, "choose a folder that you may write to")
        raise InputError(path, what, remedy) from None
    finally:
        # Where even looking for the file fails there is none to remove.
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


def remove_leftovers(folders: Iterable[Path]) -> None:
    """Remove what killed processes left in the folders; no process may be writing there now."""
    for folder in folders:
        with suppress(OSError):
            for path in folder.iterdir():
                if LEFTOVER.fullmatch(path.name):
                    path.unlink(missing_ok=True)


def write_text(path: str | os.PathLike[str], text: str) -> None:
    """Write UTF-8 text with the line ends as they are."""
    with atomic(path) as temporary:
        temporary.write_bytes(text.encode())


def csv_text(columns: Sequence[str], rows: Iterable[Mapping[str, object]]) -> str:
    """Rows as CSV under a line with the names of the columns; lines end in a line feed.

    A column that a row lacks stays empty; ValueError for a row with a key that is no column.
    """
    # The csv module quotes only the line ends that it is told to write: told of both, it quotes
    # a carriage return in a name, which readers would take for the end of a row.
    lines: list[str] = []
    for row in ({name: name for name in columns}, *rows):
        text = io.StringIO(newline="")
        csv.DictWriter(text, columns, lineterminator="\r\n").writerow(row)
        lines.append(text.getvalue().removesuffix("\r\n") + "\n")
    return "".join(lines)
