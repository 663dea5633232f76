"""What ``infer`` and ``label`` share: many pictures, some broken, some already done."""

import hashlib
import os
import sys
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Protocol

import click

from roadtorch.errors import ConfigError, RoadtorchError
from roadtorch.io.atomic import digest_of, digest_of_folder, remove_leftovers, reserved
from roadtorch.io.bounded import printable
from roadtorch.runs.index import DONE, DOUBTFUL, FAILED, INDEX, Publish, Row, SavedIndex, read_index
from roadtorch.runtime.signals import stop_on_signals
from roadtorch.sources.frame import Selection
from roadtorch.sources.pictures import Picture, find_images
from roadtorch.stream import ordered_results
from roadtorch.version import __version__

BAG_LIST = "metadata.yaml"

LEAST_TRUSTED = 5
"""Pictures that are named at the end of a run, to be looked at first."""

CHECKED_AT_ONCE = 8  # earlier results that are compared with their pictures at the same time

ROOM, ROOM_PER_ROW = 2**16, 2**9  # bytes held for index.csv, should the disk become full


class Task(Protocol):
    """One picture to work on, wherever it is and its results go."""

    @property
    def file(self) -> str:
        """The name in index.csv."""
        ...

    @property
    def origin(self) -> str:
        """What messages call the picture."""
        ...

    @property
    def is_complete(self) -> bool:
        """Whether all files exist whose names are known beforehand."""
        ...

    def has_all(self, row: Row) -> bool:
        """Whether all files exist, those of the cues that its row names among them."""
        ...

    def digest(self) -> str:
        """SHA-256 of the bytes of the picture; empty where it cannot be read."""
        ...


@dataclass(frozen=True)
class Method:
    """What results are made with: two runs of one method give the same bytes.

    digest: of everything that the results depend on but the picture, see ``method_of``.
    kinds: what is written.
    """

    digest: str
    kinds: tuple[str, ...]

    def finished(self, row: Row, job: Task) -> Row:
        """The row of a job with what it was made with and of; failed rows stay as they are."""
        if row.failed:
            return row
        digest = row.sha256 or job.digest()
        return replace(row, saved=" ".join(self.kinds), method=self.digest, sha256=digest)

    def covers(self, row: Row | None, job: Task) -> bool:
        """Whether a row says that this job is done, with this method, for the picture of now."""
        if row is None or row.failed or row.method != self.digest:
            return False
        if not set(self.kinds) <= set(row.saved.split()) or not job.has_all(row):
            return False
        return row.sha256 == job.digest() != ""


def method_of(kinds: Iterable[str], settings: str, *parts: bytes) -> Method:
    """The method of settings as TOML, our version, and whatever else decides on the results."""
    digest = hashlib.sha256()
    for part in (settings.encode("utf-8", "surrogateescape"), __version__.encode(), *parts):
        digest.update(hashlib.sha256(part).digest())
    return Method(digest.hexdigest()[:16], tuple(kinds))


@dataclass(frozen=True)
class Job:
    """A picture, the folder of its results and how their names end, by kind.

    cue_suffixes: the same for the kinds that write a file a cue, ``{}`` standing for its name.
    beside: files that belong to the picture, whose bytes decide on the results as well.
    """

    picture: Picture
    out: Path
    suffixes: Mapping[str, str]
    cue_suffixes: Sequence[str] = ()
    beside: tuple[Path, ...] = ()

    def digest(self) -> str:
        """SHA-256 of the picture, and of what is beside it; empty where one cannot be read.

        Where the picture is a folder, as a bag may be, it is of all files in it.
        """
        digests = [
            digest_of_folder(path) if path.is_dir() else digest_of(path)
            for path in (self.picture.path, *self.beside)
        ]
        if len(digests) == 1 or not all(digests):
            return digests[0] if all(digests) else ""
        return hashlib.sha256("".join(digests).encode()).hexdigest()

    def output(self, suffix: str) -> Path:
        """The file in ``out`` for results that end in ``suffix``; sub-folders are kept."""
        return self.out / (self.picture.name + suffix)

    @property
    def outputs(self) -> list[Path]:
        """All files whose names are known beforehand."""
        return [self.output(suffix) for suffix in self.suffixes.values()]

    @property
    def is_complete(self) -> bool:
        """Whether all of these files exist; a bag that is a folder has its list once it is done."""
        return all(path.is_file() or (path / BAG_LIST).is_file() for path in self.outputs)

    def has_all(self, row: Row) -> bool:
        """Whether all files exist, those of the cues that its row names among them."""
        cues = filter(None, row.cues.split("/"))
        of_cues = (self.output(each.format(cue)) for cue in cues for each in self.cue_suffixes)
        return self.is_complete and all(path.is_file() for path in of_cues)

    @property
    def file(self) -> str:
        """The name in index.csv: the result's name with the picture's own suffix."""
        return printable(self.picture.name + self.picture.path.suffix)

    @property
    def origin(self) -> str:
        """The picture's path, as it was found."""
        return str(self.picture.path)


Work = Callable[[Any], Row]
"""Makes the results of one task, of the kind that it is for, and tells its row."""

Rows = Generator[Row, None, None]
Engine = Callable[[Sequence[Task], Work], Rows]
"""Does tasks and gives their rows, in any order. Closing the iterator stops it."""


def plan(
    inputs: Sequence[str],
    out: Path,
    suffixes: Mapping[str, str],
    selection: Selection = Selection(),  # noqa: B008 - it is frozen
    cue_suffixes: Sequence[str] = (),
) -> list[Job]:
    """The jobs for all inputs; no file is written yet.

    suffixes: kind of result → what its file name ends with. cue_suffixes: see ``Job``.
    Raises ConfigError when two pictures share a result or a result would replace a
    picture, InputError when nothing is found or ``out`` cannot be a folder.
    """
    found = selection.of_pictures(find_images(inputs, apart=out))
    return settled([Job(picture, out, suffixes, cue_suffixes) for picture in found])


