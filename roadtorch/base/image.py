"""Reading of images to RGB tensors, and writing of maps, masks and overlays."""

import io
import os
import warnings
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from typing import IO, Literal, get_args

import cv2
import numpy as np
import torch
from PIL import Image, ImageDraw, ImageFont, UnidentifiedImageError
from torch import Tensor

from roadtorch.base.atomic import atomic_write
from roadtorch.base.bounded import read_regular, reason, strip_password, to_printable
from roadtorch.base.decoding import MEGAPIXELS_VARIABLE, TooLargeError, decode_pixels, pillow_pixels
from roadtorch.base.errors import (
    ConfigError,
    InputError,
    is_out_of_memory,
    to_input_error,
    unknown_name_error,
)
from roadtorch.base.urls import read_url, url_scheme

READABLE_FORMATS = "JPEG, PNG, TIFF, WebP or BMP"

IMAGE_SUFFIXES = (".jpg", ".jpeg", ".png", ".tif", ".tiff", ".webp", ".bmp")  # of images in folders

UNREAD_SUFFIXES = (
    *(".jfif", ".jfi", ".jif", ".jpe", ".mpo", ".jp2", ".j2k", ".jpx", ".jxl", ".heic", ".heif"),
    *(".hif", ".avif", ".gif", ".apng", ".ppm", ".pgm", ".pnm", ".exr", ".hdr", ".psd", ".tga"),
    *(".dng", ".cr2", ".cr3", ".nef", ".arw", ".orf", ".rw2", ".raf"),
)
"""Suffixes of other images, which are reported where a folder holds them."""

MAX_LISTED_NAMES = 5  # in a warning

# Okabe and Ito, "Color Universal Design" (2008): distinct for every kind of colour vision.
SKY_BLUE = (86, 180, 233)
ORANGE = (230, 159, 0)

TINT = 0.5  # opacity of the tint inside the mask; ours: the road's texture stays visible

_LEVELS = np.repeat(np.arange(256, dtype=np.uint8)[:, None, None], 3, 2)
TINT_TABLE = cv2.addWeighted(_LEVELS, 1 - TINT, np.full_like(_LEVELS, SKY_BLUE), TINT, 0)
"""Lookup table from the level of a channel to that inside the mask: uint8 (256, 1, 3)."""

MASK_ENDING = ".mask.png"  # of the masks of ``infer``

OUTLINE_WIDTH = 1 / 240  # fraction of the shorter side; ours
MIN_FONT_SIZE = 14  # pixels; ours: legible in an image of 320

JPEG_OPTIONS = (cv2.IMWRITE_JPEG_QUALITY, 92)

PNG_MAP_OPTIONS = (cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_RLE)
"""For smooth maps: a quarter smaller than OpenCV's default, and written faster."""

PNG_MASK_OPTIONS = (*PNG_MAP_OPTIONS, cv2.IMWRITE_PNG_FILTER, cv2.IMWRITE_PNG_FILTER_NONE)
"""For masks: unfiltered, 40 % smaller than filtered."""

ColourOrder = Literal["rgb", "bgr"]
"""Order of the colour channels of an array: OpenCV's is ``bgr``, most others' is ``rgb``."""

ARRAY_DTYPES = (np.uint8, np.uint16, np.float16, np.float32, np.float64)

ImageLike = Tensor | np.ndarray | Image.Image | str | os.PathLike[str] | bytes | IO[bytes]
"""Types of images that ``as_image`` converts."""

# --- reading ----------------------------------------------------------------------------


def read_image(path: str | os.PathLike[str]) -> Tensor:
    """Read an image file.

    JPEG, PNG, TIFF, WebP and BMP; 8 or 16 bits (65535 becomes 1), grey or palette. EXIF orientation
    is applied. Alpha is composited over black: transparent pixels of footage are the borders of
    rectified frames, where no light was measured. Of several frames or pages the first is read.
    Embedded colour profiles are ignored, as the papers' data sets have none.

        >>> from roadtorch import read_image
        >>> read_image("street.jpg").shape
        torch.Size([3, 240, 320])

    Args:
        path: a file or, as text, a web address (``https://…``).

    Returns:
        sRGB in [0, 1], float32, shape (3, H, W).

    Raises:
        InputError: the file is missing, no regular file, empty, no image, truncated, damaged as far
            as the decoder can tell, or larger than 1 GiB or 100 megapixels (or the environment's
            ROADTORCH_MAX_MEGAPIXELS, up to Pillow's 178).
    """
    if isinstance(path, str) and url_scheme(path):
        return decode_image(read_url(path), strip_password(path))
    return decode_image(read_file(Path(path)), Path(path))


