"""index.csv while footage is worked through: a row a frame, appended, however many there are."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path

from roadtorch.errors import InputError
from roadtorch.io.atomic import REMEDIES, RoomyFile, csv_text
from roadtorch.io.bounded import printable
from roadtorch.runs.batch import Job
from roadtorch.runs.index import Row, read_index, write_index

ROOM = 2**16  # bytes held for the last rows, should the disk become full


class FrameIndex:
    """An index.csv that is open for rows at its end; none of them is kept in memory."""

    def __init__(self, path: Path, file: RoomyFile) -> None:
        self._path, self._file = path, file

    def add(self, row: Row) -> None:
        """Append a row; InputError when the disk is full."""
        text = csv_text(list(Row.__dataclass_fields__), [asdict(row)]).partition("\n")[2]
        self._file.write(printable(text).encode())
        if (problem := self._file.lost) is not None:
            what = f"cannot be written: {problem.strerror}"
            remedy = REMEDIES.get(problem.errno or 0, "choose a folder that you may write to")
            raise InputError(self._path, what, remedy)


@contextmanager
def appended(path: Path, job: Job) -> Iterator[FrameIndex]:
    """The index for the frames of a job, without the rows that it had before.

    A row of a killed run that is cut short is dropped when the index is read.
    """
    rows = read_index(path).values()
    frames = printable(job.picture.name) + "/"
    kept = [row for row in rows if row.file != job.file and not row.file.startswith(frames)]
    write_index(path, kept)
    file = RoomyFile(path, "ab", ROOM)
    try:
        yield FrameIndex(path, file)
    finally:
        file.close()
