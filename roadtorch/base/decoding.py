"""Decoding: the bytes of a picture to its pixels, or the reason why not."""

import ctypes
import io
import logging
import math
import os
import re
import threading
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import IO, Any

import cv2
import numpy as np
import simplejpeg
from PIL import Image, ImageOps
from PIL.ExifTags import Base as ExifTag

FORMATS = ("JPEG", "PNG", "TIFF", "WEBP", "BMP")

MEGAPIXELS = 100
"""The most that a picture may have, unless ``MEGAPIXELS_VARIABLE`` says otherwise; ours: fusion
takes about 4 GB for as many."""

MEGAPIXELS_VARIABLE = "ROADTORCH_MAX_MEGAPIXELS"

MAX_SIDE = 2**20
"""Pixels; ours: Pillow's time for a row grows with the square of its length, half a minute for one
of 16 megapixels."""

PILLOWS_MEGAPIXELS = 178  # Pillow opens nothing larger, whatever we allow

LARGE, BYTES_PER_PIXEL = 2**28, 16
"""Files of more bytes than the first are read only where their header says that their pixels fill
them, at most so many bytes each; ours: four samples of 16 bits, twice."""

# TIFF 6.0: tags, and values of theirs
BITS_PER_SAMPLE, COMPRESSION, PHOTOMETRIC = 258, 259, 262
SAMPLES, PLANES, COLOUR_MAP, SAMPLE_FORMAT = 277, 284, 320, 339
BLACK_IS_ZERO, RGB, PALETTE, UNSIGNED, FLOATING_POINT, ALPHA = 1, 2, 3, 1, 3, 2
UNCOMPRESSED, DEFLATED = 1, (8, 32946)

# PNG: where the first chunk and its bits a sample are, and the chunks that say what pixels are
PNG_START, PNG_DEPTH = 8, 24
PNG_PIXELS = (b"IHDR", b"PLTE", b"tRNS", b"IDAT", b"IEND")

# What libjpeg says of a JPEG that lacks no pixels: metadata that it does not know, bytes to spare.
_STRANGE_METADATA = re.compile(r"Unknown Adobe color transform|Warning: unknown JFIF")
_LEFT_OVER = re.compile(r"(\d+) extraneous bytes before marker 0xd9")

_WARNING_FILTERS = threading.Lock()


class TooLargeError(ValueError):
    """A picture that declares more pixels than are allowed."""


def decode(data: bytes) -> np.ndarray:
    """The pixels of a picture, upright: uint8 or uint16, (H,W), (H,W,3) RGB or (H,W,4) RGBA.

    libjpeg decodes JPEG, OpenCV what has 16 bits, Pillow the rest. Raises TooLargeError before
    anything is decoded, and whatever the decoders raise for bytes that are no picture.
    """
    with open_picture(data) as header:
        if header.format in ("JPEG", "MPO"):
            return _oriented(_jpeg(data, header.mode), _orientation(header.getexif))
        if header.format == "PNG":
            header.verify()  # checks every chunk, and closes the picture
            plain, exif = _parted(data)
            pixels = _opencv(plain) if data[PNG_DEPTH] == 16 else pillow_pixels(open_picture(plain))
            return _oriented(pixels, _orientation(lambda: _png_exif(header, exif)))
        return _tiff(data, header) if header.format == "TIFF" else pillow_pixels(header)


def open_picture(data: bytes | IO[bytes], formats: tuple[str, ...] = FORMATS) -> Image.Image:
    """A picture opened by Pillow, not decoded yet, of one of the formats.

    Raises TooLargeError for more pixels than allowed, ValueError for more than ``MAX_SIDE`` in
    a row, UnidentifiedImageError and others of Pillow's for what is none.
    """
    try:
        with without_warnings():
            file = io.BytesIO(data) if isinstance(data, bytes) else data
            picture = Image.open(file, formats=formats)
    except Image.DecompressionBombError:
        most = min(PILLOWS_MEGAPIXELS, most_megapixels())
        raise TooLargeError(f"has more than {most:g} megapixels") from None
    check_pixels(*picture.size)
    if max(picture.size) > MAX_SIDE:
        raise ValueError(f"a side of {max(picture.size)} pixels, more than {MAX_SIDE}")
    return picture


def check_pixels(width: int, height: int) -> None:
    """Raises TooLargeError for more pixels than are allowed, in a picture of any source."""
    if width * height > most_megapixels() * 1e6:
        what = f"has {width} by {height} pixels"
        raise TooLargeError(f"{what}, more than {most_megapixels():g} megapixels")


def check_bytes(start: IO[bytes], size: int) -> None:
    """Raises TooLargeError for a file of so many bytes that are not for its pixels.

    start: the file, or as much of it as holds its header. Others are raised as ``open_picture``
    raises them.
    """
    if size > LARGE:  # of WebP Pillow would read all for the header; they are never so large
        width, height = open_picture(start, ("JPEG", "PNG", "TIFF", "BMP")).size
        if size > BYTES_PER_PIXEL * width * height:
            raise TooLargeError(f"has {size:,} bytes for {width} by {height} pixels")


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


