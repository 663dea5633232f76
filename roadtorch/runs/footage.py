"""Videos, cameras, streams and bags: what ``infer`` writes of them, and how they are done."""

import re
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, closing, contextmanager, nullcontext
from dataclasses import dataclass, field, replace
from functools import partial
from heapq import nsmallest
from pathlib import Path
from time import perf_counter
from typing import Literal, Protocol

import click
import numpy as np
from torch import Tensor

from roadtorch.camera.camera import Camera
from roadtorch.detector import Detector
from roadtorch.errors import ConfigError, InputError, RoadtorchError
from roadtorch.io.atomic import make_folder, remove_leftovers
from roadtorch.io.bounded import printable
from roadtorch.road.steady import Steady, SteadySettings
from roadtorch.runs.folder import ELSEWHERE, FRAME_NUMBER, Owners
from roadtorch.runs.index import (
    DONE,
    DOUBTFUL,
    FAILED,
    INDEX,
    PARTIAL,
    Row,
    frame_index,
    read_index,
)
from roadtorch.runs.options import FrameSelection
from roadtorch.runs.pictures import (
    LEAST_TRUSTED,
    Job,
    Method,
    RunOptions,
    least_trusted,
    spared,
    trust_of,
)
from roadtorch.runs.results import SUFFIXES, row_of, write_documents, write_files
from roadtorch.runtime.signals import stop_on_signals
from roadtorch.sinks.bags import BagSink
from roadtorch.sinks.remote_folder import RemoteFolder
from roadtorch.sinks.video import GifSink, VideoSink
from roadtorch.sources.bags import image_topic, is_bag
from roadtorch.sources.frame import Frame, Selection, Source
from roadtorch.sources.live import Patience
from roadtorch.sources.open import Inputs, SourceOptions, find_inputs
from roadtorch.sources.pictures import Picture
from roadtorch.stream import AHEAD, Behind, Missed, Seen, seen_frames

USUAL_OF_PICTURES, USUAL_OF_FOOTAGE = ("likelihood", "mask", "overlay"), ("overlay",)
USUAL_OF_BAGS = ("overlay", "bag")
"""What is written where nothing is asked for."""

CAMERA_FRAME = "camera"
"""The frame of reference in bags of footage that tells none."""

# --- what is written of a source --------------------------------------------------------


def is_from_bag(source: Source) -> bool:
    """Whether the frames of a source are those of a bag."""
    return source.moving and not source.live and is_bag(source.origin)


def bag_ending(source: Source, end: str) -> str:
    """How the name of the bag ends: of ROS 1 where the source is such a bag, else of ROS 2."""
    path = Path(source.origin)
    is_ros1 = is_from_bag(source) and path.suffix == ".bag" and path.is_file()
    return f"{end}.bag" if is_ros1 else end


def stamp_of(frame: Frame) -> int:
    """Nanoseconds: the source's own, else since it began, one second a frame without a clock."""
    if frame.stamp is not None:
        return frame.stamp
    return round(1e9 * (frame.number if frame.seconds is None else frame.seconds))


def clock_text(seconds: float | None) -> str:
    """Seconds for index.csv, to the millisecond; empty where there is no clock."""
    return "" if seconds is None else f"{seconds:.3f}"


def missed_row(missed: Missed) -> Row:
    """The row of a frame without a result; its status says why."""
    status = f"{FAILED}: {' '.join(str(missed.problem).split())}"
    return Row(missed.frame.name, status=status, seconds=clock_text(missed.frame.seconds))


class WhatIsWritten(Protocol):
    """What a command writes of sources; for ``infer`` it is ``FootageResults``."""

    def kinds(self, source: Source) -> tuple[str, ...]:
        """What index.csv says was saved."""
        ...

    def suffixes(self, source: Source) -> dict[str, str]:
        """How the names of the files of the whole source end, by kind."""
        ...

    def frame_suffixes(self, source: Source) -> tuple[str, ...]:
        """How the names of the files of each frame end."""
        ...

    def open(self, source: Source, job: Job) -> AbstractContextManager[Callable[[Seen], Row]]:
        """What writes the results of a frame and gives its row."""
        ...


def _overlay(seen: Seen) -> np.ndarray:
    """uint8 (H,W,3)."""
    return seen.detection.overlay()


