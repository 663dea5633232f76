"""Many pictures, some broken, some already done: what ``infer``, ``grid``, ``label`` share."""

import hashlib
import os
import sys
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter

import click

from roadtorch.errors import ConfigError, InputError, RoadtorchError, fault
from roadtorch.io.atomic import digest_of, digest_of_folder, remove_leftovers, reserved
from roadtorch.io.bounded import printable
from roadtorch.runs.folder import Owners, ResultFolder
from roadtorch.runs.index import DONE, DOUBTFUL, FAILED, INDEX, Row, SavedIndex, read_index
from roadtorch.runs.options import RunOptions
from roadtorch.runtime.progress import Progress
from roadtorch.runtime.signals import stop_on_signals
from roadtorch.runtime.threads import ordered_results
from roadtorch.sinks.remote_folder import RemoteFolder
from roadtorch.sources.pictures import Picture
from roadtorch.version import __version__

BAG_LIST = "metadata.yaml"

LEAST_TRUSTED = 5
"""Pictures that are named at the end of a run, to be looked at first."""

CHECKED_AT_ONCE = 8  # earlier results that are compared with their pictures at the same time

ROOM, ROOM_PER_ROW = 2**16, 2**9  # bytes held for index.csv, should the disk become full

# --- one picture ------------------------------------------------------------------------


@dataclass(frozen=True)
class Job:
    """A picture, the folder of its results and how their names end.

    Each may be behind a URL. ends: ``{}`` in one stands for the names of the cues, with a file for
    each. beside: files that belong to the picture, whose bytes decide on the results as well.
    """

    picture: Picture
    out: Path | RemoteFolder
    ends: Sequence[str]
    beside: tuple[Path, ...] = ()

    @property
    def file(self) -> str:
        """The name in index.csv: the result's name with the picture's own suffix."""
        return printable(self.picture.name + self.picture.suffix)

    @property
    def origin(self) -> str:
        """What messages call the picture: its path or URL, as it was found."""
        return str(self.picture.origin)

    def digest(self) -> str:
        """SHA-256 of the picture, and of what is beside it; empty where one cannot be read.

        Where the picture is a folder, as a bag may be, it is of all files in it.
        """
        if self.picture.is_remote:
            with suppress(RoadtorchError):
                return hashlib.sha256(self.picture.data()).hexdigest()
            return ""
        digests = [
            digest_of_folder(path) if path.is_dir() else digest_of(path)
            for path in (self.picture.path, *self.beside)
        ]
        if len(digests) == 1 or not all(digests):
            return digests[0] if all(digests) else ""
        return hashlib.sha256("".join(digests).encode()).hexdigest()

    def output(self, suffix: str, name: str = "") -> Path:
        """The file of this machine for results that end in ``suffix``; sub-folders are kept.

        name: of a frame, where the picture is footage.
        """
        assert isinstance(self.out, Path), "Elsewhere does the jobs of other folders"
        return self.out / ((name or self.picture.name) + suffix)

    @property
    def is_complete(self) -> bool:
        """Whether all files exist whose names are known beforehand."""
        return all(self._has(end) for end in self.ends if "{}" not in end)

    def has_all(self, row: Row) -> bool:
        """Whether all files exist, those of the cues that its row names among them."""
        cues = filter(None, row.cues.split("/"))
        of_cues = (end.format(cue) for cue in cues for end in self.ends if "{}" in end)
        return self.is_complete and all(map(self._has, of_cues))

    def _has(self, suffix: str) -> bool:
        """Whether a result is there; a bag that is a folder has its list once it is done."""
        if isinstance(self.out, RemoteFolder):
            return self.out.has(self.picture.name + suffix)
        path = self.output(suffix)
        return path.is_file() or (path / BAG_LIST).is_file()


Work = Callable[[Job], Row]
"""Makes the results of one job, and tells its row."""

Rows = Generator[Row, None, None]
Engine = Callable[[Sequence[Job], Work], Rows]
"""Does jobs and gives their rows, in any order. Closing the iterator stops it."""


