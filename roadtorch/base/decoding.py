"""Decoding of image files to pixels, with bounds on their size."""

import io
import os
import re
import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager

import cv2
import numpy as np
from PIL import Image, ImageFile, ImageOps
from PIL.ExifTags import Base as ExifTag

PILLOW_FORMATS = ("JPEG", "PNG", "TIFF", "WEBP", "BMP")
FORMAT_START = rb"\xff\xd8\xff|\x89PNG\r\n|II\*\0|MM\0\*|RIFF....WEBP|BM....\0\0\0\0"

MAX_MEGAPIXELS = 100
"""Default limit of an image, see ``MEGAPIXELS_VARIABLE``; ours: fusion takes about 4 GB for it."""

MEGAPIXELS_VARIABLE = "ROADTORCH_MAX_MEGAPIXELS"

MAX_IMAGE_SIDE = 2**20
"""Pixels; ours: Pillow's time for a row grows with the square of its length, half a minute for one
of 16 megapixels."""

PILLOW_MAX_MEGAPIXELS = 178  # Pillow opens nothing larger

# Tags and values of TIFF 6.0
BITS_PER_SAMPLE, PHOTOMETRIC, SAMPLES_PER_PIXEL, PLANAR_CONFIGURATION = 258, 262, 277, 284
EXTRA_SAMPLES, SAMPLE_FORMAT = 338, 339
BLACK_IS_ZERO, RGB, UNSIGNED, ALPHA = 1, 2, 1, 2

PNG_DEPTH = 24  # offset of the bit depth in a PNG

_WARNING_FILTERS, _TRUNCATED = threading.RLock(), threading.RLock()


class TooLargeError(ValueError):
    """An image that declares more pixels than are allowed."""


@contextmanager
def refuse_truncated() -> Iterator[None]:
    """Let Pillow refuse truncated images inside the block, whatever another package has set."""
    with _TRUNCATED:
        allowed, ImageFile.LOAD_TRUNCATED_IMAGES = ImageFile.LOAD_TRUNCATED_IMAGES, False
        try:
            yield
        finally:
            ImageFile.LOAD_TRUNCATED_IMAGES = allowed


@refuse_truncated()
def decode_pixels(data: bytes) -> np.ndarray:
    """Decode an image to upright pixels: uint8 or uint16, (H, W), (H, W, 3) RGB or (H, W, 4) RGBA.

    OpenCV decodes 16 bits, Pillow the rest. Raises TooLargeError before anything is decoded, and
    whatever the decoders raise for other bytes.
    """
    image = open_image(data)
    if image.format == "PNG":
        image.verify()  # checks every chunk, and closes the image
        image = open_image(data)
        if data[PNG_DEPTH] == 16:
            return _apply_orientation(_decode_with_opencv(data), image)
    if image.format == "TIFF" and _is_16_bit_tiff(image):
        pixels = _decode_with_opencv(data)  # which applies the orientation of TIFFs itself
        has_alpha = _tiff_tag(image, EXTRA_SAMPLES)[0] == ALPHA
        return pixels if pixels.ndim == 2 or has_alpha else pixels[..., :3]
    return pillow_pixels(image)


def open_image(data: bytes) -> Image.Image:
    """Open an image with Pillow, without decoding it.

    Raises TooLargeError for more pixels than allowed, ValueError for a side longer than
    ``MAX_IMAGE_SIDE``, UnidentifiedImageError and others of Pillow's for other bytes.
    """
    try:
        with suppress_warnings():
            image = Image.open(io.BytesIO(data), formats=PILLOW_FORMATS)
    except Image.DecompressionBombError:
        limit = min(PILLOW_MAX_MEGAPIXELS, max_megapixels())
        raise TooLargeError(f"has more than {limit:g} megapixels") from None
    check_pixels(*image.size)
    if max(image.size) > MAX_IMAGE_SIDE:
        raise ValueError(f"a side of {max(image.size)} pixels, more than {MAX_IMAGE_SIDE}")
    return image


def is_image_start(data: bytes) -> bool:
    """Return whether a file's first bytes are those of a format that is read."""
    return re.match(FORMAT_START, data, re.DOTALL) is not None


def check_pixels(width: int, height: int) -> None:
    """Raise TooLargeError for an image of any source with more pixels than are allowed."""
    if width * height > max_megapixels() * 1e6:
        size = f"has {width} by {height} pixels"
        raise TooLargeError(f"{size}, more than {max_megapixels():g} megapixels")


def max_megapixels() -> float:
    """Return MEGAPIXELS_VARIABLE, or MAX_MEGAPIXELS if it is not set; ValueError if not above 0."""
    text = os.environ.get(MEGAPIXELS_VARIABLE, str(MAX_MEGAPIXELS))
    try:
        limit = float(text)
    except ValueError:
        limit = 0.0
    if not limit > 0:
        raise ValueError(f"{MEGAPIXELS_VARIABLE} is {text!r}, not a number above 0")
    return limit


