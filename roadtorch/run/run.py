"""A run of a command into one folder: what is left to do is done, and remembered."""

import sys
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, closing, contextmanager, nullcontext
from dataclasses import dataclass, field, replace
from heapq import nsmallest
from pathlib import Path
from time import perf_counter
from typing import Any

import click

from roadtorch.base.atomic import make_folder, remove_leftovers
from roadtorch.base.errors import RoadtorchError
from roadtorch.base.progress import Progress
from roadtorch.base.signals import Stop, stop_on_signals
from roadtorch.inputs.item import Item, Source
from roadtorch.road.steady import Steady, SteadySettings
from roadtorch.run.folder import ELSEWHERE, result_folder
from roadtorch.run.ledger import (
    DONE,
    DOUBTFUL,
    FAILED,
    INDEX,
    PARTIAL,
    Ledger,
    Method,
    Row,
    open_ledger,
)
from roadtorch.run.loop import (
    Inference,
    Task,
    crashed_row,
    detections,
    elapsed,
    until_stopped,
    write_row,
)
from roadtorch.run.plan import Output, Plan, RunOptions, Writers
from roadtorch.run.workers import Workers

LEAST_TRUSTED = 5
"""Images that are named at the end of a run, to be looked at first."""


@dataclass(frozen=True)
class Run:
    """A run into one folder: what it remembers, who works, how it goes."""

    folder: Path
    ledger: Ledger
    workers: Workers
    options: RunOptions

    def all(self, plan: Plan, task: Task, of_footage: Method, steady: bool = True) -> int:
        """Work through what is planned; the exit code.

        task: on images; look at frames is its own. of_footage: what sources are made with.
        """
        failed = self.images(plan.images, task)
        return max(failed, self.footage(plan, replace(task, method=of_footage), steady))

    def images(self, items: Sequence[Item], task: Task) -> int:
        """Work through the images that are not done yet; the exit code.

        An image is done when index.csv says so, of this method and of the bytes that it has now,
        and its files exist. One that fails becomes a failed row, and the others go on. At the first
        SIGINT or SIGTERM what is in hand is finished, and all that is done is kept:
        KeyboardInterrupt.
        """
        if not items:
            return 0
        rows, suffixes, redo = self.ledger.rows, task.writer.suffixes, self.options.overwrite
        self._remove_leftovers(items)
        todo = [
            item for item in items if redo or not self.ledger.is_done(item, task.method, suffixes)
        ]
        known = [] if redo else [item for item in todo if item.row_name in rows]
        again = sum(self.ledger.is_complete(item, suffixes) for item in known)
        with stop_on_signals() as stop:
            made = self.workers.map(task, until_stopped(todo, stop), crashed_row)
            tried = list(self._recorded(made, "image", total=len(todo)))
            self._remove_leftovers(items)  # of workers that died
        stop.interrupt()
        failed = sum(rows[item.row_name].failed for item in todo)
        if not self.options.quiet or failed:
            done_now = f"{len(todo) - failed} done" + (f" ({again} anew)" if again else "")
            others = {"skipped (done before)": len(items) - len(todo), FAILED: failed}
            self._summarise(done_now, others)
            for line in least_trusted(tried):
                click.echo(line)
        return 1 if failed else 0

    def footage(self, plan: Plan, task: Task, steady: bool) -> int:
        """Work through the sources that are not done yet; the exit code.

        steady: whether frames are steadied. A source is done when index.csv
        says so, of this method and of the bytes that its file has now, and its files are there;
        live ones never are. One that fails becomes a failed row, a partial one where some frames
        were done, and the others go on. When interrupted, what was finished is kept, the videos
        with what they have.
        """
        if not plan.sources:
            return 0
        skipped, ended = 0, Counter[str]()
        for source, output in plan.sources:
            own = replace(task, method=replace(task.method, kinds=output.kinds))
            redo = self.options.overwrite
            if not redo and self.ledger.is_done(source, own.method, output.suffixes):
                skipped += 1
                continue
            row = self._source(source, output, own, steady)
            ended[row.status.partition(":")[0]] += 1
        failed = ended[PARTIAL] + ended[FAILED]
        if not self.options.quiet or failed:
            others = {"skipped (done before)": skipped}
            self._summarise(
                f"{ended[DONE]} done", others | {x: ended[x] for x in (PARTIAL, FAILED)}
            )
        return 1 if failed else 0

    def _remove_leftovers(self, items: Iterable[Item]) -> None:
        names = [*(item.name for item in items), *self.ledger.rows]
        remove_leftovers({(self.folder / name).parent for name in names})

    # --- one source ---------------------------------------------------------------------

    def _source(self, source: Source, output: Output, task: Task, steady: bool) -> Row:
        """Work through the frames of a source as far as possible; its row, which is remembered."""
        count, place = _Count(), self.folder / source.name
        remove_leftovers([place.parent, place])
        make_folder(place.parent, ELSEWHERE)
        self.ledger.forget_frames(source.name)
        error: BaseException | None = None
        try:
            with stop_on_signals() as stop, output.open() as writers:
                rows = self._frames(source, task, writers, output.cues, steady, stop)
                for row in self._recorded(rows, "frame", total=source.count):
                    count.add(row)
            stop.interrupt()
        except (RoadtorchError, KeyboardInterrupt) as raised:
            error = raised
        row = task.method.made(_row_of_source(source, count, error))
        row = row if row.failed else replace(row, sha256=source.digest())
        self.ledger.add(row)
        if not self.options.quiet:
            click.echo(f"roadtorch: {row.file}: {count}", err=True)
            for line in least_trusted(count.least)[1:] if count.doubtful else []:
                click.echo(line, err=True)
        if isinstance(error, KeyboardInterrupt):
            raise error
        if row.failed:
            click.echo(f"roadtorch: {row.status}", err=True)
        return row

    def _frames(
        self, source: Source, task: Task, writers: Writers, cues: bool, steady: bool, stop: Stop
    ) -> Iterator[Row]:
        """Yield the rows of frames, which smooth one another and go into the same files."""
        filtering, infer = Steady(SteadySettings()) if steady else None, task.infer
        assert isinstance(infer, Inference)
        with closing(detections(source, infer, self.workers, filtering, cues, stop)) as frames:
            for frame in frames:
                files, method = writers.files, task.method
                row = write_row(frame.item, frame.detection, files, method, frame.ms)
                start = perf_counter()
                if not isinstance(frame.outcome, RoadtorchError):
                    for writer in writers.streams:
                        writer.write(frame.item, frame.outcome)
                yield row if row.failed else replace(row, ms=elapsed(start, float(row.ms)))

    # --- what is told -------------------------------------------------------------------

    def _recorded(self, rows: Any, unit: str, total: int | None) -> Iterator[Row]:
        """The same rows with what ``Progress`` shows, each failure on a line, all remembered.

        Closing this closes them.
        """
        quiet = self.options.quiet
        with closing(rows), Progress(rows, total=total, unit=unit, quiet=quiet) as bar:
            for row in bar:
                if row.failed:
                    bar.write(f"roadtorch: {row.status}", file=sys.stderr)
                self.ledger.add(row)
                yield row

    def _summarise(self, done: str, others: Mapping[str, int]) -> None:
        """One line on stderr: what was done, and what became of others, where there are some."""
        parts = [done, *(f"{count} {problem}" for problem, count in others.items() if count)]
        click.echo(f"roadtorch: {', '.join(parts)}; results in {self.folder}", err=True)


