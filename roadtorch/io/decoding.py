"""Decoding: the bytes of a picture to its pixels, or the reason why not."""

import io
import os
import re
import sys
import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager

import cv2
import numpy as np
from PIL import Image, ImageOps
from PIL.ExifTags import Base as ExifTag

FORMATS = ("JPEG", "PNG", "TIFF", "WEBP", "BMP")

MEGAPIXELS = 100
"""The most that a picture may have, unless ``MEGAPIXELS_VARIABLE`` says otherwise; ours: fusion
takes about 4 GB for as many."""

MEGAPIXELS_VARIABLE = "ROADTORCH_MAX_MEGAPIXELS"

LONGEST_SIDE = 2**20
"""Pixels; ours: Pillow's time for a row grows with the square of its length, half a minute for one
of 16 megapixels."""

PILLOWS_MEGAPIXELS = 178  # Pillow opens nothing larger, whatever we allow

# TIFF 6.0: tags, and their values that are read with more than 8 bits
BITS_PER_SAMPLE, PHOTOMETRIC, SAMPLE_FORMAT = 258, 262, 339
BLACK_IS_ZERO, RGB, UNSIGNED, FLOATING_POINT = 1, 2, 1, 3

# What libjpeg, libpng, libtiff and OpenCV write to stderr about a picture.
_TOLD = re.compile(
    r"^(Corrupt JPEG|Premature end of JPEG|Inconsistent progression|Invalid SOS|Unknown Adobe"
    r"|Warning: unknown JFIF|libpng |TIFF|imread_|\[ ?(WARN|ERROR|INFO))"
)
_DAMAGE = re.compile(r"^(Corrupt JPEG data: .*|Inconsistent progression .*|Invalid SOS .*)$", re.M)
_LEFT_OVER = re.compile(r"(\d+) extraneous bytes before marker 0xd9")

_WARNING_FILTERS = threading.Lock()
_STDERR = threading.Lock()


class TooLargeError(ValueError):
    """A picture that declares more pixels than are allowed."""


def decode(data: bytes) -> np.ndarray:
    """The pixels of a picture, upright: uint8 or uint16, (H,W), (H,W,3) RGB or (H,W,4) RGBA.

    OpenCV decodes where it is fast or keeps 16 bits, Pillow the rest. Raises TooLargeError before
    anything is decoded, and whatever the decoders raise for bytes that are no picture.
    """
    with open_picture(data) as header:
        if header.format in ("JPEG", "MPO"):
            _check_jpeg_ends(data)
            return _oriented(_jpeg(data), _orientation(header))
        if header.format == "PNG":
            orientation = _orientation(header)
            header.verify()  # checks every chunk; OpenCV fills what is missing with black
            return _oriented(_opencv_told(data, cv2.IMREAD_UNCHANGED)[0], orientation)
        if header.format == "TIFF":
            _check_tiff(header)
        if header.format == "TIFF" and max(_tiff_tag(header, BITS_PER_SAMPLE)) > 8:
            return _opencv_told(data, cv2.IMREAD_UNCHANGED)[0]  # turns TIFFs upright itself
        return pillow_pixels(header)


def open_picture(data: bytes, formats: tuple[str, ...] = FORMATS) -> Image.Image:
    """A picture opened by Pillow, not decoded yet, of one of the formats.

    Raises TooLargeError for more pixels than allowed, ValueError for more than ``LONGEST_SIDE`` in
    a row, UnidentifiedImageError and others of Pillow's for what is none.
    """
    try:
        with without_warnings():
            picture = Image.open(io.BytesIO(data), formats=formats)
    except Image.DecompressionBombError:
        most = min(PILLOWS_MEGAPIXELS, most_megapixels())
        raise TooLargeError(f"has more than {most:g} megapixels") from None
    if picture.width * picture.height > most_megapixels() * 1e6:
        what = f"has {picture.width} by {picture.height} pixels"
        raise TooLargeError(f"{what}, more than {most_megapixels():g} megapixels")
    if max(picture.size) > LONGEST_SIDE:
        raise ValueError(f"a side of {max(picture.size)} pixels, more than {LONGEST_SIDE}")
    return picture


def most_megapixels() -> float:
    """The bound on a picture's pixels: 100 megapixels, or what the environment says.

    Raises ValueError for what is not a number above 0.
    """
    text = os.environ.get(MEGAPIXELS_VARIABLE, str(MEGAPIXELS))
    try:
        most = float(text)
    except ValueError:
        most = 0.0
    if not most > 0:
        raise ValueError(f"{MEGAPIXELS_VARIABLE} is {text!r}, not a number above 0")
    return most


@contextmanager
def without_warnings() -> Iterator[None]:
    """A decoder's warnings, such as Pillow's about metadata, are no failures, even as errors."""
    with _WARNING_FILTERS, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


# --- OpenCV -----------------------------------------------------------------------------


def _opencv_told(data: bytes, mode: int) -> tuple[np.ndarray, str]:
    """Decode with OpenCV, as RGB or RGBA, grey stays (H,W); and what its libraries say of it."""
    with _STDERR, _caught_stderr() as told:
        pixels = cv2.imdecode(np.frombuffer(data, np.uint8), mode)
    if pixels is None:
        raise ValueError("the pixels are damaged")
    if pixels.ndim == 3 and pixels.shape[2] >= 3:
        pixels[..., :3] = pixels[..., 2::-1].copy()
    return pixels, "".join(told)


