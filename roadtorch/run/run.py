"""A run of a command into one output folder; finished results are skipped, new ones recorded."""

import sys
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import cast

import click

from roadtorch.base.atomic import OUT_HINT, make_folder, remove_leftovers
from roadtorch.base.bounded import plural
from roadtorch.base.errors import InputError, RoadtorchError, to_input_error
from roadtorch.base.progress import Progress
from roadtorch.base.signals import stop_on_signals, until_stopped
from roadtorch.detectors.stream import FrameResult, detect_frames
from roadtorch.inputs.item import Item, Source
from roadtorch.road.temporal_filter import TemporalFilter, TemporalFilterSettings
from roadtorch.run.ledger import DONE, DOUBTFUL, FAILED, PARTIAL, IndexRow, Ledger, open_ledger
from roadtorch.run.loop import Inference, Task, crashed_evidence, crashed_row, run_behind
from roadtorch.run.plan import Output, Plan, RunOptions
from roadtorch.run.workers import Workers, make_workers

LEAST_TRUSTED = 5  # number of least trusted images that are listed at the end of a run


@dataclass(frozen=True)
class Run:
    """A run into one output folder, with its ledger, workers and options."""

    ledger: Ledger
    workers: Workers
    options: RunOptions

    def process(self, plan: Plan, task: Task, footage_key: str, smoothing: bool) -> int:
        """Process images by a task, sources under the key of footage; return the exit code."""
        failed = self.process_images(plan.images, task)
        return max(failed, self.process_sources(plan, replace(task, key=footage_key), smoothing))

    def process_images(self, items: Sequence[Item], task: Task) -> int:
        """Process the images that are not done yet, and return the exit code.

        An image is done when index.csv lists it under this key with its current bytes, and its
        files exist. A failing image becomes a failed row. The first SIGINT or SIGTERM lets started
        images finish, then raises KeyboardInterrupt.
        """
        if not items:
            return 0
        suffixes = task.writer.suffixes
        self._remove_leftovers(items)
        todo = [item for item in items if not self._is_done(item, task, suffixes)]
        with stop_on_signals() as stop:
            results = self.workers.map(task, until_stopped(todo, stop), crashed_row)
            with closing(results), self._progress(results, "image", len(todo)) as bar:
                tried = [self._record(row, bar) for row in bar]
            self._remove_leftovers(items)  # of workers that died
        stop.raise_if_requested()
        return self._summarize(tried, len(items) - len(todo))

    def process_sources(self, plan: Plan, task: Task, smoothing: bool) -> int:
        """Process the sources that are not done yet, and return the exit code.

        A source is done as an image is, if the folder of its frames exists; live ones never are. A
        failing source becomes a failed row, or a partial one where some frames were done. When
        interrupted, finished frames are kept, and videos are closed after the last of them.
        """
        if not plan.sources:
            return 0
        rows: list[IndexRow] = []
        for source, output in plan.sources:
            source_task = replace(task, kinds=output.kinds)
            has_frames = not output.frame_suffixes or (self.ledger.folder / source.name).is_dir()
            if not (has_frames and self._is_done(source, source_task, output.suffixes)):
                rows.append(self._process_source(source, output, source_task, smoothing))
        return self._summarize(rows, len(plan.sources) - len(rows))

    def _is_done(self, item: Item | Source, task: Task, suffixes: Sequence[str]) -> bool:
        done = self.ledger.is_done
        return not self.options.overwrite and done(item, task.key, task.kinds, suffixes)

    def _remove_leftovers(self, items: Iterable[Item]) -> None:
        names = [*(item.name for item in items), *self.ledger.rows]
        remove_leftovers({(self.ledger.folder / name).parent for name in names})

    # --- one source ---------------------------------------------------------------------

    def _process_source(
        self, source: Source, output: Output, task: Task, smoothing: bool
    ) -> IndexRow:
        """Process the frames of a source as far as possible, and return its recorded row."""
        folder = self.ledger.folder / source.name
        remove_leftovers([folder.parent, folder])
        self.ledger.check_folder()
        make_folder(folder.parent, OUT_HINT)
        self.ledger.drop_frames(source.name)
        earlier = self.ledger.rows.get(source.row_name)
        if earlier and earlier.method != task.key:  # a killed run leaves no row of other options
            self.ledger.add(_source_row(source, [], KeyboardInterrupt()))
        rows: list[IndexRow] = []
        error: BaseException | None = None
        state = _file_state(source)
        try:
            with stop_on_signals() as stop, output.open() as writers:
                # Shared by no other source: it remembers the frames.
                temporal_filter = TemporalFilter(TemporalFilterSettings()) if smoothing else None
                spread = partial(self.workers.map, on_crash=crashed_evidence, live=source.live)
                steps = (temporal_filter, output.cues, stop, spread)
                frames = detect_frames(source, cast("Inference", task.infer), *steps)
                with closing(frames), self._progress(frames, "frame", source.count) as bar:
                    write = replace(task, writer=writers.files, streams=writers.streams).write_row

                    def record(frame: FrameResult) -> None:
                        row = write(frame.item, frame.detection, frame.ms)
                        rows.append(self._record(row, bar))

                    run_behind(record, bar)
            stop.raise_if_requested()
            if _file_state(source) != state:
                raise InputError(source.origin, "changed while it was read", "run it again")
        except (RoadtorchError, KeyboardInterrupt) as raised:
            error = raised
        except Exception as raised:  # of a library: one source must not end a long run
            error = to_input_error(source.origin, raised)
        row = _source_row(source, rows, error)
        if not row.failed:
            digest = source.digest()
            row = replace(row, saved=" ".join(task.kinds), method=task.key, sha256=digest)
        self.ledger.add(row)
        if not self.options.quiet:
            failed = sum(frame.failed for frame in rows)
            counts = {"doubtful": sum(frame.doubtful for frame in rows), "failed": failed}
            text = _join_counts(plural(len(rows) - failed, "frame"), counts)
            click.echo(f"roadtorch: {row.file}: {text}", err=True)
            for line in least_trusted_lines(rows, only_doubtful=True)[1:]:
                click.echo(line, err=True)
        if isinstance(error, KeyboardInterrupt):
            raise error
        if row.failed:
            click.echo(f"roadtorch: {row.status}", err=True)
        return row

    # --- output on the terminal ---------------------------------------------------------

    def _progress(self, items: Iterable[object], unit: str, total: int | None) -> Progress:
        return Progress(items, total=total, unit=unit, quiet=self.options.quiet)

    def _record(self, row: IndexRow, bar: Progress) -> IndexRow:
        """Add a row to the index, print it if it is a failure, and return it."""
        if row.failed:
            bar.write(f"roadtorch: {row.status}", file=sys.stderr)
        self.ledger.add(row)
        return row

    def _summarize(self, rows: Sequence[IndexRow], skipped: int) -> int:
        """Print counts on stderr and the least trusted images, unless quiet; return the exit code.

        rows: of all images, or all sources, that were processed.
        """
        statuses = Counter(row.status.partition(":")[0] for row in rows)
        done = f"{statuses[DONE] + statuses[DOUBTFUL]} done"
        counts = {"skipped (done before)": skipped}
        counts |= {status: statuses[status] for status in (PARTIAL, FAILED)}
        failed = statuses[PARTIAL] + statuses[FAILED]
        if failed or not self.options.quiet:
            text = _join_counts(done, counts)
            click.echo(f"roadtorch: {text}; results in {self.ledger.folder}", err=True)
            for line in [] if self.options.quiet else least_trusted_lines(rows):
                click.echo(line)
        return 1 if failed else 0