@contextmanager
def suppress_warnings() -> Iterator[None]:
    """Ignore warnings of decoders inside the block, even where the filters make them errors."""
    with _WARNING_FILTERS, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


@contextmanager
def silence_opencv() -> Iterator[None]:
    """Keep OpenCV from writing warnings to stderr inside the block."""
    log = cv2.utils.logging
    level = log.getLogLevel()
    log.setLogLevel(log.LOG_LEVEL_SILENT)
    try:
        yield
    finally:
        log.setLogLevel(level)


# --- pixels -----------------------------------------------------------------------------


def turn_upright(image: Image.Image) -> Image.Image:
    """Decode an image and turn it by its EXIF orientation, unless its metadata are damaged."""
    image.load()
    with suppress_warnings():
        try:
            return ImageOps.exif_transpose(image)
        except Exception:
            return image  # damaged metadata is no damage of the image


def upright_size(image: Image.Image) -> tuple[int, int]:
    """Return (height, width) of an image, not decoded yet, as ``turn_upright`` will have it.

    Pillow already gives the upright size of a TIFF.
    """
    is_turned = image.format != "TIFF" and _read_orientation(image) in (5, 6, 7, 8)
    return (image.width, image.height) if is_turned else (image.height, image.width)


@refuse_truncated()
def pillow_pixels(image: Image.Image) -> np.ndarray:
    """Return the pixels of a Pillow image, upright: uint8 RGB or RGBA, or uint16 (H, W).

    Raises ValueError for 32 bits, whose white level is undefined, and whatever Pillow raises.
    """
    upright = turn_upright(image)
    with suppress_warnings():
        if upright.mode in ("I", "F"):
            raise ValueError(f"Pillow mode {upright.mode} has no defined white level")
        if upright.mode.startswith("I;16"):
            return np.array(upright).astype(np.uint16)
        mode = "RGBA" if upright.has_transparency_data else "RGB"
        return np.asarray(upright if upright.mode == mode else upright.convert(mode))


def _decode_with_opencv(data: bytes) -> np.ndarray:
    """Decode with OpenCV to RGB or RGBA; grey stays (H, W)."""
    with silence_opencv():
        pixels = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    if pixels is None:
        raise ValueError("the pixels are damaged")
    if pixels.ndim == 3 and pixels.shape[2] >= 3:
        pixels[..., :3] = pixels[..., 2::-1].copy()
    return pixels


def _apply_orientation(pixels: np.ndarray, image: Image.Image) -> np.ndarray:
    """Turn pixels (H, W[, C]) upright by the EXIF orientation of their PNG; EXIF 2.3, tag 274."""
    orientation = _read_orientation(image)
    if orientation in (5, 6, 7, 8):
        pixels = pixels.swapaxes(0, 1)
    if orientation in (3, 4, 7, 8):
        pixels = pixels[::-1]
    if orientation in (2, 3, 6, 7):
        pixels = pixels[:, ::-1]
    return pixels


def _read_orientation(image: Image.Image) -> int:
    """Return the EXIF orientation of an image, 1 (upright) where it has none that can be read."""
    with suppress_warnings():
        try:
            return image.getexif().get(ExifTag.Orientation, 1)
        except Exception:
            return 1


def _is_16_bit_tiff(image: Image.Image) -> bool:
    """Return whether a TIFF has 16 bits a sample; raise ValueError for unsupported layouts."""
    bits, colours = set(_tiff_tag(image, BITS_PER_SAMPLE)), _tiff_tag(image, PHOTOMETRIC)[0]
    samples, planar = _tiff_tag(image, SAMPLES_PER_PIXEL)[0], _tiff_tag(image, PLANAR_CONFIGURATION)
    is_deep, is_grey = max(bits) > 8, colours == BLACK_IS_ZERO
    is_one_plane = planar[0] == 1 or samples == 1
    is_supported = set(_tiff_tag(image, SAMPLE_FORMAT)) == {UNSIGNED}
    if is_deep:
        is_grey = is_grey and samples == 1
        is_layout = is_one_plane and (is_grey or colours == RGB)
        is_supported = is_supported and bits == {16} and is_layout
    if not is_supported or not (is_one_plane or colours == RGB):
        raise ValueError("only TIFF of one plane, grey or RGB, 8 or 16 bits, unsigned, is read")
    return is_deep


def _tiff_tag(image: Image.Image, tag: int) -> tuple[int, ...]:
    """Return the values of a TIFF tag, one a sample; (1,) if it is absent, as TIFF 6.0 has it."""
    tags: dict[int, tuple[int, ...] | int | None] = getattr(image, "tag_v2", {})
    value = tags.get(tag)
    return value if isinstance(value, tuple) else (1 if value is None else value,)
