"""What ``infer`` and ``label`` share: many pictures, some broken, some already done."""

import csv
import os
import sys
import tempfile
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from time import monotonic

import click

from roadtorch.errors import ConfigError, InputError, RoadtorchError
from roadtorch.files import csv_text, make_folder, write_text
from roadtorch.outside import printable
from roadtorch.sources.pictures import Picture, find_images

INDEX = "index.csv"
DONE, DOUBTFUL, FAILED = "done", "doubtful", "failed"
"""What the status of a row begins with; after a colon it says why."""

LEAST_TRUSTED = 5
"""Pictures that are named at the end of a run, to be looked at first."""

ELSEWHERE = "give another --out"
SAVE_EVERY = 5.0  # seconds of work that a power cut may cost


@dataclass(frozen=True)
class Row:
    """One line of index.csv. ``ms`` is the time from reading to the last file written.

    trust: the expected F of the mask, empty where the detector does not say.
    """

    file: str
    width: str = ""
    height: str = ""
    ms: str = ""
    road_share: str = ""
    trust: str = ""
    status: str = DONE

    @property
    def failed(self) -> bool:
        """Whether there is no result."""
        return self.status.startswith(FAILED)


@dataclass(frozen=True)
class Job:
    """A picture, the folder of its results and how their names end, by kind."""

    picture: Picture
    out: Path
    suffixes: Mapping[str, str]

    def output(self, suffix: str) -> Path:
        """The file in ``out`` for results that end in ``suffix``; sub-folders are kept."""
        return self.out / (self.picture.name + suffix)

    @property
    def outputs(self) -> list[Path]:
        """All files whose names are known beforehand."""
        return [self.output(suffix) for suffix in self.suffixes.values()]

    @property
    def file(self) -> str:
        """The name in index.csv: the result's name with the picture's own suffix."""
        return printable(self.picture.name + self.picture.path.suffix)


Work = Callable[[Job], Row]


def plan(inputs: Sequence[str], out: Path, suffixes: Mapping[str, str]) -> list[Job]:
    """The jobs for all inputs; no file is written yet.

    suffixes: kind of result → what its file name ends with.
    Raises ConfigError when two pictures share a result or a result would replace a
    picture, InputError when nothing is found or ``out`` cannot be a folder.
    """
    jobs = [Job(picture, out, suffixes) for picture in find_images(inputs, apart=out)]
    _refuse_shared(jobs)
    _refuse_replacing(jobs)
    return jobs


def make_writable(path: Path) -> None:
    """Make a folder and try to write in it: InputError before the work, not after it."""
    make_folder(path, ELSEWHERE)
    try:
        tempfile.TemporaryFile(dir=path).close()
    except OSError as problem:
        what = f"cannot be written: {problem.strerror}"
        raise InputError(path, what, ELSEWHERE) from None


def _refuse_shared(jobs: Sequence[Job]) -> None:
    owners: dict[str, Job] = {}
    for job in jobs:
        other = owners.setdefault(job.picture.name, job)
        if other is not job:
            raise ConfigError(
                f"{other.picture.path} and {job.picture.path}",
                f"both would write {job.output(next(iter(job.suffixes.values()), ''))}",
                "rename one, or use two --out folders",
            )


def _refuse_replacing(jobs: Sequence[Job]) -> None:
    inputs = {_real(job.picture.path) for job in jobs}
    for job in jobs:
        for output in job.outputs:
            if _real(output) in inputs:
                raise ConfigError(output, "is one of the pictures", "give another --out")


def _real(path: Path) -> str:
    return os.path.realpath(path)  # Path.resolve raises for a link to itself


def run_jobs(jobs: Sequence[Job], out: Path, work: Work, options: "Options") -> int:
    """Do the jobs that are not done yet; returns the exit code.

    A picture is done when index.csv says so and its files exist. A picture that fails
    becomes a failed row, and the others go on.
    """
    rows = read_index(out / INDEX)
    todo = [job for job in jobs if options.overwrite or not _is_done(job, rows)]
    failed, found = 0, []
    saved = monotonic()
    try:
        for row in _show_progress(_in_order(todo, work, options.jobs), len(todo), options.quiet):
            failed += row.failed
            found.append(row)
            rows[row.file] = row
            if monotonic() - saved > SAVE_EVERY:
                write_index(out / INDEX, rows.values())
                saved = monotonic()
    finally:
        write_index(out / INDEX, rows.values())
    if not options.quiet or failed:
        click.echo(_summary(len(todo) - failed, len(jobs) - len(todo), failed, out), err=True)
        for line in least_trusted(found):
            click.echo(line)
    return 1 if failed else 0