def _mask(seen: Seen) -> np.ndarray:
    """uint8 (H,W): road 255."""
    return seen.detection.mask.numpy().astype(np.uint8) * 255


def _likelihood(seen: Seen) -> np.ndarray:
    """uint8 (H,W): the likelihood times 255."""
    return seen.detection.likelihood.mul(255).round().byte().numpy()


Draw = Callable[[Seen], np.ndarray]
Put = Callable[[Seen, np.ndarray], None]
"""Where what was drawn of a frame goes."""

VIDEOS: dict[str, tuple[str, Draw]] = {
    "overlay": (".overlay.mp4", _overlay),
    "mask-video": (".mask.mp4", _mask),
    "likelihood-video": (".likelihood.mp4", _likelihood),
}
"""The kinds of results that are videos: how their names end, and what they show of a frame."""

GIF = ".overlay.gif"


@dataclass(frozen=True)
class FootageResults:
    """What ``infer`` writes of a source: videos, a GIF, bags, and files for each frame.

    asked: the kinds of ``--save``, None where it is not given: of a moving source ``overlay`` is a
    video and ``overlay-frames`` are pictures. gif: its start and end in seconds. detector: the one
    that was used. topic: of the images in bags; None where they have one.
    """

    asked: tuple[str, ...] | None
    depth: Literal[8, 16]
    gif: tuple[float, float] | None
    detector: Detector
    topic: str | None = None

    def kinds(self, source: Source) -> tuple[str, ...]:
        """What index.csv says was saved."""
        usual = USUAL_OF_BAGS if is_from_bag(source) else USUAL_OF_FOOTAGE
        usual = usual if source.moving else USUAL_OF_PICTURES
        kinds = usual if self.asked is None else self.asked
        return (*kinds, "gif") if self.gif and source.moving else kinds

    def suffixes(self, source: Source) -> dict[str, str]:
        """How the names of the files of the whole source end, by kind."""
        if not source.moving:
            return {}
        ends = {kind: end for kind, (end, _) in VIDEOS.items()}
        ends |= {"gif": GIF, "bag": bag_ending(source, ".road")}
        return {kind: ends[kind] for kind in self.kinds(source) if kind in ends}

    def _frame_kinds(self, source: Source) -> frozenset[str]:
        kinds = frozenset(self.kinds(source))
        if source.moving:
            frames = kinds - {*VIDEOS, "gif", "bag", "overlay-frames"}
            kinds = frames | {"overlay"} if "overlay-frames" in kinds else frames
        return kinds

    def frame_suffixes(self, source: Source) -> tuple[str, ...]:
        """How the names of the files of each frame end."""
        return tuple(SUFFIXES.get(kind, f".{kind}") for kind in self._frame_kinds(source))

    @contextmanager
    def open(self, source: Source, job: Job) -> Iterator[Callable[[Seen], Row]]:
        """What writes the results of a frame and gives its row.

        However the block ends, videos and bags are finished with the frames that they have.
        """
        kinds = self._frame_kinds(source)
        with ExitStack() as stack:
            puts: list[tuple[Draw, Put]] = []
            if self.gif and source.moving:
                gif = stack.enter_context(closing(GifSink(job.output(GIF), *self.gif)))
                puts.append((_overlay, partial(_add_pixels, gif)))
            for kind in [kind for kind in job.suffixes if kind in VIDEOS]:
                end, draw = VIDEOS[kind]
                video = stack.enter_context(closing(VideoSink(job.output(end), source.rate)))
                puts.append((draw, partial(_add_pixels, video)))
            if "bag" in job.suffixes:
                frame_id = CAMERA_FRAME
                if is_from_bag(source):
                    frame_id = image_topic(source.origin, self.topic).frame_id
                path = job.output(job.suffixes["bag"])
                sink = BagSink(path, frame_id, self.detector.settings.threshold)
                puts.append((_overlay, partial(_add_to_bag, stack.enter_context(closing(sink)))))
            yield partial(self._write, puts, kinds, job)

    def _write(
        self, puts: list[tuple[Draw, Put]], kinds: frozenset[str], job: Job, seen: Seen
    ) -> Row:
        """Write what was seen; the row for index.csv, a failed one without the frame's files."""
        start = perf_counter()
        frame, detection = seen.frame, seen.detection
        failed: Row | None = None
        try:
            output = partial(job.output, name=frame.name)
            if kinds:
                make_folder(output("").parent, ELSEWHERE)
            write_files(output, kinds, self.depth, seen.image, detection)
            write_documents(output, kinds, frame.name, detection, self.detector)
        except InputError as problem:
            failed = missed_row(Missed(frame, problem))
        drawn = {draw: draw(seen) for draw in dict.fromkeys(draw for draw, _ in puts)}
        for draw, put in puts:
            put(seen, drawn[draw])
        row = failed or row_of(frame.name, detection, seen.ms + 1000 * (perf_counter() - start))
        return replace(row, seconds=clock_text(frame.seconds))


