"""A run of a command into one output folder; finished results are skipped, new ones recorded."""

import sys
from collections import Counter
from collections.abc import Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, closing, contextmanager, nullcontext
from dataclasses import dataclass, field, replace
from functools import cache, partial
from heapq import nsmallest
from pathlib import Path
from time import perf_counter
from typing import Any

import click

from roadtorch.base.atomic import make_folder, relative_name, remove_leftovers
from roadtorch.base.bounded import plural
from roadtorch.base.errors import InputError, RoadtorchError, to_input_error
from roadtorch.base.progress import Progress
from roadtorch.base.signals import StopRequest, stop_on_signals, until_stopped
from roadtorch.detectors.stream import FrameResult, detect_frames
from roadtorch.inputs.item import Item, Source
from roadtorch.road.temporal_filter import TemporalFilter, TemporalFilterSettings
from roadtorch.run.folder import OUT_HINT, open_result_folder
from roadtorch.run.ledger import (
    DONE,
    DOUBTFUL,
    FAILED,
    INDEX_FILE,
    PARTIAL,
    IndexRow,
    Ledger,
    Method,
    open_ledger,
    read_index,
)
from roadtorch.run.loop import (
    Inference,
    Task,
    crashed_evidence,
    crashed_row,
    elapsed_ms,
    run_behind,
    write_row,
)
from roadtorch.run.plan import Output, Plan, RunOptions, Writers
from roadtorch.run.workers import Workers

LEAST_TRUSTED = 5  # number of least trusted images that are listed at the end of a run


