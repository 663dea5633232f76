"""Pictures and videos: what can be read and written here."""

from collections.abc import Sequence
from importlib.util import find_spec

import cv2
import numpy as np

from roadtorch.installation.check import Check
from roadtorch.io.bounded import reason
from roadtorch.io.decoding import decode

SUFFIXES = (".jpg", ".png", ".tif", ".webp", ".bmp")
VIDEO = ("h264", "hevc", "vp9", "av1", "mpeg4", "mjpeg")  # that cameras and archives have


def check_codecs() -> list[Check]:
    """Each format of pictures, written by OpenCV and read as roadtorch reads; then video."""
    return [*map(_picture, SUFFIXES), _video(VIDEO)]


def _picture(suffix: str) -> Check:
    pixels = np.full((16, 24, 3), 128, np.uint8)
    try:
        written, data = cv2.imencode(suffix, pixels)
        read = decode(data.tobytes()) if written else None
    except Exception as problem:  # decoders raise anything
        return _unreadable(suffix, reason(problem))
    if read is None or read.shape != pixels.shape or abs(read.astype(int) - pixels).max() > 2:
        return _unreadable(suffix, "comes back as another picture")
    return Check(suffix, "ok", f"by OpenCV {cv2.__version__}")


def _unreadable(suffix: str, what: str) -> Check:
    return Check(suffix, "broken", what, "install opencv-python-headless and pillow again")


def _video(wanted: Sequence[str]) -> Check:
    remedy = "pip install 'roadtorch[video]'"
    if find_spec("av") is None:
        return Check("video", "missing", "PyAV is not installed", remedy)
    import av

    read = [name for name in wanted if name in av.codecs_available]
    absent = [name for name in wanted if name not in read]
    version = ".".join(map(str, av.library_versions["libavcodec"]))
    writes = "libx264" if "libx264" in av.codecs_available else "mpeg4"
    told = f"PyAV {av.__version__}, libavcodec {version}: reads {' '.join(read)}; writes {writes}"
    return Check("video", "ok", told + (f"; does not read {' '.join(absent)}" if absent else ""))
