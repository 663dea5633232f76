"""index.csv: one row for each image, frame and source, with its status, method and input hash.

Rows are appended as results arrive, so that a killed run loses at most the row being written, and
sorted at the end.
"""

import csv
import io
import os
import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from roadtorch.base.atomic import csv_text, unescape_cell, write_error, write_text
from roadtorch.base.bounded import read_regular, to_printable
from roadtorch.base.errors import ExitCode, InputError
from roadtorch.inputs.item import Item, Source

INDEX_FILE = "index.csv"
DONE, DOUBTFUL, PARTIAL, FAILED = "done", "doubtful", "partial", "failed"
"""Status of a row; all but ``done`` are followed by a colon and the reason."""

BAG_METADATA_FILE = "metadata.yaml"


@dataclass(frozen=True, slots=True)
class IndexRow:
    """A row of index.csv, all values as text."""

    file: str
    width: str = ""
    height: str = ""
    ms: str = ""  # milliseconds from reading to the last file written
    road_fraction: str = ""
    trust: str = ""  # predicted F-score of the mask, 0 to 1; empty where the detector has none
    status: str = DONE
    saved: str = ""  # kinds of results written, separated by spaces
    method: str = ""  # see ``Method``
    sha256: str = ""  # of the image file
    seconds: str = ""  # time stamp of a frame, relative to the start of its source
    cues: str = ""  # names of cues, separated by slashes, which no file name can contain

    @property
    def failed(self) -> bool:
        """True where there is no result, or only a part of a video's frames."""
        return self.status.startswith((FAILED, PARTIAL))

    @property
    def doubtful(self) -> bool:
        """True where the result should be checked by eye before it is used."""
        return self.status.startswith(DOUBTFUL)


INDEX_COLUMNS = list(IndexRow.__dataclass_fields__)


def failed_row(name: str, error: object) -> IndexRow:
    """Return the row of an item without a result, with the error in its status."""
    return IndexRow(name, status=f"{FAILED}: {' '.join(str(error).split())}")


@dataclass(frozen=True)
class Method:
    """All but the image that results depend on: two runs of one method give the same bytes."""

    key: str  # hash of it, see ``roadtorch.run.memo.cache_key``
    kinds: tuple[str, ...]  # of results that are written

    def mark(self, row: IndexRow) -> IndexRow:
        """Return a row marked as made with this method; a failed row is returned unchanged."""
        return row if row.failed else replace(row, saved=" ".join(self.kinds), method=self.key)

    def covers(self, row: IndexRow | None) -> bool:
        """Return whether a row lists all these kinds, made with this method."""
        if row is None or row.failed or row.method != self.key:
            return False
        return set(self.kinds) <= set(row.saved.split())


def read_index(path: Path) -> dict[str, IndexRow]:
    """Read the last row of each file in an index.csv, if any; InputError if it is no index."""
    if not path.exists():
        return {}
    try:
        text = read_regular(path).decode("utf-8-sig")
        whole = io.StringIO(text[: text.rfind("\n") + 1], newline="")  # a killed run may cut a row
        lines = csv.DictReader(whole)
        rows = [
            IndexRow(**{key: unescape_cell(cell) for key, cell in line.items()}) for line in lines
        ]
        if any(None in asdict(row).values() for row in rows):
            raise TypeError("a row is cut short")
        return {row.file: _whole_pixels(row) for row in rows}
    except (OSError, ValueError, OverflowError, TypeError, KeyError, csv.Error):
        raise InputError(path, "is not an index of roadtorch", "give another --out") from None


def _whole_pixels(row: IndexRow) -> IndexRow:
    """Return a row with whole width and height, which spreadsheets write as 160.0.

    Raises ValueError or OverflowError for a column of numbers that holds something else.
    """
    for cell in (row.ms, row.road_fraction, row.trust, row.seconds):
        float(cell or 0)
    width, height = (cell and str(int(float(cell))) for cell in (row.width, row.height))
    return replace(row, width=width, height=height)


def write_index(path: Path, rows: Iterable[IndexRow]) -> None:
    """Write rows, sorted by file, as index.csv."""
    write_text(path, csv_text(INDEX_COLUMNS, map(asdict, sorted(rows, key=lambda row: row.file))))


def has_result(folder: Path, name: str) -> bool:
    """Return whether a result exists; a ROS 2 bag does once its metadata.yaml is written."""
    path = folder / name
    with suppress(OSError):  # the name is too long for a file
        return path.is_file() or (path / BAG_METADATA_FILE).is_file()
    return False


class Ledger:
    """The index of an output folder while a run adds rows to it; see ``open_ledger``."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.rows = read_index(path)
        self._folder = path.parent.stat()

    def check_folder(self) -> None:
        """Raise InputError where the folder is no longer the one in which the run began."""
        folder = self.path.parent
        with suppress(OSError):
            if os.path.samestat(folder.stat(), self._folder):
                return
        error = InputError(folder, "was moved during the run", "run it again, --out where it is")
        error.exit_code = ExitCode.SOME_FAILED  # earlier results are kept
        raise error

    def is_done(self, item: Item | Source, method: Method, suffixes: Sequence[str]) -> bool:
        """Return whether an item has all files, made with this method from its current bytes."""
        row = self.rows.get(item.row_name)
        if row is None or not method.covers(row) or item.digest is None:
            return False
        cues = filter(None, row.cues.split("/"))
        of_cues = [end.format(cue) for cue in cues for end in suffixes if "{}" in end]
        return self.has_files(item, [*suffixes, *of_cues]) and row.sha256 == item.digest() != ""

    def has_files(self, item: Item | Source, suffixes: Iterable[str]) -> bool:
        """Return whether the files of all suffixes exist, except those of cues."""
        ends = [end for end in suffixes if "{}" not in end]
        return all(has_result(self.path.parent, item.name + end) for end in ends)

    def add(self, row: IndexRow) -> None:
        """Append a row, keeping earlier kinds of its method and bytes; InputError if unwritable."""
        self.check_folder()
        earlier = self.rows.get(row.file)
        if earlier and (earlier.method, earlier.sha256) == (row.method, row.sha256):
            kinds = dict.fromkeys([*earlier.saved.split(), *row.saved.split()])
            row = replace(row, saved=" ".join(kinds))
        self.rows[row.file] = row
        text = csv_text(INDEX_COLUMNS, [asdict(row)])
        try:
            with self.path.open("ab", buffering=0) as file:
                text = text.partition("\n")[2] if file.tell() else text
                file.write(to_printable(text).encode())
        except OSError as error:
            failure = write_error(self.path, error)
            failure.exit_code = ExitCode.SOME_FAILED  # earlier results are kept
            raise failure from None

    def drop_frames(self, name: str) -> None:
        """Drop the rows of a source's frames, before it is processed again."""
        frame = re.compile(rf"{re.escape(name)}/{FRAME_NUMBER}")
        for file in [file for file in self.rows if frame.fullmatch(file)]:
            del self.rows[file]


FRAME_NUMBER = r"\d{6,}"  # pattern of a frame's number, which follows ``NAME/`` of its source


@contextmanager
def open_ledger(path: Path) -> Iterator[Ledger]:
    """Open the ledger of an index.csv, and sort the file at the end; InputError if unusable."""
    ledger = Ledger(path)
    write_index(path, ledger.rows.values())
    try:
        yield ledger
    finally:
        ledger.check_folder()
        write_index(path, ledger.rows.values())