@dataclass(frozen=True)
class Run:
    """A run into one output folder, with its index, workers and options."""

    folder: Path
    ledger: Ledger
    workers: Workers
    options: RunOptions

    def process(self, plan: Plan, task: Task, footage_method: Method, smoothing: bool) -> int:
        """Process images by a task, sources with a footage method; return the exit code."""
        failed = self.process_images(plan.images, task)
        footage_task = replace(task, method=footage_method)
        return max(failed, self.process_sources(plan, footage_task, smoothing))

    def process_images(self, items: Sequence[Item], task: Task) -> int:
        """Process the images that are not done yet, and return the exit code.

        An image is done when index.csv lists it with this method and its current bytes, and its
        files exist. A failing image becomes a failed row. The first SIGINT or SIGTERM lets started
        images finish, then raises KeyboardInterrupt.
        """
        if not items:
            return 0
        ledger, suffixes, redo = self.ledger, task.writer.suffixes, self.options.overwrite
        self._remove_leftovers(items)
        todo = [item for item in items if redo or not ledger.is_done(item, task.method, suffixes)]
        outdated = [] if redo else [item for item in todo if item.row_name in ledger.rows]
        again = sum(ledger.has_files(item, suffixes) for item in outdated)
        with stop_on_signals() as stop:
            results = self.workers.map(task, until_stopped(todo, stop), crashed_row)
            with closing(results), self._progress(results, "image", len(todo)) as bar:
                tried = [self._record(row, bar) for row in bar]
            self._remove_leftovers(items)  # of workers that died
        stop.raise_if_requested()
        failed = sum(ledger.rows[item.row_name].failed for item in todo)
        if not self.options.quiet or failed:
            done = f"{len(todo) - failed} done" + (f" ({again} redone)" if again else "")
            counts = {"skipped (done before)": len(items) - len(todo), FAILED: failed}
            self._print_summary(done, counts)
            for line in least_trusted_lines(tried):
                click.echo(line)
        return 1 if failed else 0

    def process_sources(self, plan: Plan, task: Task, smoothing: bool) -> int:
        """Process the sources that are not done yet, and return the exit code.

        A source is done as an image is; live ones never are. A failing source becomes a failed
        row, or a partial one where some frames were done. When interrupted, finished frames are
        kept, and videos are closed after the last of them.
        """
        if not plan.sources:
            return 0
        skipped, ended = 0, Counter[str]()
        for source, output in plan.sources:
            source_task = replace(task, method=replace(task.method, kinds=output.kinds))
            redo = self.options.overwrite
            if not redo and self.ledger.is_done(source, source_task.method, output.suffixes):
                skipped += 1
                continue
            row = self._process_source(source, output, source_task, smoothing)
            ended[row.status.partition(":")[0]] += 1
        failed = ended[PARTIAL] + ended[FAILED]
        if not self.options.quiet or failed:
            counts = {"skipped (done before)": skipped, PARTIAL: ended[PARTIAL]}
            self._print_summary(f"{ended[DONE]} done", counts | {FAILED: ended[FAILED]})
        return 1 if failed else 0

    def _remove_leftovers(self, items: Iterable[Item]) -> None:
        names = [*(item.name for item in items), *self.ledger.rows]
        remove_leftovers({(self.folder / name).parent for name in names})

    # --- one source ---------------------------------------------------------------------

    def _process_source(
        self, source: Source, output: Output, task: Task, smoothing: bool
    ) -> IndexRow:
        """Process the frames of a source as far as possible, and return its recorded row."""
        count, folder = _Count(), self.folder / source.name
        remove_leftovers([folder.parent, folder])
        self.ledger.check_folder()
        make_folder(folder.parent, OUT_HINT)
        self.ledger.drop_frames(source.name)
        error: BaseException | None = None
        state = _file_state(source)
        try:
            with stop_on_signals() as stop, output.open() as writers:
                frames = self._detect_frames(source, task, output.cues, smoothing, stop)
                with closing(frames), self._progress(frames, "frame", source.count) as bar:
                    run_behind(partial(self._write_frame, task, writers, count, bar), bar)
            if _file_state(source) != state:
                raise InputError(source.origin, "changed while it was read", "run it again")
            stop.raise_if_requested()
        except (RoadtorchError, KeyboardInterrupt) as raised:
            error = raised
        except Exception as raised:  # of a library: one source must not end a long run
            error = to_input_error(source.origin, raised)
        row = task.method.mark(_source_row(source, count, error))
        row = row if row.failed else replace(row, sha256=source.digest())
        self.ledger.add(row)
        if not self.options.quiet:
            click.echo(f"roadtorch: {row.file}: {count}", err=True)
            for line in least_trusted_lines(count.least_trusted)[1:] if count.doubtful else []:
                click.echo(line, err=True)
        if isinstance(error, KeyboardInterrupt):
            raise error
        if row.failed:
            click.echo(f"roadtorch: {row.status}", err=True)
        return row

    def _detect_frames(
        self, source: Source, task: Task, cues: bool, smoothing: bool, stop: StopRequest
    ) -> Generator[FrameResult]:
        """Detect the road in the frames of a source, in order."""
        temporal_filter = TemporalFilter(TemporalFilterSettings()) if smoothing else None
        assert isinstance(task.infer, Inference)
        spread = partial(self.workers.map, on_crash=crashed_evidence, live=source.live)
        return detect_frames(source, task.infer, temporal_filter, cues, stop, spread)

    def _write_frame(
        self, task: Task, writers: Writers, count: "_Count", bar: Progress, frame: FrameResult
    ) -> None:
        """Write the results of a frame, and record its row."""
        row = write_row(frame.item, frame.detection, writers.files, task.method, frame.ms)
        start = perf_counter()
        if not isinstance(frame.outcome, RoadtorchError):
            for writer in writers.streams:
                writer.write(frame.item, frame.outcome)
        row = row if row.failed else replace(row, ms=elapsed_ms(start, float(row.ms)))
        self._record(row, bar)
        count.add(row)

    # --- output on the terminal ---------------------------------------------------------

    def _progress(self, items: Any, unit: str, total: int | None) -> Progress:
        return Progress(items, total=total, unit=unit, quiet=self.options.quiet)

    def _record(self, row: IndexRow, bar: Progress) -> IndexRow:
        """Add a row to the index, print it if it is a failure, and return it."""
        if row.failed:
            bar.write(f"roadtorch: {row.status}", file=sys.stderr)
        self.ledger.add(row)
        return row

    def _print_summary(self, done: str, counts: Mapping[str, int]) -> None:
        """Print one line on stderr with the counts that are not zero."""
        parts = [done, *(f"{count} {status}" for status, count in counts.items() if count)]
        click.echo(f"roadtorch: {', '.join(parts)}; results in {self.folder}", err=True)


