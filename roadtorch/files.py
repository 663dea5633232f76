"""Files that are never half-written, and the folders they go to."""

import csv
import io
import os
import secrets
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from roadtorch.errors import InputError
from roadtorch.outside import printable

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

    Whatever happens, ``path`` holds its old content or all of the new one, and no
    temporary file stays. Raises InputError when the folder cannot be written.
    """
    path = Path(path)
    temporary = path.with_name(f".{path.name}.{secrets.token_hex(4)}.part")
    try:
        yield temporary
        os.replace(temporary, path)
    except OSError as problem:
        what = f"cannot be written: {problem.strerror or problem}"
        raise InputError(path, what, "choose a folder with room that you may write to") from None
    finally:
        # Where even looking for the file fails there is none to remove.
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


def write_text(path: str | os.PathLike[str], text: str) -> None:
    """Write UTF-8 text with the line ends as they are; other bytes of names as ``\\xff``."""
    with atomic(path) as temporary:
        temporary.write_bytes(printable(text).encode())


def csv_text(columns: Sequence[str], rows: Iterable[Mapping[str, object]]) -> str:
    """Rows as CSV under a line with the names of the columns; lines end in a line feed.

    A column that a row lacks stays empty; ValueError for a row with a key that is no column.
    """
    text = io.StringIO(newline="")
    table = csv.DictWriter(text, columns, lineterminator="\n")
    table.writeheader()
    table.writerows(rows)
    return text.getvalue()