@contextmanager
def _caught_stderr() -> Iterator[list[str]]:
    """A list that gets what C libraries write to stderr meanwhile; other lines are passed on."""
    told: list[str] = []
    try:
        kept = os.dup(2)
    except OSError:  # it is closed
        yield told
        return
    readable, writable = os.pipe()
    for end in (readable, writable):
        os.set_blocking(end, False)
    os.dup2(writable, 2)
    try:
        yield told
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(writable)
        with os.fdopen(readable, errors="backslashreplace") as pipe:
            lines = pipe.readlines()
        told += [line for line in lines if _TOLD.match(line)]
        if others := "".join(line for line in lines if not _TOLD.match(line)):
            sys.stderr.write(others)


# --- JPEG -------------------------------------------------------------------------------


def _jpeg(data: bytes) -> np.ndarray:
    """Decode a JPEG; ValueError where libjpeg met damage, which it tells on stderr alone.

    Some cameras fill up the end with bytes of one value: those are no damage.
    """
    pixels, told = _opencv_told(data, cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    damage = _DAMAGE.search(told)
    if damage is None:
        return pixels
    left_over = _LEFT_OVER.search(damage[0])
    if left_over:
        end = data.rfind(b"\xff\xd9")
        if len(set(data[end - int(left_over[1]) : end])) == 1:
            return pixels
    raise ValueError(damage[0])


def _check_jpeg_ends(data: bytes) -> None:
    """Raise OSError for a truncated JPEG; libjpeg fills the rest with grey and says nothing.

    Inside compressed data the bytes FF D9 are always the end marker (ITU T.81, B.1.1.2).
    Files of some cameras lack it though all pixels are there: Pillow decides on those.
    """
    if data.find(b"\xff\xd9", _first_scan(data)) < 0:
        with open_picture(data) as picture:
            picture.load()


def _first_scan(data: bytes) -> int:
    """Where the compressed pixels begin: behind the headers, which may hold a thumbnail."""
    at = 2
    while at + 4 <= len(data) and data[at] == 0xFF and data[at + 1] != 0xDA:
        is_fill = data[at + 1] == 0xFF
        at += 1 if is_fill else 2 + int.from_bytes(data[at + 2 : at + 4], "big")
    return at


# --- the other formats ------------------------------------------------------------------


def pillow_pixels(picture: Image.Image) -> np.ndarray:
    """The pixels of a picture of Pillow's, upright: uint8 RGB or RGBA, or uint16 (H,W).

    Raises ValueError for 32 bits, whose white nobody has agreed on, and what Pillow raises.
    """
    with without_warnings():
        picture.load()
        upright = ImageOps.exif_transpose(picture)
        if upright.mode in ("I", "F"):
            raise ValueError(f"Pillow's mode {upright.mode} has no agreed white")
        if upright.mode.startswith("I;16"):
            return np.array(upright).astype(np.uint16)
        return np.array(upright.convert("RGBA" if upright.has_transparency_data else "RGB"))


def _check_tiff(header: Image.Image) -> None:
    """ValueError for a TIFF whose black and white would not be scaled right."""
    kinds = set(_tiff_tag(header, SAMPLE_FORMAT))
    bits = _tiff_tag(header, BITS_PER_SAMPLE)
    if FLOATING_POINT in kinds:
        raise ValueError("floating-point TIFF has no agreed white")
    if kinds != {UNSIGNED} or (max(bits) > 8 and set(bits) != {16}):
        told = "×".join(map(str, sorted(set(bits))))
        raise ValueError(f"TIFF of {told} bits a sample is not read, only 8 and 16 without sign")
    if max(bits) > 8 and _tiff_tag(header, PHOTOMETRIC)[0] not in (BLACK_IS_ZERO, RGB):
        raise ValueError("TIFF of 16 bits is read as grey, black being 0, or as RGB")


def _tiff_tag(header: Image.Image, tag: int) -> tuple[int, ...]:
    """The values of a TIFF tag, one a sample; (1,) when it is absent, as TIFF 6.0 has it."""
    tags: dict[int, tuple[int, ...] | int] = getattr(header, "tag_v2", {})
    value = tags.get(tag, (1,))
    return value if isinstance(value, tuple) else (value,)


# --- which way is up --------------------------------------------------------------------


def _orientation(header: Image.Image) -> int:
    """The EXIF orientation 1…8; 1 when there is none or it makes no sense."""
    exif = Image.Exif()
    with without_warnings():
        try:
            exif.load(header.info.get("exif", b""))
        except Exception:
            return 1  # a damaged note about the picture is no damage of the picture
        value = exif.get(ExifTag.Orientation, 1)
    return value if value in range(1, 9) else 1


def _oriented(pixels: np.ndarray, orientation: int) -> np.ndarray:
    """Turn pixels (H,W[,C]) upright; EXIF 2.3, tag 274: where row 0 and column 0 are."""
    if orientation >= 5:
        pixels = pixels.swapaxes(0, 1)
    if orientation in (3, 4, 7, 8):
        pixels = pixels[::-1]
    if orientation in (2, 3, 6, 7):
        pixels = pixels[:, ::-1]
    return pixels