@contextmanager
def open_run(
    out: Path,
    effective: str,
    count: int | None,
    options: RunOptions,
    record: AbstractContextManager[None] | None = None,
) -> Iterator[Run]:
    """Open a run over so many items into a folder; see ``result_folder`` and ``open_ledger``.

    effective: the settings, for config.toml. record: what stands around the run, such as
    ``roadtorch.run.record.recorded``.
    """
    with (
        options.workers(count) as workers,
        result_folder(out, effective, options.overwrite),
        record or nullcontext(),
        open_ledger(out / INDEX) as ledger,
    ):
        yield Run(out, ledger, workers, options)


def _trust(row: Row) -> float:
    return float(row.trust or "inf")


def least_trusted(rows: Iterable[Row]) -> list[str]:
    """Lines that name the images whose masks should be looked at first, the worst on top.

    None where no row has a trust.
    """
    judged = sorted((row for row in rows if row.trust), key=_trust)
    if not judged:
        return []
    doubtful = sum(row.doubtful for row in judged)
    shown = [
        f"  {row.trust}  {row.file}{row.status.removeprefix(DONE).removeprefix(DOUBTFUL)}"
        for row in judged[:LEAST_TRUSTED]
    ]
    return [f"roadtorch: {doubtful} doubtful of {len(judged)}; least trusted:", *shown]


# --- one source ---------------------------------------------------------------------------


@dataclass
class _Count:
    """What was counted over the frames of one source.

    ms: of the done ones; last: of them; least: those of the least trust.
    """

    done: int = 0
    failed: int = 0
    doubtful: int = 0
    ms: float = 0.0
    last: Row = Row("")  # noqa: RUF009 - it is frozen
    least: list[Row] = field(default_factory=list)

    def add(self, row: Row) -> None:
        """Count the row of a frame."""
        self.failed += row.failed
        if not row.failed:
            self.last = row
            self.done += 1
            self.doubtful += row.doubtful
            self.ms += float(row.ms)
            self.least = nsmallest(LEAST_TRUSTED, [*self.least, row], key=_trust)

    def __str__(self) -> str:
        """In words."""
        parts = [f"{self.done} frames"]
        parts += [f"{self.doubtful} doubtful"] if self.doubtful else []
        parts += [f"{self.failed} failed"] if self.failed else []
        return ", ".join(parts)


def _row_of_source(source: Source, count: _Count, error: BaseException | None) -> Row:
    """Return the row of a source; to be interrupted is the usual end of a live one."""
    why = ""
    if isinstance(error, RoadtorchError):
        why = " ".join(str(error).split())
    elif error is not None and not source.live:
        why = f"{source.origin}: was interrupted (run it again)"
    elif count.failed:
        of = f"{count.done} of {count.done + count.failed} frames"
        why = f"{source.origin}: {of} (see the rows of the others)"
    status = f"{PARTIAL if count.done else FAILED}: {why}" if why else DONE
    last = count.last
    row = Row(source.row_name, last.width, last.height, f"{count.ms:.0f}", status=status)
    return replace(row, seconds=last.seconds)
