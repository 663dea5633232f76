"""Decoding: the bytes of an image to its pixels, or the reason why not."""

import io
import os
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
"""The most that an image may have, unless ``MEGAPIXELS_VARIABLE`` says otherwise; ours: fusion
takes about 4 GB for as many."""

MEGAPIXELS_VARIABLE = "ROADTORCH_MAX_MEGAPIXELS"

MAX_SIDE = 2**20
"""Pixels; ours: Pillow's time for a row grows with the square of its length, half a minute for one
of 16 megapixels."""

PILLOWS_MEGAPIXELS = 178  # Pillow opens nothing larger, whatever we allow

# TIFF 6.0: tags, and values of theirs
BITS_PER_SAMPLE, PHOTOMETRIC, SAMPLES, PLANES = 258, 262, 277, 284
EXTRA_SAMPLES, SAMPLE_FORMAT = 338, 339
BLACK_IS_ZERO, RGB, UNSIGNED, ALPHA = 1, 2, 1, 2

PNG_DEPTH = 24  # where a PNG has its bits a sample

_WARNING_FILTERS = threading.Lock()


class TooLargeError(ValueError):
    """An image that declares more pixels than are allowed."""


def decode(data: bytes) -> np.ndarray:
    """Decode an image to upright pixels: uint8 or uint16, (H,W), (H,W,3) RGB or (H,W,4) RGBA.

    OpenCV decodes what has 16 bits, Pillow the rest. Raises TooLargeError before anything is
    decoded, and whatever the decoders raise for bytes that are no image.
    """
    image = open_image(data)
    if image.format == "PNG":
        image.verify()  # checks every chunk, and closes the image
        image = open_image(data)
        if data[PNG_DEPTH] == 16:
            return _turn_upright(_opencv(data), image)
    if image.format == "TIFF" and _is_deep_tiff(image):
        pixels = _opencv(data)  # which turns TIFFs upright itself
        has_alpha = _tiff_tag(image, EXTRA_SAMPLES)[0] == ALPHA
        return pixels if pixels.ndim == 2 or has_alpha else pixels[..., :3]
    return pillow_pixels(image)


def open_image(data: bytes) -> Image.Image:
    """Open an image with Pillow, without decoding it.

    Raises TooLargeError for more pixels than allowed, ValueError for more than ``MAX_SIDE`` in
    a row, UnidentifiedImageError and others of Pillow's for what is none.
    """
    try:
        with without_warnings():
            image = Image.open(io.BytesIO(data), formats=FORMATS)
    except Image.DecompressionBombError:
        most = min(PILLOWS_MEGAPIXELS, most_megapixels())
        raise TooLargeError(f"has more than {most:g} megapixels") from None
    check_pixels(*image.size)
    if max(image.size) > MAX_SIDE:
        raise ValueError(f"a side of {max(image.size)} pixels, more than {MAX_SIDE}")
    return image


def check_pixels(width: int, height: int) -> None:
    """Raises TooLargeError for more pixels than are allowed, in an image of any source."""
    if width * height > most_megapixels() * 1e6:
        problem = f"has {width} by {height} pixels"
        raise TooLargeError(f"{problem}, more than {most_megapixels():g} megapixels")


def most_megapixels() -> float:
    """The bound on an image's pixels: 100 megapixels, or what the environment says.

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


# --- pixels -----------------------------------------------------------------------------


def pillow_pixels(image: Image.Image) -> np.ndarray:
    """Return the pixels of an image of Pillow's, upright: uint8 RGB or RGBA, or uint16 (H,W).

    Raises ValueError for 32 bits, whose white nobody has agreed on, and what Pillow raises.
    """
    image.load()
    with without_warnings():
        try:
            upright = ImageOps.exif_transpose(image)
        except Exception:
            upright = image  # a damaged note about the image is no damage of the image
        if upright.mode in ("I", "F"):
            raise ValueError(f"Pillow's mode {upright.mode} has no agreed white")
        if upright.mode.startswith("I;16"):
            return np.array(upright).astype(np.uint16)
        return np.array(upright.convert("RGBA" if upright.has_transparency_data else "RGB"))


def _opencv(data: bytes) -> np.ndarray:
    """Decode with OpenCV, as RGB or RGBA, grey stays (H,W)."""
    with quiet_opencv():
        pixels = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    if pixels is None:
        raise ValueError("the pixels are damaged")
    if pixels.ndim == 3 and pixels.shape[2] >= 3:
        pixels[..., :3] = pixels[..., 2::-1].copy()
    return pixels


def _turn_upright(pixels: np.ndarray, image: Image.Image) -> np.ndarray:
    """Turn pixels (H,W[,C]) as the EXIF of their PNG says; EXIF 2.3, tag 274."""
    with without_warnings():
        try:
            orientation = image.getexif().get(ExifTag.Orientation, 1)
        except Exception:
            return pixels
    if orientation in (5, 6, 7, 8):
        pixels = pixels.swapaxes(0, 1)
    if orientation in (3, 4, 7, 8):
        pixels = pixels[::-1]
    if orientation in (2, 3, 6, 7):
        pixels = pixels[:, ::-1]
    return pixels


def _is_deep_tiff(image: Image.Image) -> bool:
    """Return whether a TIFF has 16 bits a sample; ValueError for layouts that are misread."""
    bits, colours = set(_tiff_tag(image, BITS_PER_SAMPLE)), _tiff_tag(image, PHOTOMETRIC)[0]
    is_deep, is_grey = max(bits) > 8, colours == BLACK_IS_ZERO
    is_one_plane = _tiff_tag(image, PLANES)[0] == 1 or _tiff_tag(image, SAMPLES)[0] == 1
    is_read = set(_tiff_tag(image, SAMPLE_FORMAT)) == {UNSIGNED}
    if is_deep:
        is_grey = is_grey and _tiff_tag(image, SAMPLES)[0] == 1
        is_read = is_read and bits == {16} and is_one_plane and (is_grey or colours == RGB)
    if not is_read or not (is_one_plane or colours == RGB):
        raise ValueError("TIFF is read in one plane of 8 or 16 bits without sign, grey or RGB")
    return is_deep


def _tiff_tag(image: Image.Image, tag: int) -> tuple[int, ...]:
    """Return the values of a TIFF tag, one a sample; (1,) when it is absent, as TIFF 6.0 has it."""
    tags: dict[int, tuple[int, ...] | int | None] = getattr(image, "tag_v2", {})
    value = tags.get(tag)
    return value if isinstance(value, tuple) else (1 if value is None else value,)
