"""What ``infer`` writes of footage: videos, a GIF, bags, and files for each frame."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Literal

import numpy as np

from roadtorch.detector import Detector
from roadtorch.io.atomic import make_folder
from roadtorch.runs import results
from roadtorch.runs.bag_results import bag_ending, is_from_bag, stamp_of
from roadtorch.runs.batch import Job
from roadtorch.runs.claim import ELSEWHERE
from roadtorch.runs.index import FAILED, Row
from roadtorch.sinks.bags import BagSink
from roadtorch.sinks.gif import GifSink
from roadtorch.sinks.video import VideoSink
from roadtorch.sources.bags import image_topic
from roadtorch.sources.frame import Source
from roadtorch.stream import Missed, Seen

USUAL_OF_PICTURES, USUAL_OF_FOOTAGE = ("likelihood", "mask", "overlay"), ("overlay",)
USUAL_OF_BAGS = ("overlay", "bag")
"""What is written where nothing is asked for."""

CAMERA_FRAME = "camera"
"""The frame of reference in bags of footage that tells none."""


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
    """What is written of a source.

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
        kinds = _usual(source) if self.asked is None else self.asked
        return (*kinds, "gif") if self.gif and source.moving else kinds

    def suffixes(self, source: Source) -> dict[str, str]:
        """How the names of the files of the whole source end, by kind."""
        if not source.moving:
            return {}
        ends = {kind: end for kind, (end, _) in VIDEOS.items()}
        ends |= {"gif": GIF, "bag": bag_ending(source, ".road")}
        return {kind: ends[kind] for kind in self.kinds(source) if kind in ends}

    def frame_kinds(self, source: Source) -> frozenset[str]:
        """What is written as files for each frame."""
        kinds = frozenset(self.kinds(source))
        if not source.moving:
            return kinds
        frames = kinds - {*VIDEOS, "gif", "bag", "overlay-frames"}
        return frames | {"overlay"} if "overlay-frames" in kinds else frames

    @contextmanager
    def open(self, source: Source, job: Job) -> Iterator[Callable[[Seen], Row]]:
        """What writes the results of a frame and gives its row.

        However the block ends, videos and bags are finished with the frames that they have.
        """
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
                bag = stack.enter_context(closing(self._bag(source, job)))
                puts.append((_overlay, partial(_add_to_bag, bag)))
            yield partial(self._write, puts, self.frame_kinds(source), job.out)

    def _bag(self, source: Source, job: Job) -> BagSink:
        frame_id = CAMERA_FRAME
        if is_from_bag(source):
            frame_id = image_topic(source.origin, self.topic).frame_id
        path = job.output(job.suffixes["bag"])
        return BagSink(path, frame_id, self.detector.settings.threshold)

    def _write(
        self,
        puts: list[tuple[Draw, Put]],
        kinds: frozenset[str],
        out: Path,
        seen: Seen,
    ) -> Row:
        """Write what was seen, to the files of the frame first; the row for index.csv."""
        start = perf_counter()
        frame, detection = seen.frame, seen.detection

        def output(suffix: str) -> Path:
            return out / (frame.name + suffix)

        if kinds:
            make_folder(output("").parent, ELSEWHERE)
            results.write_files(output, kinds, self.depth, seen.image, detection)
            results.write_documents(output, kinds, frame.name, detection, self.detector)
        drawn = {draw: draw(seen) for draw in dict.fromkeys(draw for draw, _ in puts)}
        for draw, put in puts:
            put(seen, drawn[draw])
        row = results.row_of(frame.name, detection, seen.ms + 1000 * (perf_counter() - start))
        return replace(row, seconds=clock_text(frame.seconds))


def _usual(source: Source) -> tuple[str, ...]:
    if not source.moving:
        return USUAL_OF_PICTURES
    return USUAL_OF_BAGS if is_from_bag(source) else USUAL_OF_FOOTAGE


def _add_pixels(sink: VideoSink | GifSink, seen: Seen, pixels: np.ndarray) -> None:
    sink.write(pixels, seen.frame.seconds)


def _add_to_bag(sink: BagSink, seen: Seen, pixels: np.ndarray) -> None:
    sink.write(seen.detection, stamp_of(seen.frame), pixels)


def clock_text(seconds: float | None) -> str:
    """Seconds for index.csv, to the millisecond; empty where there is no clock."""
    return "" if seconds is None else f"{seconds:.3f}"


def missed_row(missed: Missed) -> Row:
    """The row of a frame without a result; its status says why."""
    status = f"{FAILED}: {' '.join(str(missed.problem).split())}"
    return Row(missed.frame.name, status=status, seconds=clock_text(missed.frame.seconds))
