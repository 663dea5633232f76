"""What ``infer`` and ``label`` share: many pictures, some broken, some already done."""

import csv
import hashlib
import io
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from time import monotonic

import click

from roadtorch.errors import ConfigError, InputError, RoadtorchError
from roadtorch.files import csv_text, digest_of, remove_leftovers, reserved, write_text
from roadtorch.outside import printable
from roadtorch.signals import stop_on_signals
from roadtorch.sources.frame import Selection
from roadtorch.sources.pictures import Picture, find_images
from roadtorch.stream import ordered_results

INDEX = "index.csv"
DONE, DOUBTFUL, FAILED = "done", "doubtful", "failed"
"""What the status of a row begins with; after a colon it says why."""

LEAST_TRUSTED = 5
"""Pictures that are named at the end of a run, to be looked at first."""

SAVE_EVERY = 5.0  # seconds of work that a power cut may cost, at most
SAVING = 0.05  # the share of the time that saving may take: a long index is saved less often
ROOM, ROOM_PER_ROW = 2**16, 2**9  # bytes held for index.csv, should the disk become full


@dataclass(frozen=True)
class Row:
    """One line of index.csv. ``ms`` is the time from reading to the last file written.

    trust: the expected F of the mask, empty where the detector does not say.
    saved: the kinds of results that were written; method: what they were made with, see
    ``Method``; sha256: of the bytes of the picture. seconds: of a frame, since its source began.
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

    @property
    def failed(self) -> bool:
        """Whether there is no result."""
        return self.status.startswith(FAILED)


@dataclass(frozen=True)
class Method:
    """What results are made with: two runs of one method give the same bytes.

    digest: of everything that the results depend on but the picture, see ``method_of``.
    kinds: what is written.
    """

    digest: str
    kinds: tuple[str, ...]

    def finished(self, row: Row, job: "Job") -> Row:
        """The row of a job with what it was made with and of; failed rows stay as they are."""
        if row.failed:
            return row
        digest = digest_of(job.picture.path)
        return replace(row, saved=" ".join(self.kinds), method=self.digest, sha256=digest)

    def covers(self, row: Row | None, job: "Job") -> bool:
        """Whether a row says that this job is done, with this method, for the picture of now."""
        if row is None or row.failed or row.method != self.digest:
            return False
        if not set(self.kinds) <= set(row.saved.split()) or not job.is_complete:
            return False
        return row.sha256 == digest_of(job.picture.path) != ""


def method_of(kinds: Iterable[str], settings: str, *parts: bytes) -> Method:
    """The method of settings as TOML and of whatever else decides on the results."""
    digest = hashlib.sha256()
    for part in (settings.encode("utf-8", "surrogateescape"), *parts):
        digest.update(hashlib.sha256(part).digest())
    return Method(digest.hexdigest()[:16], tuple(kinds))


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
    def is_complete(self) -> bool:
        """Whether all of these files exist."""
        return all(path.is_file() for path in self.outputs)

    @property
    def file(self) -> str:
        """The name in index.csv: the result's name with the picture's own suffix."""
        return printable(self.picture.name + self.picture.path.suffix)


Work = Callable[[Job], Row]


def plan(
    inputs: Sequence[str],
    out: Path,
    suffixes: Mapping[str, str],
    selection: Selection = Selection(),  # noqa: B008 - it is frozen
) -> list[Job]:
    """The jobs for all inputs; no file is written yet.

    suffixes: kind of result → what its file name ends with.
    Raises ConfigError when two pictures share a result or a result would replace a
    picture, InputError when nothing is found or ``out`` cannot be a folder.
    """
    found = selection.of_pictures(find_images(inputs, apart=out))
    return settled([Job(picture, out, suffixes) for picture in found])


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


def run_jobs(jobs: Sequence[Job], out: Path, work: Work, method: Method, options: "Options") -> int:
    """Do the jobs that are not done yet; returns the exit code.

    A picture is done when index.csv says so, of this method and of the bytes that the picture
    has now, and its files exist. A picture that fails becomes a failed row, and the others go
    on. At the first SIGINT or SIGTERM the picture in hand is finished, and all that is done is
    kept: KeyboardInterrupt.
    """
    rows = read_index(out / INDEX)
    remove_leftovers(_folders(jobs, rows, out))
    todo = [job for job in jobs if options.overwrite or not method.covers(rows.get(job.file), job)]
    again = 0 if options.overwrite else sum(job.file in rows and job.is_complete for job in todo)
    found: list[Row] = []
    room = ROOM + ROOM_PER_ROW * (len(rows) + len(todo))
    with stop_on_signals() as stop, reserved(out, room) as let_go:
        index = SavedIndex(out / INDEX, rows)
        try:
            results = ordered_results(
                todo, partial(_attempt, work=work, method=method), options.jobs
            )
            for row in _show_progress(results, len(todo), options.quiet):
                found.append(row)
                index.add(row)
                if stop.asked:
                    break
            else:
                index.update(_removed(jobs, rows))
        finally:
            index.finish(let_go)
    stop.interrupt()
    failed = [rows[job.file].failed for job in jobs]
    if not options.quiet or any(failed):
        click.echo(_summary(len(found), len(jobs), again, sum(failed), out), err=True)
        for line in least_trusted(found):
            click.echo(line)
    return 1 if any(failed) else 0


def _folders(jobs: Iterable[Job], rows: Iterable[str], out: Path) -> set[Path]:
    """The folders in which this run will write, or an earlier one wrote, by its rows' files."""
    return {*(job.output("").parent for job in jobs), *((out / file).parent for file in rows)}


