"""A stretch of footage as a small animated GIF, for pages that play no video."""

from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from roadtorch.io.atomic import atomic

WIDEST = 480  # pixels

RATE = 10  # frames a second

LONGEST = 60.0
"""Seconds; its frames are held in memory until the end."""

COLOURS = 128


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
        due = self._seconds[-1] + 1 / RATE if self._seconds else self._start
        if not (self._start <= seconds < self._end and seconds >= due - 0.2 / RATE):
            return
        height, width = pixels.shape[:2]
        if width > WIDEST:
            size = WIDEST, max(1, round(height * WIDEST / width))
            pixels = cv2.resize(pixels, size, interpolation=cv2.INTER_AREA)
        picture = Image.fromarray(pixels).quantize(COLOURS, dither=Image.Dither.NONE)
        self._frames.append(picture)
        self._seconds.append(seconds)

    def close(self) -> None:
        """Write the file; there is none where no frame lies in the stretch."""
        if not self._frames:
            return
        steps = np.diff([*self._seconds, self._seconds[-1] + 1 / RATE])
        durations = [max(20, round(float(step) * 100) * 10) for step in steps]  # whole 10 ms
        first, *others = self._frames
        self._frames = []
        with atomic(self.path) as temporary:
            first.save(
                temporary,
                format="GIF",
                save_all=True,
                append_images=others,
                duration=durations,
                loop=0,
            )
