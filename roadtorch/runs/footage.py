"""What ``infer`` does with footage: videos, cameras, streams and whatever else gives frames."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, closing, contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Protocol

import click
from torch import Tensor

from roadtorch.detector import Detector
from roadtorch.errors import RoadtorchError
from roadtorch.io.atomic import make_folder, remove_leftovers
from roadtorch.road.steady import Steady, SteadySettings
from roadtorch.runs import batch
from roadtorch.runs.batch import Job, Method, Options
from roadtorch.runs.claim import ELSEWHERE
from roadtorch.runs.footage_results import missed_row
from roadtorch.runs.frame_index import FrameIndex, appended
from roadtorch.runs.index import DONE, DOUBTFUL, FAILED, INDEX, Row, read_index
from roadtorch.runtime.signals import stop_on_signals
from roadtorch.sources.frame import Source
from roadtorch.sources.pictures import Picture
from roadtorch.stream import AHEAD, Behind, Missed, Seen, Steadying, seen_frames


class WhatIsWritten(Protocol):
    """What a command writes of sources; for ``infer`` it is ``FootageResults``."""

    def kinds(self, source: Source) -> tuple[str, ...]:
        """What index.csv says was saved."""
        ...

    def suffixes(self, source: Source) -> dict[str, str]:
        """How the names of the files of the whole source end, by kind."""
        ...

    def open(self, source: Source, job: Job) -> AbstractContextManager[Callable[[Seen], Row]]:
        """What writes the results of a frame and gives its row."""
        ...


@dataclass(frozen=True)
class FootageWork:
    """The work on sources.

    check: raises InputError for an image of another camera. steady: makes, for each source that
    moves, what steadies its likelihood; None leaves the frames as they are.
    """

    detector: Detector
    results: WhatIsWritten
    check: Callable[[Tensor], None] | None = None
    steady: Callable[[], Steadying] | None = None


def steadied() -> Steadying:
    """What steadies one source, at its defaults."""
    return Steady(SteadySettings())


def plan_sources(
    sources: Sequence[Source], out: Path, results: WhatIsWritten
) -> list[tuple[Source, Job]]:
    """The sources, each with its job; ConfigError when a result would replace a source."""
    jobs = [
        Job(Picture(source.path or Path(source.origin), source.name), out, results.suffixes(source))
        for source in sources
    ]
    return list(zip(sources, batch.settled(jobs), strict=True))


def run_sources(
    planned: Sequence[tuple[Source, Job]], work: FootageWork, method: Method, options: Options
) -> int:
    """Work through the sources that are not done yet; returns the exit code.

    A source is done when index.csv says so, of this method and of the bytes that its file has now,
    and its videos are there; live ones never are. One that fails, or ends early, becomes a failed
    row behind those of its frames, and the others go on. When interrupted, what was finished is
    kept, the videos with what they have.
    """
    skipped, failed = 0, 0
    for source, job in planned:
        own = replace(method, kinds=work.results.kinds(source))
        row = read_index(job.out / INDEX).get(job.file)
        if not options.overwrite and own.covers(row, job):
            skipped += 1
        else:
            failed += _run_source(source, job, work, own, options).failed
    if not options.quiet or failed:
        parts = [f"{len(planned) - skipped - failed} done"]
        parts += [f"{skipped} skipped (done before)"] if skipped else []
        parts += [f"{failed} failed"] if failed else []
        out = planned[0][1].out
        click.echo(f"roadtorch: {', '.join(parts)}; results in {out}", err=True)
    return 1 if failed else 0


@dataclass
class FrameCount:
    """What was counted over the frames of one source; the rows go to the index."""

    index: FrameIndex
    method: Method
    done: int = 0
    failed: int = 0
    doubtful: int = 0
    ms: float = 0.0
    last: Row = field(default_factory=lambda: Row(""))

    def add(self, row: Row) -> None:
        """Count the row of a frame, and keep it."""
        self.failed += row.failed
        if not row.failed:
            row = replace(row, saved=" ".join(self.method.kinds), method=self.method.digest)
            self.last = row
            self.done += 1
            self.doubtful += row.status.startswith(DOUBTFUL)
            self.ms += float(row.ms)
        self.index.add(row)

    def told(self) -> str:
        """In words."""
        parts = [f"{self.done} frames"]
        parts += [f"{self.doubtful} doubtful"] if self.doubtful else []
        parts += [f"{self.failed} failed"] if self.failed else []
        return ", ".join(parts)


def _run_source(
    source: Source, job: Job, work: FootageWork, method: Method, options: Options
) -> Row:
    """The row of a source whose frames were looked at as far as possible; the index has it."""
    for folder in (job.output("").parent, job.output("")):
        remove_leftovers([folder])
    make_folder(job.output("").parent, ELSEWHERE)
    problem: BaseException | None = None
    with appended(job.out / INDEX, job) as index:
        tally = FrameCount(index, method)
        try:
            with work.results.open(source, job) as write:
                _work_through(source, work, write, tally, options)
        except (RoadtorchError, KeyboardInterrupt) as found:
            problem = found
        row = method.finished(_row(source, job, tally, problem), job)
        index.add(row)
    if not options.quiet:
        click.echo(f"roadtorch: {job.file}: {tally.told()}", err=True)
    if isinstance(problem, KeyboardInterrupt):
        raise problem
    if row.failed:
        click.echo(f"roadtorch: {row.status}", err=True)
    return row


def _row(source: Source, job: Job, tally: FrameCount, problem: BaseException | None) -> Row:
    """The row of a source; to be interrupted is the usual end of a live one."""
    status = DONE
    if isinstance(problem, RoadtorchError):
        status = f"{FAILED}: {' '.join(str(problem).split())}"
    elif problem is not None and not source.live:
        status = f"{FAILED}: {source.origin}: was interrupted (run it again)"
    elif tally.failed:
        status = f"{FAILED}: {source.origin}: {tally.failed} frames failed (see their rows)"
    last = tally.last
    row = Row(job.file, last.width, last.height, f"{tally.ms:.0f}", status=status)
    return replace(row, seconds=last.seconds)


def _work_through(
    source: Source,
    work: FootageWork,
    write: Callable[[Seen], Row],
    tally: FrameCount,
    options: Options,
) -> None:
    """Look at all frames, and write what is found in a thread of its own, a few frames behind."""
    from tqdm import tqdm

    steady = work.steady() if work.steady and source.moving else None
    seen = seen_frames(source, work.detector, jobs=options.jobs, steady=steady, check=work.check)
    hidden = True if options.quiet else None  # None: hidden unless stderr is a terminal
    with (
        closing(seen),
        _written(Behind(AHEAD)) as behind,
        tqdm(total=source.count, unit="frame", disable=hidden) as bar,
    ):
        for one in seen:
            behind.do(partial(_settle, one, write, tally))
            bar.update()


@contextmanager
def _written(behind: Behind) -> Iterator[Behind]:
    """However the block ends, what was handed over is written, also when asked to stop twice."""
    try:
        yield behind
    finally:
        with stop_on_signals():
            behind.finish()


def _settle(one: Seen | Missed, write: Callable[[Seen], Row], tally: FrameCount) -> None:
    """Write what was seen of a frame, or tell why nothing was."""
    row = write(one) if isinstance(one, Seen) else missed_row(one)
    if row.failed:
        click.echo(f"roadtorch: {row.status}", err=True)
    tally.add(row)
