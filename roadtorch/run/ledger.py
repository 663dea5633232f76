"""The ledger of an output folder: whose its files are, and what is done.

``.roadtorch.json`` names the input of each file before it is written, see ``claim_results``.
index.csv has a row for each image, frame and source, with its status and the key of its results:
the hash of the input's bytes, and that of all else that they depend on, see ``cache_key``. Rows are
appended as results arrive, so that a killed run loses at most the row being written, and sorted at
the end.
"""

import csv
import io
import os
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from types import MappingProxyType

from roadtorch.base.atomic import (
    OUT_HINT,
    claim_results,
    csv_text,
    lock_folder,
    relative_name,
    unescape_cell,
    write_error,
    write_text,
)
from roadtorch.base.bounded import read_regular, to_printable
from roadtorch.base.errors import ConfigError, ExitCode, InputError
from roadtorch.base.settings import INFER_CONFIG
from roadtorch.inputs.item import Item, Source

INDEX_FILE, COCO_FILE, RUN_FILE = "index.csv", "coco.json", "run.json"
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
    method: str = ""  # key of all else that results depend on, see ``roadtorch.run.memo``
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
        raise InputError(path, "is not an index of roadtorch", OUT_HINT) from None


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
    write_text(path, index_text(rows))


def index_text(rows: Iterable[IndexRow]) -> str:
    """Return the text of an index.csv with rows, sorted by file."""
    ordered = sorted(rows, key=lambda row: row.file)
    return to_printable(csv_text(INDEX_COLUMNS, map(asdict, ordered)))


def has_result(folder: Path, name: str) -> bool:
    """Return whether a result exists; a ROS 2 bag does once its metadata.yaml is written."""
    path = folder / name
    with suppress(OSError):  # the name is too long for a file
        return path.is_file() or (path / BAG_METADATA_FILE).is_file()
    return False


class Ledger:
    """The rows of an output folder, while a run adds to them; see ``open_ledger``."""

    def __init__(self, folder: Path, rows: dict[str, IndexRow]) -> None:
        self.folder, self.rows = folder, rows
        self._status = folder.stat()

    def check_folder(self) -> None:
        """Raise InputError where the folder is no longer the one in which the run began."""
        with suppress(OSError):
            if os.path.samestat(self.folder.stat(), self._status):
                return
        hint = "run it again, --out where it is"
        error = InputError(self.folder, "was moved during the run", hint)
        error.exit_code = ExitCode.SOME_FAILED  # earlier results are kept
        raise error

    def is_done(
        self, item: Item | Source, key: str, kinds: Iterable[str], suffixes: Sequence[str]
    ) -> bool:
        """Return whether an item has the files of all kinds, made under a key from its bytes."""
        row = self.rows.get(item.row_name)
        if row is None or row.failed or row.method != key or item.digest is None:
            return False
        cues = filter(None, row.cues.split("/"))
        ends = [end.format(cue) for cue in cues for end in suffixes if "{}" in end]
        ends += [end for end in suffixes if "{}" not in end]
        is_whole = all(has_result(self.folder, item.name + end) for end in ends)
        return is_whole and {*kinds} <= {*row.saved.split()} and row.sha256 == item.digest() != ""

    def add(self, row: IndexRow) -> None:
        """Append a row, keeping earlier kinds of its key and bytes; InputError if unwritable."""
        self.check_folder()
        earlier = self.rows.get(row.file)
        if earlier and (earlier.method, earlier.sha256) == (row.method, row.sha256):
            kinds = dict.fromkeys([*earlier.saved.split(), *row.saved.split()])
            row = replace(row, saved=" ".join(kinds))
        self.rows[row.file] = row
        text, path = csv_text(INDEX_COLUMNS, [asdict(row)]), self.folder / INDEX_FILE
        try:
            with path.open("ab", buffering=0) as file:
                text = text.partition("\n")[2] if file.tell() else text
                file.write(to_printable(text).encode())
        except OSError as error:
            failure = write_error(path, error)
            failure.exit_code = ExitCode.SOME_FAILED  # earlier results are kept
            raise failure from None

    def drop_frames(self, name: str) -> None:
        """Drop the rows of a source's frames, before it is processed again."""
        frame = re.compile(rf"{re.escape(name)}/{FRAME_NUMBER}")
        for file in [file for file in self.rows if frame.fullmatch(file)]:
            del self.rows[file]


FRAME_NUMBER = r"\d{6,}"  # pattern of a frame's number, which follows ``NAME/`` of its source


@contextmanager
def open_ledger(
    out: Path,
    effective: str,
    overwrite: bool = False,
    results: Mapping[str, Item | Source | None] = MappingProxyType({}),
) -> Iterator[Ledger]:
    """Lock an output folder, claim its results, open its ledger, and sort index.csv at the end.

    effective: the settings as TOML, which config.toml then holds. results: the input of each by
    name, see ``claim_results``; None for those of the run itself.

    Raises:
        InputError: The folder is locked, moved or cannot be written, or a file of it is damaged.
        ConfigError: A file is not by roadtorch; or, unless ``overwrite``, of another input, or the
            results are of other settings, with which those of this run would mix.
    """
    config = out / INFER_CONFIG

    def is_same(name: str) -> bool:
        item = results.get(name)
        row = rows.get(item.row_name) if item else None
        return bool(item and row and item.digest and row.sha256 == item.digest() != "")

    with lock_folder(out):
        rows = read_index(out / INDEX_FILE)
        claims: dict[str, str] = dict.fromkeys((INDEX_FILE, INFER_CONFIG), "")
        for name, item in results.items():
            file = item and (item.file if isinstance(item, Item) else item.path)
            claims[name] = relative_name(file, out) if file else item.origin if item else ""
        with claim_results(out, claims, overwrite, is_same):
            settings = to_printable(f"{effective}\n").encode()
            try:
                differs = config.exists() and read_regular(config) != settings
            except OSError as error:
                raise InputError(config, f"cannot be read: {error.strerror}", OUT_HINT) from None
            if differs and rows and not overwrite:
                problem = f"holds results of other settings ({INFER_CONFIG})"
                raise ConfigError(out, problem, f"{OUT_HINT}, or --overwrite")
            write_text(config, f"{effective}\n")
            write_index(out / INDEX_FILE, rows.values())
            ledger = Ledger(out, rows)
            try:
                yield ledger
            finally:
                ledger.check_folder()
                write_index(out / INDEX_FILE, rows.values())