@contextmanager
def quiet_opencv() -> Iterator[None]:
    """Within the block OpenCV writes no warnings to stderr; our errors tell it in one line."""
    log = cv2.utils.logging
    before = log.getLogLevel()
    log.setLogLevel(log.LOG_LEVEL_SILENT)
    try:
        yield
    finally:
        log.setLogLevel(before)


# --- JPEG -------------------------------------------------------------------------------


def _jpeg(data: bytes, mode: str) -> np.ndarray:
    """The pixels (H,W,3) of a JPEG; ValueError where libjpeg met damage, or the end too soon.

    Some cameras fill up the end with bytes of one value, others leave out its marker: those are
    no damage. mode: Pillow's.
    """
    colours = "CMYK" if mode == "CMYK" else "RGB"
    try:
        pixels = simplejpeg.decode_jpeg(data, colours)
    except ValueError as problem:
        if not _is_whole(data, str(problem)):
            raise
        pixels = simplejpeg.decode_jpeg(data, colours, strict=False)
    return _opencv(data, cv2.IMREAD_COLOR) if mode == "CMYK" else pixels  # which knows inks


def _is_whole(data: bytes, message: str) -> bool:
    """Whether a JPEG has all of its pixels whatever libjpeg says of it; Pillow raises as well."""
    if message.startswith("Premature end of JPEG"):
        with open_picture(data) as picture:
            picture.load()
        return True
    if left_over := _LEFT_OVER.search(message):
        end = data.rfind(b"\xff\xd9")
        return len(set(data[end - int(left_over[1]) : end])) == 1
    return _STRANGE_METADATA.match(message) is not None


# --- the other formats ------------------------------------------------------------------


def _opencv(data: bytes, mode: int = cv2.IMREAD_UNCHANGED) -> np.ndarray:
    """Decode with OpenCV, as RGB or RGBA, grey stays (H,W)."""
    pixels = cv2.imdecode(np.frombuffer(data, np.uint8), mode | cv2.IMREAD_IGNORE_ORIENTATION)
    if pixels is None:
        raise ValueError("the pixels are damaged")
    if pixels.ndim == 3 and pixels.shape[2] >= 3:
        pixels[..., :3] = pixels[..., 2::-1].copy()
    return pixels


def _parted(data: bytes) -> tuple[bytes, bytes]:
    """A PNG of whole chunks with its first picture alone, and its EXIF, wherever that stands.

    Of the rest libpng talks on stderr.
    """
    kept, exif, at = [data[:PNG_START]], b"", PNG_START
    while at < len(data):
        end = at + 12 + int.from_bytes(data[at : at + 4], "big")
        if data[at + 4 : at + 8] in PNG_PIXELS:
            kept.append(data[at:end])
        elif data[at + 4 : at + 8] == b"eXIf":
            exif = data[at + 8 : end - 4]
        at = end
    return b"".join(kept), exif


def pillow_pixels(picture: Image.Image) -> np.ndarray:
    """The pixels of a picture of Pillow's, upright: uint8 RGB or RGBA, or uint16 (H,W).

    Raises ValueError for 32 bits, whose white nobody has agreed on, and what Pillow raises.
    """
    picture.load()
    with without_warnings():
        upright = ImageOps.exif_transpose(picture)
        if upright.mode in ("I", "F"):
            raise ValueError(f"Pillow's mode {upright.mode} has no agreed white")
        if upright.mode.startswith("I;16"):
            return np.array(upright).astype(np.uint16)
        return np.array(upright.convert("RGBA" if upright.has_transparency_data else "RGB"))