def read_file(path: Path) -> bytes:
    """Return the bytes of an image file; InputError if it cannot be read."""
    try:
        return read_regular(path)
    except FileNotFoundError:
        raise InputError(path, "does not exist", "check the name") from None
    except IsADirectoryError:
        raise InputError(path, "is a folder", "give an image file") from None
    except OSError as error:
        raise InputError(path, f"cannot be read: {error.strerror}", "check the file") from None


def warn_of_unread(folder: object, names: Iterable[str]) -> None:
    """Warn of what a folder holds and no command reads: other images, and links to folders."""
    unread = [name for name in names if not name.startswith(".")]
    if unread:
        more = f" and {len(unread) - MAX_LISTED_NAMES} more" * (len(unread) > MAX_LISTED_NAMES)
        listed = f"{', '.join(unread[:MAX_LISTED_NAMES])}{more}"
        hint = f"give links by name; rename or convert images to {READABLE_FORMATS}"
        message = f"{folder}: {len(unread)} left out: {to_printable(listed)} ({hint})"
        warnings.warn(strip_password(message), stacklevel=2)


def decode_image(data: bytes, origin: object) -> Tensor:
    """Decode the bytes of an image file as ``read_image`` does; ``origin`` names it in errors."""
    if not data:
        raise InputError(origin, "is empty", "replace the file")
    with report_decoding_errors(origin):
        return from_pixels(decode_pixels(data))


@contextmanager
def report_decoding_errors(origin: object) -> Iterator[None]:
    """Turn any exception of a decoder in the block into an InputError at ``origin``."""
    try:
        yield
    except UnidentifiedImageError:
        raise InputError(origin, "is not an image", f"give {READABLE_FORMATS}") from None
    except TooLargeError as error:
        hint = f"make it smaller, or set {MEGAPIXELS_VARIABLE}"
        raise InputError(origin, str(error), hint) from None
    except Exception as error:
        if is_out_of_memory(error):
            raise to_input_error(origin, error) from None
        problem = f"cannot be decoded: {reason(error)}"
        raise InputError(origin, problem, "replace it, or convert it to PNG") from None


def from_pixels(pixels: np.ndarray) -> Tensor:
    """Convert an array of pixels to an image.

    Args:
        pixels: grey (H, W), RGB (H, W, 3) or RGBA (H, W, 4); uint8, uint16 or floating point.

    Returns:
        float32, shape (3, H, W); the highest value of an integer type becomes 1.
    """
    levels = 1 if pixels.dtype.kind == "f" else np.iinfo(pixels.dtype).max
    if pixels.ndim == 2:
        pixels = np.broadcast_to(pixels[..., None], (*pixels.shape, 3))
    planes = torch.empty(pixels.shape[2], *pixels.shape[:2])
    for plane, channel in zip(planes, cv2.split(np.ascontiguousarray(pixels)), strict=True):
        plane.copy_(torch.from_numpy(channel)).div_(levels)  # while it is in the cache
    return planes if len(planes) == 3 else planes[:3].mul_(planes[3])


def as_image(image: ImageLike, order: ColourOrder | None = None) -> Tensor:
    """Convert an image of any common type to a tensor.

    Args:
        image: an RGB tensor (3, H, W), floating point (returned as it is) or uint8; a NumPy array
            (H, W) grey, (H, W, 3) or (H, W, 4), uint8, uint16 or floating point in [0, 1]; a Pillow
            image; a path or web address; a file's bytes; an open file, read from its position.
        order: order of the colour channels of a NumPy array, which is not guessed.

    Returns:
        sRGB, shape (3, H, W); ``detect`` checks its range.

    Raises:
        InputError: another type, shape or dtype, and as for ``read_image``.
        ConfigError: an unknown order.
    """
    if order is not None:
        check_order(order)
    if isinstance(image, np.ndarray):
        return from_pixels(_as_rgb(image, order))
    if isinstance(image, Tensor):
        return image.to(torch.float32).div_(255) if image.dtype == torch.uint8 else image
    if isinstance(image, Image.Image):
        try:
            return from_pixels(pillow_pixels(image))
        except Exception as error:
            problem = f"cannot be decoded: {reason(error)}"
            raise InputError("image", problem, "give another one") from None
    if isinstance(image, str | os.PathLike):
        return read_image(image)
    if isinstance(image, bytes):
        return decode_image(image, "image")
    if hasattr(image, "read"):
        return decode_image(_read_bytes(image), "image")
    if image is None:
        raise InputError("image", "is None", "check its path: cv2.imread gives that for a bad one")
    if isinstance(image, Iterable):
        problem = f"is a {type(image).__name__}, not one image"
        raise InputError("image", problem, "give one, or all of them to detect_many")
    hint = "give a path, a NumPy array, a Pillow image or a tensor"
    raise InputError("image", f"is {type(image).__name__}", hint)


