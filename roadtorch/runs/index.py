"""index.csv: a row for every picture and frame of a run, kept as the run goes on."""

import csv
import io
import re
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from time import monotonic

from roadtorch.errors import InputError
from roadtorch.io.atomic import RoomyFile, csv_text, from_cell, unwritable, write_text
from roadtorch.io.bounded import printable, read_regular

INDEX = "index.csv"
DONE, DOUBTFUL, PARTIAL, FAILED = "done", "doubtful", "partial", "failed"
"""What the status of a row begins with; after a colon it says why."""

SAVE_EVERY = 5.0  # seconds of work that a power cut may cost, at most
SAVING = 0.05  # the share of the time that saving may take: a long index is saved less often

LAST_ROWS = 2**16  # bytes held for the last rows of frames, should the disk become full

Publish = Callable[[Path], None]
"""Told of a file of the run that has been written: what is done with it then."""


@dataclass(frozen=True)
class Row:
    """One line of index.csv. ``ms`` is the time from reading to the last file written.

    trust: the expected F of the mask, empty where the detector does not say.
    saved: the kinds of results that were written; method: what they were made with, see
    ``Method``; sha256: of the bytes of the picture, see ``Job.digest``. seconds: of a frame, since
    its source began. cues: their names, between slashes, which stand in no file's name.
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


class SavedIndex:
    """index.csv as a run goes on: saved after every row, or as often as is worth it.

    publish: is called with the file whenever it has been saved.
    """

    def __init__(self, path: Path, rows: dict[str, Row], publish: Publish) -> None:
        self.path, self.rows, self._publish = path, rows, publish
        self._due = 0.0

    def add(self, row: Row) -> None:
        """Keep one more row, with the kinds that the same method gave of the same bytes before.

        On a full disk the index stays as it was until the end.
        """
        earlier = self.rows.get(row.file)
        if earlier and (earlier.method, earlier.sha256) == (row.method, row.sha256):
            kinds = dict.fromkeys([*earlier.saved.split(), *row.saved.split()])
            row = replace(row, saved=" ".join(kinds))
        self.rows[row.file] = row
        start = monotonic()
        if start < self._due:
            return
        with suppress(InputError):
            write_index(self.path, self.rows.values())
            self._publish(self.path)
        took = monotonic() - start
        self._due = start + took + min(took / SAVING, SAVE_EVERY)

    def finish(self, let_go: Callable[[], None]) -> None:
        """Write all rows, in the room that was held for them if the disk is full.

        Raises InputError when even that is not possible.
        """
        try:
            write_index(self.path, self.rows.values())
        except InputError:
            let_go()
            write_index(self.path, self.rows.values())
        self._publish(self.path)


def read_index(path: Path) -> dict[str, Row]:
    """The rows of an index.csv by file; empty when there is none.

    Raises InputError when a file of that name is something else.
    """
    if not path.exists():
        return {}
    try:
        text = read_regular(path).decode()
        whole = io.StringIO(text[: text.rfind("\n") + 1], newline="")  # a killed run may cut a row
        lines = csv.DictReader(whole)
        rows = [Row(**{key: from_cell(cell) for key, cell in line.items()}) for line in lines]
        if any(None in vars(row).values() for row in rows):
            raise TypeError("a row is cut short")
        return {row.file: row for row in rows}
    except (OSError, UnicodeDecodeError, TypeError, KeyError, csv.Error):
        raise InputError(path, "is not an index of ours", "give another --out") from None


def write_index(path: Path, rows: Iterable[Row]) -> None:
    """Write rows, sorted by file, as index.csv."""
    columns = list(Row.__dataclass_fields__)
    write_text(path, csv_text(columns, map(asdict, sorted(rows, key=lambda row: row.file))))


# --- footage ----------------------------------------------------------------------------


@contextmanager
def frame_index(path: Path, file: str, frames: str) -> Iterator[Callable[[Row], None]]:
    """What appends a row to the index, none of them in memory: for a source and its frames.

    Their rows of earlier runs are left out; one of a killed run that is cut short is dropped when
    the index is read. file: what index.csv calls the source. frames: the pattern of its frames'
    names. Appending raises InputError when the disk is full.
    """
    rows, own = read_index(path).values(), re.compile(f"{re.escape(file)}|{frames}")
    write_index(path, [row for row in rows if not own.fullmatch(row.file)])
    with closing(RoomyFile(path, "ab", LAST_ROWS)) as appended:

        def add(row: Row) -> None:
            text = csv_text(list(Row.__dataclass_fields__), [asdict(row)]).partition("\n")[2]
            appended.write(printable(text).encode())
            if (problem := appended.lost) is not None:
                raise unwritable(path, problem)

        yield add
