"""Videos, cameras, streams and bags: what ``infer`` writes of them, and how they are done."""

import re
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, closing, contextmanager, nullcontext
from dataclasses import dataclass, field, replace
from functools import partial
from heapq import nsmallest
from pathlib import Path
from time import perf_counter
from typing import NamedTuple

import click
import numpy as np
from torch import Tensor

from roadtorch.camera.camera import Camera
from roadtorch.detector import Detection, Detector
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
from roadtorch.runs.options import FrameSelection, RunOptions
from roadtorch.runs.pictures import (
    LEAST_TRUSTED,
    Job,
    Method,
    least_trusted,
    plan,
    spared,
    tell,
    trust_of,
)
from roadtorch.runs.results import SUFFIXES, Inference
from roadtorch.runtime.progress import Progress
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


def missed_row(missed: Missed) -> Row:
    """The row of a frame without a result; its status says why."""
    status = f"{FAILED}: {' '.join(str(missed.problem).split())}"
    return Row(missed.frame.name, status=status)


Write = Callable[[Seen], Row]
"""Writes the results of a frame and gives its row, to which the time is added."""


class Written(NamedTuple):
    """What a command writes of one source.

    kinds: what index.csv says was saved. ends: of the names of the files of the whole source.
    frame_ends: of those of the files of each frame. open: of the source's job, what writes frame
    after frame within the block.
    """

    kinds: tuple[str, ...]
    ends: Sequence[str]
    frame_ends: Sequence[str]
    open: Callable[[Job], AbstractContextManager[Write]]


Draw = Callable[[Detection], np.ndarray]
Put = Callable[[Seen, np.ndarray], None]
"""Where what was drawn of a frame goes."""

VIDEOS: dict[str, tuple[str, Draw]] = {
    "overlay": (".overlay.mp4", Detection.overlay),
    "mask-video": (".mask.mp4", lambda found: found.mask.numpy().astype(np.uint8) * 255),
    "likelihood-video": (
        ".likelihood.mp4",
        lambda found: found.likelihood.mul(255).round().byte().numpy(),
    ),
}
"""The results that are videos: how their names end, and what they show, uint8 (H,W) or (H,W,3)."""

GIF = ".overlay.gif"


@dataclass(frozen=True)
class FootageResults:
    """What ``infer`` writes of a source: videos, a GIF, bags, and files for each frame.

    work: on a picture. asked: the kinds of ``--save``, None where it is not given: of a moving
    source ``overlay`` is a video and ``overlay-frames`` are pictures. gif: its start and end in
    seconds. topic: of the images in bags; None where they have one.
    """

    work: Inference
    asked: tuple[str, ...] | None
    gif: tuple[float, float] | None = None
    topic: str | None = None

    def __call__(self, source: Source) -> Written:
        """What is written of that source."""
        usual = USUAL_OF_BAGS if is_from_bag(source) else USUAL_OF_FOOTAGE
        usual = usual if source.moving else USUAL_OF_PICTURES
        kinds = usual if self.asked is None else self.asked
        ends: dict[str, str] = {}
        of_frames = set(kinds)
        if source.moving:
            kinds = (*kinds, "gif") if self.gif else kinds
            ends = {kind: end for kind, (end, _) in VIDEOS.items()}
            ends |= {"gif": GIF, "bag": bag_ending(source, ".road")}
            of_frames -= ends.keys()
            if "overlay-frames" in kinds:
                of_frames = of_frames - {"overlay-frames"} | {"overlay"}
        own = {kind: ends[kind] for kind in kinds if kind in ends}
        frame_ends = [SUFFIXES.get(kind, f".{kind}") for kind in of_frames]
        work = replace(self.work, kinds=frozenset(of_frames))
        return Written(kinds, [*own.values()], frame_ends, partial(self._open, source, work, own))

    @contextmanager
    def _open(
        self, source: Source, work: Inference, ends: Mapping[str, str], job: Job
    ) -> Iterator[Write]:
        """However the block ends, videos and bags are finished with the frames that they have."""
        with ExitStack() as stack:
            puts: list[tuple[Draw, Put]] = []

            def show(draw: Draw, sink: VideoSink | GifSink) -> None:
                stack.enter_context(closing(sink))
                puts.append((draw, lambda seen, pixels: sink.write(pixels, seen.frame.seconds)))

            if self.gif and source.moving:
                show(Detection.overlay, GifSink(job.output(GIF), *self.gif))
            for kind in [kind for kind in ends if kind in VIDEOS]:
                show(VIDEOS[kind][1], VideoSink(job.output(ends[kind]), source.rate))
            if "bag" in ends:
                frame_id = CAMERA_FRAME
                if is_from_bag(source):
                    frame_id = image_topic(source.origin, self.topic).frame_id
                bag = BagSink(job.output(ends["bag"]), frame_id, work.detector.settings.threshold)
                stack.enter_context(closing(bag))

                def add(seen: Seen, pixels: np.ndarray) -> None:
                    bag.write(seen.detection, stamp_of(seen.frame), pixels)

                puts.append((Detection.overlay, add))
            yield partial(_write, work, puts, job)


def _write(work: Inference, puts: list[tuple[Draw, Put]], job: Job, seen: Seen) -> Row:
    """Write what was seen; the row for index.csv, a failed one without the frame's files."""
    name = seen.frame.name
    try:
        row = work.write(name, seen.image, seen.detection, partial(job.output, name=name))
    except InputError as problem:
        row = missed_row(Missed(seen.frame, problem))
    drawn = {draw: draw(seen.detection) for draw in dict.fromkeys(draw for draw, _ in puts)}
    for draw, put in puts:
        put(seen, drawn[draw])
    return row