def _tiff(data: bytes, header: Image.Image) -> np.ndarray:
    """Decode a TIFF: tifffile what is deflated or not compressed, Pillow 8 bits, OpenCV the rest.

    Of what is deflated tifffile checks the sums, which the others do not.

    ValueError for one whose black and white would not be scaled right, that lacks strips or
    tiles, and for layouts that these decoders mistake.
    """
    from tifffile import TiffFile

    logging.getLogger("tifffile").addHandler(logging.NullHandler())  # it would talk on stderr,
    with suppress(OSError, AttributeError):  # as would Pillow's libtiff, where that can be found
        ctypes.CDLL(Image.core.__file__).TIFFSetErrorHandler(None)
    if not isinstance(getattr(header, "tag_v2", {}).get(PHOTOMETRIC), int):
        raise ValueError("it does not say whether black is 0 (PhotometricInterpretation)")
    bits = _tiff_tag(header, BITS_PER_SAMPLE)
    if _tiff_tag(header, PLANES)[0] not in (1, 2) or len(bits) > _tiff_tag(header, SAMPLES)[0]:
        raise ValueError("its tags contradict each other")
    is_deep, compression = _is_deep_tiff(header), _tiff_tag(header, COMPRESSION)[0]
    is_plain = compression == UNCOMPRESSED
    photometric = _tiff_tag(header, PHOTOMETRIC)[0]
    # TIFF 6.0 wants 16 bits in a colour map; libtiff, which OpenCV has, knows the maps with 8.
    has_bytes = photometric == PALETTE and max(_tiff_tag(header, COLOUR_MAP)) < 256
    with TiffFile(io.BytesIO(data)) as file:
        page: Any = file.pages.first
        parts = list(zip(page.dataoffsets, page.databytecounts, strict=False))
        if len(parts) != math.prod(page.chunked) or not all(map(all, parts)):
            raise ValueError("it lacks strips or tiles")
        if max(map(sum, parts)) > len(data):
            raise ValueError("the file ends before its pixels do")
        needed = page.imagelength * page.imagewidth * sum(bits)
        if is_plain and 8 * sum(page.databytecounts) < needed:
            raise ValueError("its strips are too short for its pixels")
        if page.planarconfig not in (1, 2):  # it has the tag, without a value
            raise ValueError("its tags contradict each other")
        extra, is_planar = page.extrasamples[:1], page.planarconfig != 1
        is_known = is_plain or compression in DEFLATED
        if is_known and photometric in (BLACK_IS_ZERO, RGB) and page.dtype in (np.uint8, np.uint16):
            return _oriented(_plain_tiff(page), _orientation(header.getexif))
        if is_planar and (is_deep or page.photometric == BLACK_IS_ZERO):
            raise ValueError("compressed TIFF with a plane for each colour is not read")
        if not is_deep and not has_bytes:
            return pillow_pixels(header)
    with quiet_opencv():
        pixels = _opencv(data)  # which turns TIFFs upright itself
    return pixels if pixels.ndim == 2 or extra == (ALPHA,) else pixels[..., :3]


def _plain_tiff(page: Any) -> np.ndarray:
    """The pixels (H,W,3) or (H,W,4) of a page of tifffile's, grey or RGB.

    Alpha that the colours were multiplied with is left out: over black they stay as they are.
    """
    whole = np.empty(page.shaped, page.dtype)  # planes, depth, rows, columns, samples
    for part, (plane, _, top, left, _), _ in page.segments(maxworkers=1):
        place = whole[plane, 0, top:, left:][: part.shape[1], : part.shape[2]]
        place[...] = part[0, : place.shape[0], : place.shape[1]]
    samples = np.moveaxis(whole[:, 0], 0, -1).reshape(*whole.shape[2:4], -1)
    colours = 3 if page.photometric == RGB else 1
    pixels = np.broadcast_to(samples[..., :colours], (*samples.shape[:2], 3))
    alpha = samples[..., colours : colours + 1]
    return np.dstack([pixels, alpha]) if page.extrasamples[:1] == (ALPHA,) else pixels


def _is_deep_tiff(header: Image.Image) -> bool:
    """Whether a TIFF has 16 bits a sample; ValueError where its white would not be scaled right."""
    kinds = set(_tiff_tag(header, SAMPLE_FORMAT))
    bits = _tiff_tag(header, BITS_PER_SAMPLE)
    is_deep = max(bits) > 8
    if FLOATING_POINT in kinds:
        raise ValueError("floating-point TIFF has no agreed white")
    if kinds != {UNSIGNED} or (is_deep and set(bits) != {16}):
        depth = "×".join(map(str, sorted(set(bits))))
        raise ValueError(f"TIFF of {depth} bits a sample is not read, only 8 and 16 without sign")
    if is_deep and _tiff_tag(header, PHOTOMETRIC)[0] not in (BLACK_IS_ZERO, RGB):
        raise ValueError("TIFF of 16 bits is read as grey, black being 0, or as RGB")
    return is_deep


def _tiff_tag(header: Image.Image, tag: int) -> tuple[int, ...]:
    """The values of a TIFF tag, one a sample; (1,) when it is absent, as TIFF 6.0 has it."""
    tags: dict[int, tuple[int, ...] | int | None] = getattr(header, "tag_v2", {})
    value = tags.get(tag)
    return value if isinstance(value, tuple) else (1 if value is None else value,)


# --- which way is up --------------------------------------------------------------------


def _png_exif(header: Image.Image, chunk: bytes) -> Image.Exif:
    """What a PNG's chunk of EXIF says, or, without one, its texts."""
    if chunk:
        header.info["exif"] = chunk
    return Image.Image.getexif(header)  # that of its class would decode the pixels


def _orientation(exif: Callable[[], Image.Exif]) -> int:
    """The EXIF orientation 1…8; 1 when there is none or it makes no sense."""
    with without_warnings():
        try:
            value = exif().get(ExifTag.Orientation, 1)
        except Exception:
            return 1  # a damaged note about the picture is no damage of the picture
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
