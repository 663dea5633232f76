"""Videos of detections: MP4 with the frames' time stamps, H.264 where the encoder is available."""

import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from fractions import Fraction
from pathlib import Path

import cv2
import numpy as np

from roadtorch.base.atomic import atomic_write, write_error
from roadtorch.base.errors import InputError
from roadtorch.detectors.detection import Detection
from roadtorch.inputs.item import Item
from roadtorch.inputs.video import ffmpeg_reason, import_av

TICKS = 60_000
"""Ticks per second of time stamps: a multiple of 24, 25, 30 and 30000/1001, and within MPEG-4 part
2's limit of 65,535."""

MAX_GAP = 600
"""Seconds that a frame lasts at most; ours: between a slow time lapse and the pause of a recording.
MP4 has 32 bits for the ticks of a frame, ten hours."""

MIN_RATE, MAX_RATE = Fraction(1, 1001), Fraction(1000)
"""Frames per second that a stream declares: a video written at a rate of 1e6 has no frames."""

DEFAULT_RATE = 10.0  # frames per second of a source without time stamps or rate

ENCODERS = {
    "libx264": {"preset": "veryfast", "crf": "20", "x264-params": "mbtree=0"},
    "mpeg4": {"qscale": "3"},
}
"""Encoders by preference, with options; ours: outlines stay sharp. With its macroblock tree, the
bytes of x264 depend on the memory layout of the process."""

Renderer = Callable[[Detection], np.ndarray]
"""Draws a detection: uint8 RGB, shape (H, W, 3), or grey, shape (H, W)."""


class VideoWriter:
    """A video that is written frame by frame, and renamed to its path when it is closed.

    path: of the MP4 file. draw: returns the pixels of a detection. rate: declared frames a second.
    Time stamps start at 0; gaps above ``MAX_GAP`` are cut, with a warning. Frames get the size of
    the first, odd sides repeat their last pixels. One thread encodes: bytes do not depend on cores.
    """

    def __init__(self, path: Path, draw: Renderer, rate: float | None = None) -> None:
        self.path = path
        self._draw, self._rate = draw, rate or DEFAULT_RATE
        self._size: tuple[int, int] | None = None
        self._first, self._last = 0.0, -1
        self._gaps = 0
        self._open = ExitStack()

    def write(self, item: Item, detection: Detection) -> Mapping[str, str]:
        """Encode a frame; InputError when the file cannot be written."""
        pixels, seconds = self._draw(detection), item.clock
        with self._report_errors():
            if self._size is None:
                self._open_stream(pixels, seconds)
            pixels = self._fit(pixels)
            kind = "gray" if pixels.ndim == 2 else "rgb24"
            frame = self._av.VideoFrame.from_ndarray(pixels, kind)
            frame = self._reformatter.reformat(frame, format="yuv420p")
            self._shorten_gap(seconds - self._first - self._last / TICKS, item.number)
            self._last = max(round((seconds - self._first) * TICKS), self._last + 1)
            frame.pts, frame.time_base = self._last, self._stream.time_base
            self._container.mux(self._stream.encode(frame))
        return {}

    def close(self) -> None:
        """Finish the video; no file is created without a frame. Raises as ``write``."""
        with self._report_errors(), self._open:
            if self._size is not None:
                self._size = None
                try:
                    self._container.mux(self._stream.encode(None))
                finally:
                    self._container.close()

    @contextmanager
    def _report_errors(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise write_error(self.path, error) from None
        except import_av().FFmpegError as error:
            problem = f"cannot be encoded: {ffmpeg_reason(error)}"
            raise InputError(self.path, problem, "save files of each frame") from None

    def _shorten_gap(self, gap: float, number: int) -> None:
        """Move the start of the video, so that no frame lasts longer than ``MAX_GAP``."""
        if gap <= MAX_GAP:
            return
        self._first += gap - MAX_GAP
        self._gaps += 1
        if self._gaps == 1:
            problem = f"the gap of {gap:.0f} seconds before frame {number} lasts {MAX_GAP} here"
            warnings.warn(f"{self.path.name}: {problem} (as do all longer ones)", stacklevel=3)

    def _open_stream(self, pixels: np.ndarray, seconds: float) -> None:
        self._av = import_av()
        # Reused: it caches its tables.
        self._reformatter = self._av.video.reformatter.VideoReformatter()
        with ExitStack() as stack:
            temporary = stack.enter_context(atomic_write(self.path))
            self._container = self._av.open(str(temporary), "w", format="mp4")
            self._stream = self._encoder(pixels.shape[1], pixels.shape[0])
            self._open = stack.pop_all()
        self._size, self._first = (pixels.shape[1], pixels.shape[0]), seconds

    def _encoder(self, width: int, height: int):
        name = next(name for name in ENCODERS if name in self._av.codecs_available)
        if name != "libx264":
            message = f"{self.path.name}: PyAV has no libx264 here; written as {name}"
            warnings.warn(message, stacklevel=2)
        rate = Fraction(self._rate).limit_denominator(1001)
        rate = min(max(rate, MIN_RATE), MAX_RATE)
        stream = self._container.add_stream(name, rate=rate, options=ENCODERS[name])
        stream.width, stream.height = width + width % 2, height + height % 2
        stream.pix_fmt = "yuv420p"
        stream.time_base = stream.codec_context.time_base = Fraction(1, TICKS)
        stream.codec_context.thread_count = 1
        return stream

    def _fit(self, pixels: np.ndarray) -> np.ndarray:
        """Resize pixels to the first frame's size, and pad odd sides."""
        size = self._size
        if size is not None and (pixels.shape[1], pixels.shape[0]) != size:
            pixels = cv2.resize(pixels, size, interpolation=cv2.INTER_AREA)
        below, right = pixels.shape[0] % 2, pixels.shape[1] % 2
        if below or right:
            pixels = cv2.copyMakeBorder(pixels, 0, below, 0, right, cv2.BORDER_REPLICATE)
        return np.ascontiguousarray(pixels)