# --- all sources ------------------------------------------------------------------------


class Footage(NamedTuple):
    """A source, what is written of it, and its job."""

    source: Source
    written: Written
    job: Job


class Plan(NamedTuple):
    """What a run does: the jobs of pictures that stand alone, footage, and whose name is which."""

    jobs: list[Job]
    footage: list[Footage]
    owners: Owners


def plan_run(
    found: Inputs,
    out: Path | RemoteFolder,
    ends: Sequence[str],
    results: Callable[[Source], Written],
) -> Plan:
    """The jobs for pictures, and what is to be done of sources; no file is written yet.

    ends: of the names of the pictures' results, see ``Job``. Raises what ``plan`` raises, also for
    sources, and ConfigError where results of footage would go behind a URL.
    """
    owners = Owners(out)
    jobs = plan(found.pictures, out, ends, owners)
    if found.sources and not isinstance(out, Path):
        remedy = "give a folder of this machine, or pictures alone"
        raise ConfigError(f"--out {out.url}", "takes no results of footage", remedy)
    footage: list[Footage] = []
    for source in found.sources:
        written = results(source)
        has_files = source.moving and bool(written.frame_ends)
        owners.take_source(source.name, source.origin, has_files)
        picture = Picture(source.path or Path(source.origin), source.name)
        footage.append(Footage(source, written, Job(picture, out, written.ends)))
    spared([one.job for one in footage])
    return Plan(jobs, footage, owners)


def opened(inputs: Sequence[str], out: Path | RemoteFolder, frames: FrameSelection) -> Inputs:
    """The pictures and sources that inputs and options choose, but those of ``out``.

    Raises as ``find_inputs`` and ``Selection.of_pictures`` do.
    """
    chosen = Selection(frames.every, frames.start, frames.end, frames.limit)
    apart = out if isinstance(out, Path) else None
    options = SourceOptions(apart, Patience(answer=frames.patience), frames.topic)
    found = find_inputs(inputs, chosen, options)
    return found._replace(pictures=chosen.of_pictures(found.pictures))


class FootageWork(NamedTuple):
    """What looks at sources, whatever is written of them.

    camera: the one that the footage has to be of, where it is known. steady: whether the likelihood
    of a source that moves is steadied.
    """

    detector: Detector
    camera: Camera | None = None
    steady: bool = True


def run_footage(planned: Plan, work: FootageWork, method: Method, options: RunOptions) -> int:
    """Work through the sources that are not done yet; returns the exit code.

    A source is done when index.csv says so, of this method and of the bytes that its file has now,
    and its videos are there; live ones never are. One that fails becomes a failed row behind those
    of its frames, a partial one where some were done, and the others go on. When interrupted, what
    was finished is kept, the videos with what they have.
    """
    if not planned.footage:
        return 0
    skipped, ended = 0, Counter[str]()
    for one in planned.footage:
        own = replace(method, kinds=one.written.kinds)
        row = read_index(one.job.output("", INDEX)).get(one.job.file)
        if not options.overwrite and own.covers(row, one.job):
            skipped += 1
            if not one.source.moving:  # its results are there, and stay
                deque(_owned(one, planned.owners), maxlen=0)
        else:
            status = _run_source(one, planned.owners, work, own, options).status
            ended[status.partition(":")[0]] += 1
    failed = ended[PARTIAL] + ended[FAILED]
    if not options.quiet or failed:
        others = {"skipped (done before)": skipped, PARTIAL: ended[PARTIAL], FAILED: ended[FAILED]}
        tell(f"{ended[DONE]} done", others, planned.footage[0].job.out)
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
    footage: Footage, owners: Owners, work: FootageWork, method: Method, options: RunOptions
) -> Row:
    """The row of a source whose frames were looked at as far as possible; the index has it."""
    source, written, job = footage
    if not source.moving:
        source = replace(source, frames=partial(_owned, footage, owners))
    remove_leftovers([job.output("").parent, job.output("")])
    make_folder(job.output("").parent, ELSEWHERE)
    problem: BaseException | None = None
    count = FrameCount()
    own_frames = f"{re.escape(printable(job.picture.name))}/{FRAME_NUMBER}"
    with frame_index(job.output("", INDEX), job.file, own_frames) as add:

        def settle(one: Seen | Missed, write: Write) -> None:
            """Write what was seen of a frame, or tell why nothing was."""
            start = perf_counter()
            row = write(one) if isinstance(one, Seen) else missed_row(one)
            if isinstance(one, Seen) and not row.failed:
                row = replace(row, ms=f"{one.ms + 1000 * (perf_counter() - start):.0f}")
            if one.frame.seconds is not None:
                row = replace(row, seconds=f"{one.frame.seconds:.3f}")
            if row.failed:
                click.echo(f"roadtorch: {row.status}", err=True)
            else:
                row = replace(row, saved=" ".join(method.kinds), method=method.digest)
            count.add(row)
            add(row)

        try:
            with written.open(job) as write:
                _work_through(source, work, partial(settle, write=write), options)
        except (RoadtorchError, KeyboardInterrupt) as own:
            problem = own
        row = method.finished(_row(source, job, count, problem), job)
        add(row)
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


def _owned(footage: Footage, owners: Owners) -> Generator[Frame]:
    """The frames of a source; one whose results would be another's fails, as SOURCE!NAME.png."""

    def refuse(problem: ConfigError) -> Tensor:
        raise problem

    source, frames = footage.source, footage.source.frames()
    with closing(frames) if isinstance(frames, Generator) else nullcontext():
        for frame in frames:
            try:
                owners.take(frame.name, footage.written.frame_ends, frame.origin)
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