def _read_bytes(file: IO[bytes]) -> bytes:
    """Read the rest of an open file; raise InputError if it gives no bytes."""
    try:
        data = file.read()
    except OSError as error:
        raise InputError("image", f"cannot be read: {reason(error)}", "open it again") from None
    if not isinstance(data, bytes):
        raise InputError("image", "is a text file", 'open it with "rb"')
    return data


def check_order(order: ColourOrder) -> ColourOrder:
    """Return an order of colour channels; raise ConfigError if it is unknown."""
    if not isinstance(order, str):
        hint = 'write detect(image, "rgb") or load_detector(name, order="rgb")'
        raise ConfigError("order", f"is {type(order).__name__}", hint)
    if order not in get_args(ColourOrder):
        raise unknown_name_error("colour order", order, get_args(ColourOrder))
    return order


def _as_rgb(pixels: np.ndarray, order: ColourOrder | None) -> np.ndarray:
    """Return pixels (H, W) or (H, W, C) as grey, RGB or RGBA; raise InputError for others."""
    if pixels.dtype not in ARRAY_DTYPES:  # other byte orders and longdouble are unequal to all
        hint = "give uint8 from 0 to 255, or float32 from 0 to 1, in the byte order of this machine"
        raise InputError("image", f"is an array of {pixels.dtype}", hint)
    if not pixels.size:
        raise InputError("image", f"is an empty array of shape {pixels.shape}", "check its bounds")
    if pixels.ndim == 2:
        return pixels
    if pixels.ndim != 3 or pixels.shape[2] not in (1, 3, 4):
        problem = f"is an array of shape {pixels.shape}"
        stack = pixels.ndim == 4
        hint = "give (height, width, 3), or (height, width) if it is grey"
        raise InputError("image", problem, "give all of them to detect_many" if stack else hint)
    if pixels.shape[2] == 1:
        return pixels[..., 0]
    if order is None:
        hint = (
            'give order="rgb", or order="bgr" if it is from OpenCV; once: load_detector(…, order=…)'
        )
        raise InputError("image", "has no colour order", hint)
    if order == "rgb":
        return pixels
    return pixels[..., ::-1] if pixels.shape[2] == 3 else pixels[..., [2, 1, 0, 3]]


# --- writing ----------------------------------------------------------------------------


def write_map(path: str | os.PathLike[str], likelihood: Tensor, depth: Literal[8, 16] = 8) -> None:
    """Write a map in [0, 1], shape (H, W), as grey PNG of 8 or 16 bits: round(x · 255 or 65535)."""
    levels, dtype = {8: (255, np.uint8), 16: (65535, np.uint16)}[depth]
    grey = likelihood.detach().cpu().to(torch.float64, copy=True).mul_(levels).round_()
    _write_encoded(path, ".png", grey.numpy().astype(dtype), *PNG_MAP_OPTIONS)


def write_mask(path: str | os.PathLike[str], mask: Tensor) -> None:
    """Write a mask, bool, shape (H, W), as grey PNG: road 255, the rest 0."""
    _write_encoded(path, ".png", mask.cpu().numpy().astype(np.uint8) * 255, *PNG_MASK_OPTIONS)


def write_labels(path: str | os.PathLike[str], labels: Tensor) -> None:
    """Write integer labels, shape (H, W), as grey PNG; raise InputError beyond 0 to 255."""
    if labels.numel() and not (int(labels.min()) >= 0 and int(labels.max()) <= 255):
        raise InputError(path, "labels do not fit one byte", "use labels from 0 to 255")
    _write_encoded(path, ".png", labels.cpu().numpy().astype(np.uint8))


