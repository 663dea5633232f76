"""index.csv: what is done, with which settings, for which bytes; a row for every item.

Rows are appended as they come, so that a killed run loses none but one that is cut, and are sorted
at the end.
"""

import csv
import io
import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from roadtorch.base.atomic import csv_text, from_cell, unwritable, write_text
from roadtorch.base.bounded import printable, read_regular
from roadtorch.base.errors import ExitCode, InputError
from roadtorch.inputs.item import Item, Source

INDEX = "index.csv"
DONE, DOUBTFUL, PARTIAL, FAILED = "done", "doubtful", "partial", "failed"
"""What the status of a row begins with; after a colon it says why."""

BAG_LIST = "metadata.yaml"


@dataclass(frozen=True, slots=True)
class Row:
    """One line of index.csv. ``ms`` is the time from reading to the last file written.

    trust: the expected F of the mask, empty where the detector does not say.
    saved: the kinds of results that were written; method: what they were made with, see
    ``Method``; sha256: of the bytes of the image. seconds: of a frame, since its source began.
    cues: their names, between slashes, which stand in no file's name.
    """

    file: str
    width: str = ""
    height: str = ""
    ms: str = ""
    road_share: str = ""
    trust: str = ""
    status: str = DONE
    saved: str = ""
    method: str = ""
    sha256: str = ""
    seconds: str = ""
    cues: str = ""

    @property
    def failed(self) -> bool:
        """Whether there is no result, or, of footage, only a part of it."""
        return self.status.startswith((FAILED, PARTIAL))

    @property
    def doubtful(self) -> bool:
        """Whether the result should be looked at before it is used."""
        return self.status.startswith(DOUBTFUL)


COLUMNS = list(Row.__dataclass_fields__)


def failed_row(name: str, error: object) -> Row:
    """The row of what has no result; its status says why, on one line."""
    return Row(name, status=f"{FAILED}: {' '.join(str(error).split())}")


@dataclass(frozen=True)
class Method:
    """What results are made with: two runs of one method give the same bytes.

    key: of everything that the results depend on but the image, see ``roadtorch.run.memo.key_of``.
    kinds: what is written.
    """

    key: str
    kinds: tuple[str, ...]

    def made(self, row: Row) -> Row:
        """The row of a result with what it was made with; failed rows stay as they are."""
        return row if row.failed else replace(row, saved=" ".join(self.kinds), method=self.key)

    def covers(self, row: Row | None) -> bool:
        """Whether a row says that these kinds were made with this method, of whatever bytes."""
        if row is None or row.failed or row.method != self.key:
            return False
        return set(self.kinds) <= set(row.saved.split())


def read_index(path: Path) -> dict[str, Row]:
    """The rows of an index.csv by file, of each its last one; empty when there is none.

    Raises InputError when a file of that name is something else.
    """
    if not path.exists():
        return {}
    try:
        text = read_regular(path).decode()
        whole = io.StringIO(text[: text.rfind("\n") + 1], newline="")  # a killed run may cut a row
        lines = csv.DictReader(whole)
        rows = [Row(**{key: from_cell(cell) for key, cell in line.items()}) for line in lines]
        if any(None in asdict(row).values() for row in rows):
            raise TypeError("a row is cut short")
        return {row.file: row for row in rows}
    except (OSError, UnicodeDecodeError, TypeError, KeyError, csv.Error):
        raise InputError(path, "is not an index of ours", "give another --out") from None


def write_index(path: Path, rows: Iterable[Row]) -> None:
    """Write rows, sorted by file, as index.csv."""
    write_text(path, csv_text(COLUMNS, map(asdict, sorted(rows, key=lambda row: row.file))))


def has_result(folder: Path, name: str) -> bool:
    """Return whether a result exists; a bag that is a folder is one once it has its list."""
    path = folder / name
    with suppress(OSError):  # a name that is too long, which nothing can have
        return path.is_file() or (path / BAG_LIST).is_file()
    return False


class Ledger:
    """The rows of a folder of results while a run adds to them; see ``open_ledger``."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.rows = read_index(path)

    def is_done(self, item: Item | Source, method: Method, suffixes: Sequence[str]) -> bool:
        """Return whether an item is done, with this method, for the bytes that it has now.

        All files have to exist, those of the cues that its row names among them.
        """
        row = self.rows.get(item.row_name)
        if row is None or not method.covers(row) or item.digest is None:
            return False
        cues = filter(None, row.cues.split("/"))
        named = [end.format(cue) for cue in cues for end in suffixes if "{}" in end]
        return self.is_complete(item, [*suffixes, *named]) and row.sha256 == item.digest() != ""

    def is_complete(self, item: Item | Source, suffixes: Iterable[str]) -> bool:
        """Return whether all files exist whose names are known beforehand."""
        ends = [end for end in suffixes if "{}" not in end]
        return all(has_result(self.path.parent, item.name + end) for end in ends)

    def add(self, row: Row) -> None:
        """Keep one more row, with the kinds that the same method gave of the same bytes before.

        Raises InputError when it cannot be written.
        """
        earlier = self.rows.get(row.file)
        if earlier and (earlier.method, earlier.sha256) == (row.method, row.sha256):
            kinds = dict.fromkeys([*earlier.saved.split(), *row.saved.split()])
            row = replace(row, saved=" ".join(kinds))
        self.rows[row.file] = row
        text = csv_text(COLUMNS, [asdict(row)])
        try:
            with self.path.open("ab", buffering=0) as file:
                file.write(printable(text if not file.tell() else text.partition("\n")[2]).encode())
        except OSError as error:
            refusal = unwritable(self.path, error)
            refusal.exit_code = ExitCode.SOME_FAILED  # what was finished before stays
            raise refusal from None

    def forget_frames(self, name: str) -> None:
        """Leave out the rows of a source's frames: it is looked at anew."""
        own = re.compile(rf"{re.escape(name)}/{FRAME_NUMBER}")
        for file in [file for file in self.rows if own.fullmatch(file)]:
            del self.rows[file]


FRAME_NUMBER = r"\d{6,}"
"""What follows ``NAME/`` in the names of a source's frames."""


@contextmanager
def open_ledger(path: Path) -> Iterator[Ledger]:
    """The ledger in a file, sorted at the end of the block, however that comes.

    Raises InputError for a file that is no index, and for one that cannot be written.
    """
    ledger = Ledger(path)
    write_index(path, ledger.rows.values())
    try:
        yield ledger
    finally:
        write_index(path, ledger.rows.values())