@contextmanager
def open_run(
    out: Path,
    effective: str,
    plan: Plan,
    options: RunOptions,
    record: AbstractContextManager[None] | None = None,
) -> Iterator[Run]:
    """Open a run of a plan into an output folder.

    effective: all settings as TOML, written to config.toml. record: context entered around the
    run, such as ``record_run``. Raises as ``open_result_folder`` and ``open_ledger``.
    """
    results = {name: _input_name(owner, out) for name, owner in plan.results.items()}
    index = cache(partial(read_index, out / INDEX_FILE))

    def is_same(name: str) -> bool:
        owner = plan.results[name]
        if owner is None or owner.digest is None or owner.row_name not in index():
            return False
        return index()[owner.row_name].sha256 == owner.digest() != ""

    with (
        options.workers(plan.count) as workers,
        open_result_folder(out, effective, options.overwrite, results, is_same),
        record or nullcontext(),
        open_ledger(out / INDEX_FILE) as ledger,
    ):
        yield Run(out, ledger, workers, options)


def _input_name(owner: Item | Source | None, out: Path) -> str:
    """Return the name of an input in the ledger of results; empty for the run itself."""
    if owner is None:
        return ""
    if isinstance(owner, Item):
        return relative_name(owner.file, out) if owner.file else owner.origin
    return owner.origin if owner.live or owner.is_url else relative_name(owner.location, out)


def _trust(row: IndexRow) -> float:
    return float(row.trust or "inf")


def least_trusted_lines(rows: Iterable[IndexRow]) -> list[str]:
    """Return lines that list the least trusted images, the worst first; empty without trusts."""
    rated = sorted((row for row in rows if row.trust), key=_trust)
    if not rated:
        return []
    doubtful = sum(row.doubtful for row in rated)
    lines = [
        f"  {row.trust}  {row.file}{row.status.removeprefix(DONE).removeprefix(DOUBTFUL)}"
        for row in rated[:LEAST_TRUSTED]
    ]
    return [f"roadtorch: {doubtful} doubtful of {len(rated)}; least trusted:", *lines]


# --- one source ---------------------------------------------------------------------------


@dataclass
class _Count:
    """Counts over the frames of one source; ms, last_row and least_trusted are of the done ones."""

    done: int = 0
    failed: int = 0
    doubtful: int = 0
    ms: float = 0.0
    last_row: IndexRow = IndexRow("")  # noqa: RUF009 - it is frozen
    least_trusted: list[IndexRow] = field(default_factory=list)

    def add(self, row: IndexRow) -> None:
        """Count the row of a frame."""
        self.failed += row.failed
        if not row.failed:
            self.last_row = row
            self.done += 1
            self.doubtful += row.doubtful
            self.ms += float(row.ms)
            self.least_trusted = nsmallest(LEAST_TRUSTED, [*self.least_trusted, row], key=_trust)

    def __str__(self) -> str:
        """Return the counts as text."""
        parts = [plural(self.done, "frame")]
        parts += [f"{self.doubtful} doubtful"] if self.doubtful else []
        parts += [f"{self.failed} failed"] if self.failed else []
        return ", ".join(parts)


def _file_state(source: Source) -> tuple[float, ...]:
    """Return what changes with the file of a source: the frames and the hash are read in turn."""
    try:
        state = source.location.stat()
    except OSError:
        return ()
    return state.st_ino, state.st_size, state.st_mtime_ns


def _source_row(source: Source, count: _Count, error: BaseException | None) -> IndexRow:
    """Return the row of a source; an interruption is the usual end of a live one."""
    reason = ""
    if isinstance(error, RoadtorchError):
        reason = " ".join(str(error).split())
    elif error is not None and not source.live:
        reason = f"{source.origin}: was interrupted (run it again)"
    elif count.failed:
        frames = f"{count.failed} of {count.done + count.failed} frames failed"
        reason = f"{source.origin}: {frames} (see their rows in index.csv)"
    status = f"{PARTIAL if count.done else FAILED}: {reason}" if reason else DONE
    last = count.last_row
    row = IndexRow(source.row_name, last.width, last.height, f"{count.ms:.0f}", status=status)
    return replace(row, seconds=last.seconds)