@dataclass(frozen=True)
class Options:
    """How a run goes: threads at work, redo what is done, no progress on stderr."""

    jobs: int = 1
    overwrite: bool = False
    quiet: bool = False


def _is_done(job: Job, rows: Mapping[str, Row]) -> bool:
    row = rows.get(job.file)
    return row is not None and not row.failed and all(path.exists() for path in job.outputs)


def _in_order(jobs: Sequence[Job], work: Work, threads: int) -> Iterator[Row]:
    """The rows of all jobs in their order, a few jobs ahead at most.

    Threads, not processes: torch and OpenCV release Python's lock, nothing has to be
    loaded twice, and the thread count inside torch, hence every byte, stays the same.
    """
    if threads == 1:
        yield from (_attempt(job, work) for job in jobs)
        return
    with ThreadPoolExecutor(threads) as pool:
        waiting: deque[Future[Row]] = deque()
        try:
            for job in jobs:
                waiting.append(pool.submit(_attempt, job, work))
                if len(waiting) > threads:
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()
        finally:
            for future in waiting:
                future.cancel()


def _attempt(job: Job, work: Work) -> Row:
    """The row of one job; whatever goes wrong inside stays inside."""
    try:
        return work(job)
    except RoadtorchError as problem:
        # Detectors cannot know the file and speak of "image".
        where = job.picture.path if problem.where == "image" else problem.where
        what = f"{where}: {problem.what} ({problem.remedy})"
    except Exception as problem:
        # One picture that trips a detector must not cost the night's run.
        what = f"{job.picture.path}: {type(problem).__name__}: {problem} (report it)"
    return Row(job.file, status=f"{FAILED}: {' '.join(what.split())}")


def _show_progress(rows: Iterable[Row], total: int, quiet: bool) -> Iterator[Row]:
    """Pass the rows on, with a bar on a terminal and each failure on a line."""
    from tqdm import tqdm

    hidden = True if quiet else None  # None: hidden unless stderr is a terminal
    with tqdm(rows, total=total, unit="image", disable=hidden, file=sys.stderr) as bar:
        for row in bar:
            if row.failed:
                bar.write(f"roadtorch: {row.status}", file=sys.stderr)
            yield row


def _summary(done: int, skipped: int, failed: int, out: Path) -> str:
    parts = [f"{done} done", f"{skipped} skipped (done before)" if skipped else ""]
    parts.append(f"{failed} failed" if failed else "")
    return f"roadtorch: {', '.join(filter(None, parts))}; results in {out}"


def least_trusted(rows: Iterable[Row]) -> list[str]:
    """Lines that name the pictures whose masks should be looked at first, the worst on top.

    None where no row has a trust.
    """
    judged = sorted((row for row in rows if row.trust), key=lambda row: float(row.trust))
    if not judged:
        return []
    doubtful = sum(row.status.startswith(DOUBTFUL) for row in judged)
    shown = [
        f"  {row.trust}  {row.file}{row.status.removeprefix(DONE).removeprefix(DOUBTFUL)}"
        for row in judged[:LEAST_TRUSTED]
    ]
    return [f"roadtorch: {doubtful} doubtful of {len(judged)}; least trusted:", *shown]


def read_index(path: Path) -> dict[str, Row]:
    """The rows of an index.csv by file; empty when there is none.

    Raises InputError when a file of that name is something else.
    """
    if not path.exists():
        return {}
    try:
        with path.open(newline="", encoding="utf-8") as file:
            rows = [Row(**line) for line in csv.DictReader(file)]
        if any(None in vars(row).values() for row in rows):
            raise TypeError("a row is cut short")
        return {row.file: row for row in rows}
    except (OSError, UnicodeDecodeError, TypeError, KeyError, csv.Error):
        raise InputError(path, "is not an index of ours", "give another --out") from None


def write_index(path: Path, rows: Iterable[Row]) -> None:
    """Write rows, sorted by file, as index.csv."""
    columns = list(Row.__dataclass_fields__)
    write_text(path, csv_text(columns, map(asdict, sorted(rows, key=lambda row: row.file))))
