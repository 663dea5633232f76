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
        stream.codec_context.thread_count = 1  # bytes do not depend on the number of cores
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


def write_tracks(
    path: Path, sizes: Sequence[tuple[int, int]] = (), sound: float = 0.0, begin: float = 0.0
) -> Path:
    """Write a track of one second, from ``begin`` on, for each size (height, width), and sound."""
    with av.open(str(path), "w") as container:
        streams = [container.add_stream("libx264", rate=10) for _ in sizes]
        for stream, (stream.height, stream.width) in zip(streams, sizes, strict=True):
            stream.pix_fmt = "yuv420p"
        tone = container.add_stream("aac", rate=8000) if sound else None
        for stream in streams:
            for number in range(10):
                pixels = street_pixels(number % 3, stream.height, stream.width)
                frame = av.VideoFrame.from_ndarray(pixels, "rgb24").reformat(format="yuv420p")
                frame.pts, frame.time_base = number + round(begin * 10), Fraction(1, 10)
                container.mux(stream.encode(frame))
            container.mux(stream.encode(None))
        if tone is not None:
            silence = np.zeros((1, round(sound * 8000)), np.float32)
            frame = av.AudioFrame.from_ndarray(silence, "fltp", "mono")
            frame.rate, frame.pts = 8000, 0
            container.mux(tone.encode(frame))
            container.mux(tone.encode(None))
    return path


def hide_frames(path: Path, source: Path, hidden: int) -> Path:
    """Copy a video of ten frames a second to MP4, with an edit list that hides the first frames."""
    options = {"avoid_negative_ts": "disabled"}
    with av.open(str(source)) as video, av.open(str(path), "w", options=options) as container:
        stream = container.add_stream_from_template(video.streams.video[0])
        for packet in video.demux(video=0):
            if packet.size and packet.pts is not None and packet.dts is not None:
                shift = round(hidden / 10 / packet.time_base)
                packet.pts, packet.dts, packet.stream = (
                    packet.pts - shift,
                    packet.dts - shift,
                    stream,
                )
                container.mux(packet)
    return path


def read_frame_times(path: Path) -> list[float]:
    """Read the times of a video's frames, in seconds."""
    with av.open(str(path)) as container:
        return [float(frame.time or 0) for frame in container.decode(video=0)]


def read_frame_pixels(path: Path) -> list[np.ndarray]:
    """Read the frames of a video as uint8 (H, W, 3)."""
    with av.open(str(path)) as container:
        return [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