def overlay_pixels(
    image: Tensor, mask: Tensor, ego: Tensor | None = None, caption: str = ""
) -> np.ndarray:
    """Draw a mask over an image: road is tinted sky blue, with an orange outline on a dark rim.

    The outline shows on light and dark road, in colour and in grey print.

    Args:
        image: sRGB in [0, 1], shape (3, H, W).
        mask: road, bool, shape (H, W).
        ego: ego car, bool, shape (H, W); it is darkened.
        caption: text for the upper left corner.

    Returns:
        RGB pixels, uint8, shape (H, W, 3).
    """
    pixels = to_pixels(image)
    if ego is not None:
        pixels = cv2.copyTo(pixels // 2, ego.cpu().numpy().astype(np.uint8), pixels)
    return draw_caption(tint_mask(pixels, mask.cpu().numpy()), caption)


def write_rgb(path: str | os.PathLike[str], image: Tensor) -> None:
    """Write an image in [0, 1], shape (3, H, W), as PNG if the name ends so, else as JPEG."""
    write_pixels(path, to_pixels(image))


def write_pixels(path: str | os.PathLike[str], pixels: np.ndarray) -> None:
    """Write RGB pixels, uint8, shape (H, W, 3), as PNG if the name ends so, else as JPEG."""
    suffix, options = (".png", ()) if os.fspath(path).endswith(".png") else (".jpg", JPEG_OPTIONS)
    _write_encoded(path, suffix, _to_bgr(pixels), *options)


def write_npy(path: str | os.PathLike[str], values: Tensor) -> None:
    """Write a tensor as NumPy file, dtype and shape unchanged."""
    data = io.BytesIO()
    np.save(data, values.detach().cpu().numpy(), allow_pickle=False)
    with atomic_write(path) as temporary:
        # With getbuffer() a full disk crashes CPython 3.12.1.
        temporary.write_bytes(data.getvalue())


def tint_mask(pixels: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Return RGB pixels, uint8 (H, W, 3), with a mask, bool (H, W), tinted and outlined; a copy."""
    width = max(1, round(min(mask.shape) * OUTLINE_WIDTH))
    inside = mask.astype(np.uint8)
    brush = np.ones((3, 3), np.uint8)
    # A replicated border keeps the outline off the image border.
    wide = cv2.erode(inside, brush, iterations=2 * width, borderType=cv2.BORDER_REPLICATE)
    thin = cv2.erode(inside, brush, iterations=width, borderType=cv2.BORDER_REPLICATE)
    result = cv2.copyTo(cv2.LUT(pixels, TINT_TABLE), inside, pixels.copy())
    flat = result.reshape(-1, 3)
    flat[np.flatnonzero(inside > wide)] = 0
    flat[np.flatnonzero(inside > thin)] = ORANGE
    return result


def draw_caption(pixels: np.ndarray, caption: str) -> np.ndarray:
    """Draw white text with a dark rim, sized with the image, into RGB pixels, uint8 (H, W, 3)."""
    if not caption:
        return pixels
    size = max(MIN_FONT_SIZE, round(min(pixels.shape[:2]) / 22))
    corner = pixels[: 2 * size, : size * (len(caption) + 1)]
    image, rim = Image.fromarray(corner), max(1, size // 12)
    at, font = (size // 2, size // 2), load_font(size)
    ImageDraw.Draw(image).text(at, caption, "white", font, stroke_width=rim, stroke_fill="black")
    corner[:] = np.asarray(image)
    return pixels


load_font = lru_cache(ImageFont.load_default)
"""Return Pillow's font of a size in pixels."""


def to_pixels(image: Tensor) -> np.ndarray:
    """Convert an image in [0, 1], shape (3, H, W), to RGB pixels, uint8, shape (H, W, 3)."""
    planes = image.detach().cpu().to(torch.float32).numpy()
    return cv2.merge([cv2.convertScaleAbs(plane, alpha=255) for plane in planes])  # fast


def _to_bgr(pixels: np.ndarray) -> np.ndarray:
    return cv2.cvtColor(pixels, cv2.COLOR_RGB2BGR)


def shrink_pixels(pixels: np.ndarray, longest: int) -> np.ndarray:
    """Scale pixels, uint8 (H, W, 3), down to sides of ``longest`` at most."""
    height, width = pixels.shape[:2]
    scale = longest / max(height, width)
    if scale >= 1:
        return pixels
    size = max(1, round(width * scale)), max(1, round(height * scale))
    return np.asarray(cv2.resize(pixels, size, interpolation=cv2.INTER_AREA))


def jpeg_bytes(pixels: np.ndarray, quality: int = 95) -> bytes:
    """Encode RGB pixels, uint8 (H, W, 3), as JPEG."""
    return bytes(_encode(".jpg", _to_bgr(pixels), cv2.IMWRITE_JPEG_QUALITY, quality))


def _encode(suffix: str, pixels: np.ndarray, *options: int) -> memoryview:
    return cv2.imencode(suffix, np.ascontiguousarray(pixels), list(options))[1].data


def _write_encoded(
    path: str | os.PathLike[str], suffix: str, pixels: np.ndarray, *options: int
) -> None:
    encoded = _encode(suffix, pixels, *options)
    with atomic_write(path) as temporary:
        temporary.write_bytes(encoded)
