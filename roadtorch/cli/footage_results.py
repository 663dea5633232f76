"""What ``infer`` writes of footage: videos, a GIF, and files for each frame."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Literal

import numpy as np

from roadtorch.cli import results
from roadtorch.cli.batch import Job, Row
from roadtorch.cli.claim import ELSEWHERE
from roadtorch.files import make_folder
from roadtorch.sinks.gif import GifSink
from roadtorch.sinks.video import VideoSink
from roadtorch.sources.frame import Source
from roadtorch.stream import Seen

USUAL_OF_PICTURES, USUAL_OF_FOOTAGE = ("likelihood", "mask", "overlay"), ("overlay",)
"""What is written where nothing is asked for."""


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
    video and ``overlay-frames`` are pictures. gif: its start and end in seconds.
    """

    asked: tuple[str, ...] | None = None
    depth: Literal[8, 16] = 8
    gif: tuple[float, float] | None = None

    def kinds(self, source: Source) -> tuple[str, ...]:
        """What index.csv says was saved."""
        usual = USUAL_OF_FOOTAGE if source.moving else USUAL_OF_PICTURES
        kinds = usual if self.asked is None else self.asked
        return (*kinds, "gif") if self.gif and source.moving else kinds

    def suffixes(self, source: Source) -> dict[str, str]:
        """How the names of the files of the whole source end, by kind."""
        if not source.moving:
            return {}
        ends = {kind: end for kind, (end, _) in VIDEOS.items()} | {"gif": GIF}
        return {kind: ends[kind] for kind in self.kinds(source) if kind in ends}

    def frame_kinds(self, source: Source) -> frozenset[str]:
        """What is written as files for each frame."""
        kinds = frozenset(self.kinds(source))
        if not source.moving:
            return kinds
        frames = kinds - {*VIDEOS, "gif", "overlay-frames"}
        return frames | {"overlay"} if "overlay-frames" in kinds else frames

    @contextmanager
    def open(self, source: Source, job: Job) -> Iterator[Callable[[Seen], Row]]:
        """What writes the results of a frame and gives its row.

        However the block ends, the videos are finished with the frames that they have.
        """
        sinks: list[tuple[VideoSink | GifSink, Draw]] = [
            (VideoSink(job.output(end), source.rate), VIDEOS[kind][1])
            for kind, end in job.suffixes.items()
            if kind in VIDEOS
        ]
        gif = GifSink(job.output(GIF), *self.gif) if self.gif and source.moving else None
        with ExitStack() as stack:
            for sink in [gif, *(sink for sink, _ in sinks)]:
                if sink is not None:
                    stack.callback(sink.close)
            if gif is not None:
                sinks.append((gif, _overlay))
            yield partial(_write, sinks, self.frame_kinds(source), self.depth, job.out)


def _write(
    sinks: list[tuple[VideoSink | GifSink, Draw]],
    kinds: frozenset[str],
    depth: Literal[8, 16],
    out: Path,
    seen: Seen,
) -> Row:
    """Write what was seen, to the files of the frame first; the row for index.csv."""
    start = perf_counter()
    frame = seen.frame

    def output(suffix: str) -> Path:
        return out / (frame.name + suffix)

    if kinds:
        make_folder(output("").parent, ELSEWHERE)
        results.write_files(output, kinds, depth, seen.image, seen.detection)
    drawn = {draw: draw(seen) for draw in dict.fromkeys(draw for _, draw in sinks)}
    for sink, draw in sinks:
        sink.write(drawn[draw], frame.seconds)
    row = results.row_of(frame.name, seen.detection, seen.ms + 1000 * (perf_counter() - start))
    return replace(row, seconds=clock_text(frame.seconds))


def clock_text(seconds: float | None) -> str:
    """Seconds for index.csv, to the millisecond; empty where there is no clock."""
    return "" if seconds is None else f"{seconds:.3f}"