def _add_pixels(sink: VideoSink | GifSink, seen: Seen, pixels: np.ndarray) -> None:
    sink.write(pixels, seen.frame.seconds)


def _add_to_bag(sink: BagSink, seen: Seen, pixels: np.ndarray) -> None:
    sink.write(seen.detection, stamp_of(seen.frame), pixels)


# --- all sources ------------------------------------------------------------------------


@dataclass(frozen=True)
class FootageWork:
    """The work on sources.

    owners: of the names that the run has given. camera: the one that the footage has to be of,
    where it is known. steady: whether the likelihood of a source that moves is steadied.
    """

    detector: Detector
    results: WhatIsWritten
    owners: Owners
    camera: Camera | None = None
    steady: bool = True


def plan_footage(
    sources: Sequence[Source],
    out: Path | RemoteFolder,
    results: WhatIsWritten,
    owners: Owners,
) -> list[tuple[Source, Job]]:
    """The sources of footage, each with its job.

    owners: of the names that the run has given, who are told of these. Raises ConfigError where
    results would go behind a URL, replace a source, or be those of two.
    """
    if not sources:
        return []
    if not isinstance(out, Path):
        remedy = "give a folder of this machine, or pictures alone"
        raise ConfigError(f"--out {out.url}", "takes no results of footage", remedy)
    jobs = [
        Job(Picture(source.path or Path(source.origin), source.name), out, results.suffixes(source))
        for source in sources
    ]
    for source in sources:
        has_files = source.moving and bool(results.frame_suffixes(source))
        owners.take_source(source.name, source.origin, has_files)
    return list(zip(sources, spared(jobs), strict=True))


def opened(inputs: Sequence[str], out: Path | RemoteFolder, frames: FrameSelection) -> Inputs:
    """The pictures and sources among inputs, but those of ``out``; raises as ``find_inputs``."""
    apart = out if isinstance(out, Path) else None
    options = SourceOptions(apart, Patience(answer=frames.patience), frames.topic)
    return find_inputs(inputs, selected(frames), options)


def selected(selection: FrameSelection) -> Selection:
    """Which frames and pictures the options choose."""
    return Selection(selection.every, selection.start, selection.end, selection.limit)


def run_footage(
    planned: Sequence[tuple[Source, Job]], work: FootageWork, method: Method, options: RunOptions
) -> int:
    """Work through the sources that are not done yet; returns the exit code.

    A source is done when index.csv says so, of this method and of the bytes that its file has now,
    and its videos are there; live ones never are. One that fails becomes a failed row behind those
    of its frames, a partial one where some were done, and the others go on. When interrupted, what
    was finished is kept, the videos with what they have.
    """
    skipped, ended = 0, Counter[str]()
    for source, job in planned:
        own = replace(method, kinds=work.results.kinds(source))
        row = read_index(job.output("", INDEX)).get(job.file)
        if not options.overwrite and own.covers(row, job):
            skipped += 1
            if not source.moving:  # its results are there, and stay
                deque(_owned(source, work.results, work.owners), maxlen=0)
        else:
            status = _run_source(source, job, work, own, options).status
            ended[status.partition(":")[0]] += 1
    failed = ended[PARTIAL] + ended[FAILED]
    if not options.quiet or failed:
        parts = [f"{ended[DONE]} done"]
        parts += [f"{skipped} skipped (done before)"] if skipped else []
        parts += [f"{ended[kind]} {kind}" for kind in (PARTIAL, FAILED) if ended[kind]]
        click.echo(f"roadtorch: {', '.join(parts)}; results in {planned[0][1].out}", err=True)
    return 1 if failed else 0