@dataclass(frozen=True)
class Elsewhere:
    """Work on jobs that are behind URLs, by files of this machine that stand in for theirs."""

    work: Work

    def __call__(self, job: Job) -> Row:
        """Make the results of one job; errors name its URL."""
        with TemporaryDirectory(prefix="roadtorch-") as scratch:
            here = job
            if job.picture.is_remote:
                copy = Path(scratch, f"picture{job.picture.suffix}")
                copy.write_bytes(job.picture.data())
                here = replace(job, picture=Picture(copy, job.picture.name))
            if isinstance(job.out, RemoteFolder):
                here = replace(here, out=Path(scratch, "out"))
            try:
                row = replace(self.work(here), file=job.file, sha256=here.digest())
            except InputError as problem:
                where = job.origin if problem.where == here.origin else problem.where
                raise InputError(where, problem.what, problem.remedy) from None
            if isinstance(job.out, RemoteFolder):
                for file in sorted(Path(scratch, "out").rglob("*")):
                    if file.is_file():
                        name = file.relative_to(Path(scratch, "out")).as_posix()
                        job.out.write(name, file.read_bytes())
        return row


@dataclass(frozen=True)
class Method:
    """What results are made with: two runs of one method give the same bytes.

    digest: of everything that the results depend on but the picture, see ``method_of``.
    kinds: what is written.
    """

    digest: str
    kinds: tuple[str, ...]

    def finished(self, row: Row, job: Job) -> Row:
        """The row of a job with what it was made with and of; failed rows stay as they are."""
        if row.failed:
            return row
        digest = row.sha256 or job.digest()
        return replace(row, saved=" ".join(self.kinds), method=self.digest, sha256=digest)

    def covers(self, row: Row | None, job: Job) -> bool:
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


# --- all of them ------------------------------------------------------------------------


def plan(
    pictures: Sequence[Picture],
    out: Path | RemoteFolder,
    ends: Sequence[str],
    owners: Owners | None = None,
) -> list[Job]:
    """The jobs for pictures; no file is written yet.

    ends: of the names of results, see ``Job``. owners: of the names that the run has given
    already. Raises ConfigError when two pictures share a result, or one would replace a picture.
    """
    jobs = [Job(picture, out, ends) for picture in pictures]
    owners = owners or Owners(out)
    for job in jobs:
        owners.take(job.picture.name, [end for end in ends if "{}" not in end], job.origin)
    return spared(jobs)


def spared(jobs: list[Job]) -> list[Job]:
    """The jobs; ConfigError where the result of one would replace the picture of another."""
    # Path.resolve raises for a link to itself.
    inputs = {os.path.realpath(job.picture.path) for job in jobs if not job.picture.is_remote}
    for job in jobs:
        for end in job.ends if isinstance(job.out, Path) else ():
            if os.path.realpath(job.output(end)) in inputs:
                what = "is one of the pictures"
                raise ConfigError(job.output(end), what, "give another --out")
    return jobs