@contextmanager
def open_run(out: Path, effective: str, plan: Plan, options: RunOptions) -> Iterator[Run]:
    """Open a run of a plan into an output folder; raises as ``open_ledger``.

    effective: all settings as TOML, written to config.toml.
    """
    workers = make_workers(options.jobs, plan.image_count, options.device)
    with open_ledger(out, effective, options.overwrite, plan.results) as ledger:
        yield Run(ledger, workers, options)


def least_trusted_lines(rows: Iterable[IndexRow], only_doubtful: bool = False) -> list[str]:
    """Return lines that list the least trusted images, the worst first; empty without trusts.

    only_doubtful: empty without doubtful images, too.
    """
    rated = sorted((row for row in rows if row.trust), key=lambda row: float(row.trust))
    doubtful = sum(row.doubtful for row in rated)
    if not rated or (only_doubtful and not doubtful):
        return []
    lines = [
        f"  {row.trust}  {row.file}{row.status.removeprefix(DONE).removeprefix(DOUBTFUL)}"
        for row in rated[:LEAST_TRUSTED]
    ]
    head = f"roadtorch: {doubtful} doubtful of {len(rated)}; least trusted"
    return [f"{head} (trust does not tell pavement from road: see overlays):", *lines]


# --- one source ---------------------------------------------------------------------------


def _join_counts(first: str, counts: Mapping[str, int]) -> str:
    """Return a text with the counts that are not zero."""
    return ", ".join([first, *(f"{count} {status}" for status, count in counts.items() if count)])


def _file_state(source: Source) -> tuple[float, ...]:
    """Return what changes with the file of a source: the frames and the hash are read in turn."""
    if source.path is None or not source.path.exists():
        return ()
    state = source.path.stat()
    return state.st_ino, state.st_size, state.st_mtime_ns


def _source_row(
    source: Source, frames: Sequence[IndexRow], error: BaseException | None
) -> IndexRow:
    """Return the row of a source; an interruption is the usual end of a live one."""
    done = [row for row in frames if not row.failed]
    reason = ""
    if isinstance(error, RoadtorchError):
        reason = " ".join(str(error).split())
    elif error is not None and not source.live:
        reason = f"{source.origin}: was interrupted (run it again)"
    elif len(done) < len(frames):
        counts = f"{len(frames) - len(done)} of {len(frames)} frames failed"
        reason = f"{source.origin}: {counts} (see their rows in index.csv)"
    status = f"{PARTIAL if done else FAILED}: {reason}" if reason else DONE
    last, ms = done[-1] if done else IndexRow(""), sum(float(row.ms) for row in done)
    row = IndexRow(source.row_name, last.width, last.height, f"{ms:.0f}", status=status)
    return replace(row, seconds=last.seconds)