@dataclass
class FrameCount:
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
            self.doubtful += row.status.startswith(DOUBTFUL)
            self.ms += float(row.ms)
            self.least = nsmallest(LEAST_TRUSTED, [*self.least, row], key=trust_of)

    def __str__(self) -> str:
        """In words."""
        parts = [f"{self.done} frames"]
        parts += [f"{self.doubtful} doubtful"] if self.doubtful else []
        parts += [f"{self.failed} failed"] if self.failed else []
        return ", ".join(parts)


def _run_source(
    source: Source, job: Job, work: FootageWork, method: Method, options: RunOptions
) -> Row:
    """The row of a source whose frames were looked at as far as possible; the index has it."""
    remove_leftovers([job.output("").parent, job.output("")])
    make_folder(job.output("").parent, ELSEWHERE)
    problem: BaseException | None = None
    count = FrameCount()
    own_frames = f"{re.escape(printable(job.picture.name))}/{FRAME_NUMBER}"
    with frame_index(job.output("", INDEX), job.file, own_frames) as index:

        def settle(one: Seen | Missed, write: Callable[[Seen], Row]) -> None:
            """Write what was seen of a frame, or tell why nothing was."""
            row = write(one) if isinstance(one, Seen) else missed_row(one)
            if row.failed:
                click.echo(f"roadtorch: {row.status}", err=True)
            else:
                row = replace(row, saved=" ".join(method.kinds), method=method.digest)
            count.add(row)
            index.add(row)

        try:
            with work.results.open(source, job) as write:
                _work_through(source, work, partial(settle, write=write), options)
        except (RoadtorchError, KeyboardInterrupt) as own:
            problem = own
        row = method.finished(_row(source, job, count, problem), job)
        index.add(row)
    if not options.quiet:
        click.echo(f"roadtorch: {job.file}: {count}", err=True)
        shown = least_trusted(count.least) if count.doubtful or not source.moving else []
        for line in shown[1:]:
            click.echo(line, err=True)
    if isinstance(problem, KeyboardInterrupt):
        raise problem
    if row.failed:
        click.echo(f"roadtorch: {row.status}", err=True)
    return row


def _row(source: Source, job: Job, count: FrameCount, problem: BaseException | None) -> Row:
    """The row of a source; to be interrupted is the usual end of a live one."""
    why = ""
    if isinstance(problem, RoadtorchError):
        why = " ".join(str(problem).split())
    elif problem is not None and not source.live:
        why = f"{source.origin}: was interrupted (run it again)"
    elif count.failed:
        of = f"{count.done} of {count.done + count.failed} frames"
        why = f"{source.origin}: {of} (see the rows of the others)"
    status = f"{PARTIAL if count.done else FAILED}: {why}" if why else DONE
    last = count.last
    row = Row(job.file, last.width, last.height, f"{count.ms:.0f}", status=status)
    return replace(row, seconds=last.seconds)


def _owned(source: Source, results: WhatIsWritten, owners: Owners) -> Generator[Frame]:
    """The frames of a source; one whose results would be another's fails, as SOURCE!NAME.png."""

    def refuse(problem: ConfigError) -> Tensor:
        raise problem

    frames, suffixes = source.frames(), results.frame_suffixes(source)
    with closing(frames) if isinstance(frames, Generator) else nullcontext():
        for frame in frames:
            try:
                owners.take(frame.name, suffixes, frame.origin)
            except ConfigError as problem:
                name = f"{Path(source.origin).name}!{frame.name}{Path(frame.origin).suffix}"
                frame = replace(frame, name=name, read=partial(refuse, problem))
            yield frame


def _work_through(
    source: Source,
    work: FootageWork,
    settle: Callable[[Seen | Missed], None],
    options: RunOptions,
) -> None:
    """Look at all frames, and write what is found in a thread of its own, a few frames behind."""
    from roadtorch.runtime.progress import Progress

    if not source.moving:
        source = replace(source, frames=partial(_owned, source, work.results, work.owners))
    steady = Steady(SteadySettings()) if work.steady and source.moving else None
    check = None if work.camera is None else work.camera.check
    seen = seen_frames(source, work.detector, jobs=options.jobs, steady=steady, check=check)
    behind = Behind(AHEAD)
    with closing(seen), Progress(total=source.count, unit="frame", quiet=options.quiet) as bar:
        try:
            for one in seen:
                behind.do(partial(settle, one))
                bar.update()
        finally:  # what was handed over is written, also when asked to stop twice
            with stop_on_signals():
                behind.finish()