def run_pictures(
    jobs: Sequence[Job],
    work: Work,
    method: Method,
    folder: ResultFolder,
    options: RunOptions,
    engine: Engine | None = None,
) -> int:
    """Do the jobs that are not done yet, by threads of this process or ``engine``; the exit code.

    A picture is done when index.csv says so, of this method and of the bytes that the picture
    has now, and its files exist. A picture that fails becomes a failed row, and the others go
    on, unless ``options`` say to stop there. At the first SIGINT or SIGTERM the picture in hand
    is finished, and all that is done is kept: KeyboardInterrupt.
    """
    if not jobs:
        return 0
    if any(job.picture.is_remote or isinstance(job.out, RemoteFolder) for job in jobs):
        work = Elsewhere(work)
    rows = read_index(folder.path / INDEX)
    local = [job for job in jobs if isinstance(job.out, Path)]
    written = {job.output("").parent for job in local}
    remove_leftovers(written | {(folder.path / file).parent for file in rows})
    todo = list(jobs)
    if not options.overwrite:
        with ThreadPoolExecutor(CHECKED_AT_ONCE) as pool:
            covered = pool.map(lambda job: method.covers(rows.get(job.file), job), jobs)
            todo = [job for job, is_done in zip(jobs, covered, strict=True) if not is_done]
    again = 0 if options.overwrite else sum(job.file in rows and job.is_complete for job in todo)
    tried: list[Row] = []
    room = ROOM + ROOM_PER_ROW * (len(rows) + len(todo))
    with stop_on_signals() as stop, reserved(folder.path, room) as let_go:
        index = SavedIndex(folder.path / INDEX, rows, folder.publish)
        try:
            engine = engine or partial(ordered_results, threads=options.jobs)
            made = engine(todo, partial(attempt, work=work, method=method))
            for row in _shown(made, len(todo), options.quiet):
                tried.append(row)
                index.add(row)
                if stop.asked or (options.fail_fast and row.failed):
                    break
            else:
                for job in local:
                    if not rows[job.file].failed and not job.has_all(rows[job.file]):
                        what = "results were removed while the run went on (run it again)"
                        rows[job.file] = Row(job.file, status=f"{FAILED}: {job.origin}: {what}")
                        click.echo(f"roadtorch: {rows[job.file].status}", err=True)
                remove_leftovers(written)  # of workers that died
        finally:
            index.finish(let_go)
    stop.interrupt()
    failed = sum(job.file in rows and rows[job.file].failed for job in jobs)
    if not options.quiet or failed:
        done = f"{max(len(tried) - failed, 0)} done" + (f" ({again} anew)" if again else "")
        others = {"skipped (done before)": len(jobs) - len(todo), FAILED: failed}
        others["not tried (--fail-fast)"] = len(todo) - len(tried)
        tell(done, others, folder.shown)
        for line in least_trusted(tried):
            click.echo(line)
    return 1 if failed else 0


def tell(done: str, others: Mapping[str, int], where: object) -> None:
    """One line on stderr: what was done, and what became of others, where there are some."""
    parts = [done, *(f"{count} {what}" for what, count in others.items() if count)]
    click.echo(f"roadtorch: {', '.join(parts)}; results in {where}", err=True)


def _shown(rows: Rows, total: int, quiet: bool) -> Iterator[Row]:
    """The same rows with what ``Progress`` shows, and each failure on a line.

    Closing this closes them.
    """
    with closing(rows), Progress(rows, total=total, unit="image", quiet=quiet) as bar:
        for row in bar:
            if row.failed:
                bar.write(f"roadtorch: {row.status}", file=sys.stderr)
            yield row


def attempt(job: Job, work: Work, method: Method) -> Row:
    """The row of one job; whatever goes wrong inside stays inside."""
    start = perf_counter()
    try:
        row = work(job)
        row = replace(row, ms=f"{1000 * (perf_counter() - start):.0f}")
        return method.finished(row, job)
    except Exception as problem:  # one that trips a detector must not cost the night's run
        told = " ".join(str(fault(job.picture.origin, problem)).split())
        return Row(job.file, status=f"{FAILED}: {told}")


def trust_of(row: Row) -> float:
    """The trust of a row; infinite where it has none."""
    return float(row.trust or "inf")


def least_trusted(rows: Iterable[Row]) -> list[str]:
    """Lines that name the pictures whose masks should be looked at first, the worst on top.

    None where no row has a trust.
    """
    judged = sorted((row for row in rows if row.trust), key=trust_of)
    if not judged:
        return []
    doubtful = sum(row.status.startswith(DOUBTFUL) for row in judged)
    shown = [
        f"  {row.trust}  {row.file}{row.status.removeprefix(DONE).removeprefix(DOUBTFUL)}"
        for row in judged[:LEAST_TRUSTED]
    ]
    return [f"roadtorch: {doubtful} doubtful of {len(judged)}; least trusted:", *shown]
