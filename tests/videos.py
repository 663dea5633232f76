"""Videos of rendered streets, written with PyAV for the tests of all areas."""

from collections.abc import Callable, Sequence
from fractions import Fraction
from pathlib import Path

import av
import numpy as np

from roadtorch.base.image import to_pixels
from tests.streets import scene


def street_pixels(seed: int, height: int = 48, width: int = 64) -> np.ndarray:
    """Render a street as uint8 (H, W, 3)."""
    return to_pixels(scene(seed, height + height % 2, width + width % 2).image)[:height, :width]


def write_video(
    path: Path,
    seconds: Sequence[float] = tuple(number / 10 for number in range(12)),
    size: tuple[int, int] = (48, 64),
    codec: str = "libx264",
    change: Callable[[int, np.ndarray], np.ndarray] = lambda _, pixels: pixels,
    options: dict[str, str] | None = None,
    ticks: int = 1000,
    live: bool = False,
) -> Path:
    """Write a video with a frame at each of the times in seconds; rate 10 without stamps.

    Neighbouring frames are streets of different brightness. size: height and width. ticks: of the
    clock, a second. live: Matroska without a duration.
    """
    header = {"movflags": "faststart"} if path.suffix == ".mp4" else {}
    header |= {"live": "1"} if live else {}
    with av.open(str(path), "w", options=header) as container:
        stream = container.add_stream(codec, rate=10, options=options or {})
        assert isinstance(stream, av.VideoStream)
        stream.height, stream.width = size
        stream.pix_fmt = "yuvj420p" if codec == "mjpeg" else "yuv420p"
        stream.time_base = stream.codec_context.time_base = Fraction(1, ticks)
        for number, at in enumerate(seconds):
            pixels = change(number, street_pixels(number % 3, *size))
            frame = av.VideoFrame.from_ndarray(pixels, "rgb24").reformat(format=stream.pix_fmt)
            frame.pts, frame.time_base = round(at * ticks), Fraction(1, ticks)
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    return path


def write_sound(path: Path) -> Path:
    """Write a file with a second of silence and no images."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream("aac", rate=8000)
        frame = av.AudioFrame.from_ndarray(np.zeros((1, 8000), np.float32), "fltp", "mono")
        frame.rate, frame.pts = 8000, 0
        container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    return path


def read_frame_times(path: Path) -> list[float]:
    """Read the times of a video's frames, in seconds."""
    with av.open(str(path)) as container:
        return [float(frame.time or 0) for frame in container.decode(video=0)]


def read_frame_pixels(path: Path) -> list[np.ndarray]:
    """Read the frames of a video as uint8 (H, W, 3)."""
    with av.open(str(path)) as container:
        return [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
