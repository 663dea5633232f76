"""Videos as results: H.264 in MP4 where the encoder is there, with the frames' time stamps; GIF."""

import warnings
from contextlib import ExitStack
from fractions import Fraction
from io import BytesIO
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from roadtorch.io.atomic import RoomyFile, atomic, unwritable
from roadtorch.sources.video import import_av

TICKS = 60_000
"""Time stamps a second: a multiple of 24, 25, 30 and 30000/1001; MPEG-4 part 2 has up to 65,535."""

ROOM = 2**22
"""Bytes held for the end of a video, should the disk become full: its table of frames, of about 20
bytes each, hence two hours at 30 frames a second."""

USUAL_RATE = 10.0  # frames a second where neither a clock nor a rate is known

ENCODERS = {
    "libx264": {"preset": "veryfast", "crf": "20", "x264-params": "mbtree=0"},
    "mpeg4": {"qscale": "3"},
}
"""By preference, with options; ours: the outline stays sharp. With its macroblock tree x264 gives
other bytes from run to run, as memory happens to lie."""


GIF_WIDTH = 480  # pixels at most

GIF_RATE = 10  # frames a second

GIF_SECONDS = 60.0
"""At most; its frames are held in memory until the end."""

GIF_COLOURS = 128


class VideoSink:
    """A video that is written frame by frame, and has its name once it is closed.

    path: of the MP4 file; rate: frames a second, where they have no time stamps. The first frame
    is at 0 seconds, the others as far behind it as they were; all have the size of the first,
    padded to even sides by repeating the last row or column. One thread encodes: the bytes do not
    depend on the machine's number of cores.
    """

    def __init__(self, path: Path, rate: float | None = None) -> None:
        self.path = path
        self._rate = rate or USUAL_RATE
        self._size: tuple[int, int] | None = None
        self._first, self._last = 0.0, -1
        self._open = ExitStack()

    def write(self, pixels: np.ndarray, seconds: float | None) -> None:
        """Add pixels uint8 (H,W,3) RGB or (H,W) grey; InputError when the disk is full.

        seconds: when it was taken; without, it follows at the rate.
        """
        if seconds is None:
            behind = self._last / TICKS + 1 / self._rate
            seconds = 0.0 if self._size is None else self._first + behind
        if self._size is None:
            self._begin(pixels, seconds)
        pixels = self._fitted(pixels)
        kind = "gray" if pixels.ndim == 2 else "rgb24"
        frame = self._av.VideoFrame.from_ndarray(pixels, kind).reformat(format="yuv420p")
        self._last = max(round((seconds - self._first) * TICKS), self._last + 1)
        frame.pts, frame.time_base = self._last, self._stream.time_base
        self._container.mux(self._stream.encode(frame))
        if (problem := self._file.problem) is not None:
            raise unwritable(self.path, problem, "ends here")

    def close(self) -> None:
        """Finish the video; there is none where no frame was written. InputError on a full disk."""
        with self._open:
            if self._size is not None:
                self._size = None
                try:
                    self._container.mux(self._stream.encode(None))
                finally:
                    self._container.close()
                if self._file.lost is not None:
                    raise self._file.lost

    def _begin(self, pixels: np.ndarray, seconds: float) -> None:
        self._av = import_av()
        with ExitStack() as stack:
            temporary = stack.enter_context(atomic(self.path))
            self._file = RoomyFile(temporary, "wb", ROOM)
            stack.callback(self._file.close)
            self._container = self._av.open(self._file, "w", format="mp4")
            self._stream = self._encoder(pixels.shape[1], pixels.shape[0])
            self._open = stack.pop_all()
        self._size, self._first = (pixels.shape[1], pixels.shape[0]), seconds

    def _encoder(self, width: int, height: int):
        name = next(name for name in ENCODERS if name in self._av.codecs_available)
        if name != "libx264":
            what = f"{self.path.name}: PyAV has no libx264 here; written as {name}"
            warnings.warn(what, stacklevel=2)
        rate = Fraction(self._rate).limit_denominator(1001)
        stream = self._container.add_stream(name, rate=rate, options=ENCODERS[name])
        stream.width, stream.height = width + width % 2, height + height % 2
        stream.pix_fmt = "yuv420p"
        stream.time_base = stream.codec_context.time_base = Fraction(1, TICKS)
        stream.codec_context.thread_count = 1
        return stream

    def _fitted(self, pixels: np.ndarray) -> np.ndarray:
        """Pixels at the size of the first frame, with even sides."""
        size = self._size
        if size is not None and (pixels.shape[1], pixels.shape[0]) != size:
            pixels = cv2.resize(pixels, size, interpolation=cv2.INTER_AREA)
        below, right = pixels.shape[0] % 2, pixels.shape[1] % 2
        if below or right:
            pixels = cv2.copyMakeBorder(pixels, 0, below, 0, right, cv2.BORDER_REPLICATE)
        return np.ascontiguousarray(pixels)


class GifSink:
    """The frames from ``start`` to ``end`` seconds, at most 480 pixels wide and ten a second."""

    def __init__(self, path: Path, start: float, end: float) -> None:
        self.path = path
        self._start, self._end = start, end
        self._frames: list[Image.Image] = []
        self._seconds: list[float] = []

    def write(self, pixels: np.ndarray, seconds: float | None) -> None:
        """Look at pixels uint8 (H,W,3) RGB that were taken at so many seconds; without, never."""
        if seconds is None:
            return
        due = self._seconds[-1] + 1 / GIF_RATE if self._seconds else self._start
        if not (self._start <= seconds < self._end and seconds >= due - 0.2 / GIF_RATE):
            return
        height, width = pixels.shape[:2]
        if width > GIF_WIDTH:
            size = GIF_WIDTH, max(1, round(height * GIF_WIDTH / width))
            pixels = cv2.resize(pixels, size, interpolation=cv2.INTER_AREA)
        picture = Image.fromarray(pixels).quantize(GIF_COLOURS, dither=Image.Dither.NONE)
        self._frames.append(picture)
        self._seconds.append(seconds)

    def close(self) -> None:
        """Write the file; there is none where no frame lies in the stretch."""
        if not self._frames:
            return
        steps = np.diff([*self._seconds, self._seconds[-1] + 1 / GIF_RATE])
        durations = [max(20, round(float(step) * 100) * 10) for step in steps]  # whole 10 ms
        first, *others = self._frames
        self._frames = []
        data = BytesIO()  # to a file that it knows Pillow writes past Python: no number of errors
        with atomic(self.path) as temporary:
            first.save(
                data,
                format="GIF",
                save_all=True,
                append_images=others,
                duration=durations,
                loop=0,
            )
            temporary.write_bytes(data.getvalue())