def _removed(jobs: Iterable[Job], rows: Mapping[str, Row]) -> list[Row]:
    """Failed rows for jobs that are done but whose files somebody has removed meanwhile."""
    what = "results were removed while the run went on (run it again)"
    return [
        Row(job.file, status=f"{FAILED}: {job.picture.path}: {what}")
        for job in jobs
        if not rows[job.file].failed and not job.is_complete
    ]


def _with_earlier(earlier: Row | None, row: Row) -> Row:
    """A row, with the kinds of results that the same method gave of the same bytes before."""
    if earlier is None or (earlier.method, earlier.sha256) != (row.method, row.sha256):
        return row
    kinds = dict.fromkeys([*earlier.saved.split(), *row.saved.split()])
    return replace(row, saved=" ".join(kinds))


class SavedIndex:
    """index.csv as a run goes on: saved after every row, or as often as is worth it."""

    def __init__(self, path: Path, rows: dict[str, Row]) -> None:
        self.path, self.rows = path, rows
        self._due = 0.0

    def add(self, row: Row) -> None:
        """Keep one more row; on a full disk the index stays as it was until the end."""
        self.rows[row.file] = _with_earlier(self.rows.get(row.file), row)
        start = monotonic()
        if start < self._due:
            return
        with suppress(InputError):
            write_index(self.path, self.rows.values())
        took = monotonic() - start
        self._due = start + took + min(took / SAVING, SAVE_EVERY)

    def update(self, rows: Iterable[Row]) -> None:
        """Replace rows, and tell each that failed."""
        for row in rows:
            self.rows[row.file] = row
            click.echo(f"roadtorch: {row.status}", err=True)

    def finish(self, let_go: Callable[[], None]) -> None:
        """Write all rows, in the room that was held for them if the disk is full.

        Raises InputError when even that is not possible.
        """
        try:
            write_index(self.path, self.rows.values())
        except InputError:
            let_go()
            write_index(self.path, self.rows.values())


@dataclass(frozen=True)
class Options:
    """How a run goes: threads at work, redo what is done, no progress on stderr."""

    jobs: int = 1
    overwrite: bool = False
    quiet: bool = False


def _attempt(job: Job, work: Work, method: Method) -> Row:
    """The row of one job; whatever goes wrong inside stays inside."""
    try:
        return method.finished(work(job), job)
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


def _summary(tried: int, total: int, again: int, failed: int, out: Path) -> str:
    """The last line: ``again`` of those tried had been done before, in another way."""
    done = f"{max(tried - failed, 0)} done"
    if again:
        done += f" ({again} anew)"
    parts = [done, f"{total - tried} skipped (done before)" if total > tried else ""]
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
            text = file.read()
        whole = io.StringIO(text[: text.rfind("\n") + 1], newline="")  # a killed run may cut a row
        rows = [Row(**line) for line in csv.DictReader(whole)]
        if any(None in vars(row).values() for row in rows):
            raise TypeError("a row is cut short")
        return {row.file: row for row in rows}
    except (OSError, UnicodeDecodeError, TypeError, KeyError, csv.Error):
        raise InputError(path, "is not an index of ours", "give another --out") from None


def write_index(path: Path, rows: Iterable[Row]) -> None:
    """Write rows, sorted by file, as index.csv."""
    columns = list(Row.__dataclass_fields__)
    write_text(path, csv_text(columns, map(asdict, sorted(rows, key=lambda row: row.file))))