def settled(jobs: list[Job]) -> list[Job]:
    """The jobs, if all can be done; ConfigError as ``plan`` says."""
    _refuse_shared(jobs)
    _refuse_replacing(jobs)
    return jobs


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


def run_jobs(
    jobs: Sequence[Task], out: Path, work: Work, method: Method, options: "Options"
) -> int:
    """Do the jobs that are not done yet; returns the exit code.

    A picture is done when index.csv says so, of this method and of the bytes that the picture
    has now, and its files exist. A picture that fails becomes a failed row, and the others go
    on, unless ``options`` say to stop there. At the first SIGINT or SIGTERM the picture in hand
    is finished, and all that is done is kept: KeyboardInterrupt.
    """
    rows = read_index(out / INDEX)
    remove_leftovers(_folders(jobs, rows, out))
    todo = list(jobs) if options.overwrite else _undone(jobs, rows, method)
    again = 0 if options.overwrite else sum(job.file in rows and job.is_complete for job in todo)
    found: list[Row] = []
    room = ROOM + ROOM_PER_ROW * (len(rows) + len(todo))
    with stop_on_signals() as stop, reserved(out, room) as let_go:
        index = SavedIndex(out / INDEX, rows, options.publish)
        try:
            for row in _rows(todo, work, method, options):
                found.append(row)
                index.add(row)
                if stop.asked or (options.fail_fast and row.failed):
                    break
            else:
                index.update(_removed(jobs, rows))
                remove_leftovers(_folders(jobs, rows, out))  # of workers that died
        finally:
            index.finish(let_go)
    stop.interrupt()
    failed = sum(job.file in rows and rows[job.file].failed for job in jobs)
    if not options.quiet or failed:
        counts = Counts(len(jobs), len(todo), len(found), again, failed)
        click.echo(f"{counts}; results in {options.shown or out}", err=True)
        for line in least_trusted(found):
            click.echo(line)
    return 1 if failed else 0


def _undone(jobs: Sequence[Task], rows: Mapping[str, Row], method: Method) -> list[Task]:
    """The jobs that no row covers, in their order; several are looked at together."""
    with ThreadPoolExecutor(CHECKED_AT_ONCE) as pool:
        covered = pool.map(lambda job: method.covers(rows.get(job.file), job), jobs)
        return [job for job, is_done in zip(jobs, covered, strict=True) if not is_done]


def _rows(todo: Sequence[Task], work: Work, method: Method, options: "Options") -> Iterator[Row]:
    """The rows of the jobs, as the engine gives them; closing this stops it."""
    engine = options.engine or partial(ordered_results, threads=options.jobs)
    rows = engine(todo, partial(attempt, work=work, method=method))
    with closing(rows):
        yield from _show_progress(rows, len(todo), options.quiet)


def _folders(jobs: Iterable[Task], rows: Iterable[str], out: Path) -> set[Path]:
    """The folders in which this run will write, or an earlier one wrote, by its rows' files."""
    own = (job.output("").parent for job in jobs if isinstance(job, Job))
    return {*own, *((out / file).parent for file in rows)}


def _removed(jobs: Iterable[Task], rows: Mapping[str, Row]) -> list[Row]:
    """Failed rows for jobs that are done but whose files somebody has removed meanwhile."""
    what = "results were removed while the run went on (run it again)"
    return [
        Row(job.file, status=f"{FAILED}: {job.origin}: {what}")
        for job in jobs
        if isinstance(job, Job) and not rows[job.file].failed and not job.has_all(rows[job.file])
    ]


def _kept_here(_: Path) -> None:
    """What is done with a file that stays where it was written: nothing."""


@dataclass(frozen=True)
class Options:
    """How a run goes: threads at work, redo what is done, no progress on stderr.

    fail_fast: end at the first picture that fails. engine: does the jobs instead of threads of
    this process. publish: is given index.csv whenever it was saved. shown: what messages call
    the folder of results, where that is not its path.
    """

    jobs: int = 1
    overwrite: bool = False
    quiet: bool = False
    fail_fast: bool = False
    engine: Engine | None = None
    publish: Publish = _kept_here
    shown: str = ""


def attempt(job: Task, work: Work, method: Method) -> Row:
    """The row of one job; whatever goes wrong inside stays inside."""
    try:
        return method.finished(work(job), job)
    except RoadtorchError as problem:
        # Detectors cannot know the file and speak of "image".
        where = job.origin if problem.where == "image" else problem.where
        what = f"{where}: {problem.what} ({problem.remedy})"
    except Exception as problem:
        # One picture that trips a detector must not cost the night's run.
        what = f"{job.origin}: {type(problem).__name__}: {problem} (report it)"
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


@dataclass(frozen=True)
class Counts:
    """Pictures of a run: all, left to do, tried, of these done in another way before; failed."""

    total: int
    todo: int
    tried: int
    again: int
    failed: int

    def __str__(self) -> str:
        """The last line, without the folder."""
        done = f"{max(self.tried - self.failed, 0)} done"
        if self.again:
            done += f" ({self.again} anew)"
        skipped, left = self.total - self.todo, self.todo - self.tried
        parts = [done, f"{skipped} skipped (done before)" if skipped else ""]
        parts.append(f"{self.failed} failed" if self.failed else "")
        parts.append(f"{left} not tried (--fail-fast)" if left else "")
        return f"roadtorch: {', '.join(filter(None, parts))}"


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
