"""Images in and out: decoding to RGB tensors, encoding maps, masks and overlays."""

import io
import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Literal, get_args

import cv2
import numpy as np
import torch
from PIL import Image, ImageDraw, ImageFont, UnidentifiedImageError
from torch import Tensor

from roadtorch.base.atomic import atomic
from roadtorch.base.bounded import read_regular, reason
from roadtorch.base.decoding import (
    MEGAPIXELS_VARIABLE,
    TooLargeError,
    decode,
    pillow_pixels,
)
from roadtorch.base.errors import InputError, fault, lacks_memory, unknown_name
from roadtorch.base.urls import scheme_of, url_bytes, without_password

READABLE = "JPEG, PNG, TIFF, WebP or BMP"

SUFFIXES = (".jpg", ".jpeg", ".png", ".tif", ".tiff", ".webp", ".bmp")  # looked for in folders

# Okabe and Ito, "Color Universal Design" (2008): told apart with every kind of colour vision.
SKY_BLUE = (86, 180, 233)

ORANGE = (230, 159, 0)

TINT = 0.5  # share of the tint's colour inside the mask; ours: the road's texture stays visible

LEVELS = np.repeat(np.arange(256, dtype=np.uint8)[:, None, None], 3, 2)
TINTED = cv2.addWeighted(LEVELS, 1 - TINT, np.full_like(LEVELS, SKY_BLUE), TINT, 0)
"""What each level of each channel becomes inside the mask: uint8 (256,1,3)."""

OUTLINE = 1 / 240  # the outline's width as a share of the shorter side; ours

LETTERS = 14  # pixels that a caption's letters have at least; ours: legible in an image of 320

JPEG_OPTIONS = (cv2.IMWRITE_JPEG_QUALITY, 92)

MAP_OPTIONS = (cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_RLE)
"""Of PNGs of smooth maps: a quarter smaller than OpenCV's default, and written faster."""

Order = Literal["rgb", "bgr"]
"""The order of colours in an array: OpenCV's is ``bgr``, nearly everybody else's ``rgb``."""

ImageLike = Tensor | np.ndarray | Image.Image | str | os.PathLike[str] | bytes | IO[bytes]
"""What programs have of an image, see ``as_image``."""

# --- in ---------------------------------------------------------------------------------


def read_image(path: str | os.PathLike[str]) -> Tensor:
    """Read an image as float32 RGB (3,H,W) in [0,1], sRGB, upright.

    path: of a file, or, as text, an address of the web (``https://…``).
    JPEG, PNG, TIFF, WebP and BMP; 8 or 16 bits (65535 becomes 1), grey, palette. EXIF
    orientation is applied. Alpha is composited over black: see-through pixels of
    footage are the rims of rectified frames, where no light was measured. Of several
    frames or pages the first is read. Embedded colour profiles are ignored, as the
    papers' sets have none.

    Raises InputError when the file is missing, a folder, a pipe, empty, truncated, damaged
    where the decoder can tell, no image, or has more than 1 GiB or 100 megapixels (the
    environment's ROADTORCH_MAX_MEGAPIXELS says otherwise, up to Pillow's own 178).

        >>> from roadtorch import read_image
        >>> read_image("street.jpg").shape
        torch.Size([3, 240, 320])
    """
    if isinstance(path, str) and scheme_of(path):
        return decode_image(url_bytes(path), without_password(path))
    path = Path(path)
    try:
        data = read_regular(path)
    except FileNotFoundError:
        raise InputError(path, "does not exist", "check the name") from None
    except IsADirectoryError:
        raise InputError(path, "is a folder", "give an image file") from None
    except OSError as error:
        raise InputError(path, f"cannot be read: {error.strerror}", "check the file") from None
    return decode_image(data, path)


def decode_image(data: bytes, origin: object) -> Tensor:
    """The bytes of an image as float32 RGB (3,H,W) in [0,1]: all that ``read_image`` reads.

    origin: what messages call it. Raises InputError as ``read_image`` does.
    """
    if not data:
        raise InputError(origin, "is empty", "replace the file")
    with undecodable(origin):
        return from_pixels(decode(data))


@contextmanager
def undecodable(origin: object) -> Iterator[None]:
    """What goes wrong as an image is decoded in the block, as InputError with that origin."""
    try:
        yield
    except UnidentifiedImageError:
        raise InputError(origin, "is not an image", f"give {READABLE}") from None
    except TooLargeError as error:
        hint = f"make it smaller, or set {MEGAPIXELS_VARIABLE}"
        raise InputError(origin, str(error), hint) from None
    except Exception as error:
        if lacks_memory(error):
            raise fault(origin, error) from None
        problem = f"cannot be decoded: {reason(error)}"
        raise InputError(origin, problem, "replace it, or convert it to PNG") from None


def from_pixels(pixels: np.ndarray) -> Tensor:
    """Pixels (H,W), (H,W,3) RGB or (H,W,4) RGBA to float32 (3,H,W).

    Of uint8 and uint16 the highest value becomes 1; floating point stays as it is.
    """
    levels = 1 if pixels.dtype.kind == "f" else np.iinfo(pixels.dtype).max
    if pixels.ndim == 2:
        pixels = np.broadcast_to(pixels[..., None], (*pixels.shape, 3))
    planes = torch.from_numpy(np.array(pixels.transpose(2, 0, 1), order="C"))
    image = planes[:3].to(torch.float32).div_(levels)
    return image if len(planes) == 3 else image.mul_(planes[3].to(torch.float32).div_(levels))


def as_image(image: ImageLike, order: Order | None = None) -> Tensor:
    """What a program has of an image, as image (3,H,W) in [0,1].

    A tensor (3,H,W) is RGB: floating point stays as it is, uint8 is divided by 255. A NumPy array
    is (H,W) grey, or (H,W,3) or (H,W,4) in the ``order`` of colours that is told, not guessed;
    uint8, uint16 or floating point in [0,1]. A Pillow image is turned and converted as
    ``read_image`` does, which reads a path or URL; so are a file's bytes, and an open file is read
    from where it is. Whether values are in range is for ``detect``.

    Raises InputError for anything else, and as ``read_image`` does; ConfigError for an order that
    is none.
    """
    if order is not None:
        checked_order(order)
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
    """All that is left of an open file; InputError where it gives no bytes."""
    try:
        data = file.read()
    except OSError as error:
        raise InputError("image", f"cannot be read: {reason(error)}", "open it again") from None
    if not isinstance(data, bytes):
        raise InputError("image", "is a file of text", 'open it with "rb"')
    return data


def checked_order(order: Order) -> Order:
    """The order of colours, if it is one; else ConfigError."""
    if order not in get_args(Order):
        raise unknown_name("order of colours", order, get_args(Order))
    return order


def _as_rgb(pixels: np.ndarray, order: Order | None) -> np.ndarray:
    """Pixels (H,W) or (H,W,C), C being 1, 3 or 4, as grey, RGB or RGBA; else InputError."""
    if pixels.dtype not in (np.uint8, np.uint16) and pixels.dtype.kind != "f":
        hint = "give uint8 from 0 to 255, or floating point from 0 to 1"
        raise InputError("image", f"is an array of {pixels.dtype}", hint)
    if pixels.ndim == 2:
        return pixels
    if pixels.ndim != 3 or pixels.shape[2] not in (1, 3, 4):
        problem = f"is an array of the shape {pixels.shape}"
        stack = pixels.ndim == 4
        hint = "give (height, width, 3), or (height, width) if it is grey"
        raise InputError("image", problem, "give all of them to detect_many" if stack else hint)
    if pixels.shape[2] == 1:
        return pixels[..., 0]
    if order is None:
        problem = "is an array whose order of colours is not told"
        hint = (
            'give order="rgb", or order="bgr" if it is from OpenCV; once: load_detector(…, order=…)'
        )
        raise InputError("image", problem, hint)
    if order == "rgb":
        return pixels
    return pixels[..., ::-1] if pixels.shape[2] == 3 else pixels[..., [2, 1, 0, 3]]


# --- out --------------------------------------------------------------------------------


def write_map(path: str | os.PathLike[str], likelihood: Tensor, depth: Literal[8, 16] = 8) -> None:
    """Write a map (H,W) in [0,1] as grey PNG of 8 or 16 bits: round(x · 255 or 65535)."""
    levels, kind = {8: (255, np.uint8), 16: (65535, np.uint16)}[depth]
    grey = likelihood.detach().cpu().to(torch.float64).mul(levels).round()
    _write_encoded(path, ".png", grey.numpy().astype(kind), *MAP_OPTIONS)


def write_mask(path: str | os.PathLike[str], mask: Tensor) -> None:
    """Write a mask bool (H,W) as grey PNG: road 255, the rest 0."""
    _write_encoded(path, ".png", mask.cpu().numpy().astype(np.uint8) * 255, *MAP_OPTIONS)


def write_labels(path: str | os.PathLike[str], labels: Tensor) -> None:
    """Write labels 0…255 of any integer type (H,W) as grey PNG, values unchanged.

    Raises InputError for labels that do not fit one byte.
    """
    if labels.numel() and not (int(labels.min()) >= 0 and int(labels.max()) <= 255):
        raise InputError(path, "labels do not fit one byte", "use labels from 0 to 255")
    _write_encoded(path, ".png", labels.cpu().numpy().astype(np.uint8))


def write_colours(path: str | os.PathLike[str], image: Tensor) -> None:
    """Write an image (3,H,W) in [0,1] as 8-bit RGB PNG."""
    _write_encoded(path, ".png", _bgr(to_pixels(image)))


def write_overlay(
    path: str | os.PathLike[str],
    image: Tensor,
    mask: Tensor,
    ego: Tensor | None = None,
    caption: str = "",
) -> None:
    """Write ``overlay_pixels`` as JPEG."""
    write_pixels(path, overlay_pixels(image, mask, ego, caption))


def overlay_pixels(
    image: Tensor, mask: Tensor, ego: Tensor | None = None, caption: str = ""
) -> np.ndarray:
    """The image (3,H,W) with its mask bool (H,W) as uint8 (H,W,3): a tint and an outline.

    Inside is tinted sky blue, the border is drawn orange on a dark rim, so that it
    shows on pale and on dark road, in colour and in grey print. The ego car bool (H,W) is
    darkened; a caption stands in the upper left corner.
    """
    pixels = to_pixels(image)
    if ego is not None and ego.any():
        pixels[ego.cpu().numpy()] //= 2
    return with_caption(tint_mask(pixels, mask.cpu().numpy()), caption)


def write_jpeg(path: str | os.PathLike[str], image: Tensor) -> None:
    """Write an image (3,H,W) in [0,1] as JPEG, for looking at."""
    write_pixels(path, to_pixels(image))


def write_pixels(path: str | os.PathLike[str], pixels: np.ndarray) -> None:
    """Write pixels uint8 (H,W,3) RGB as PNG where the name ends so, else as JPEG."""
    kind, options = (".png", ()) if os.fspath(path).endswith(".png") else (".jpg", JPEG_OPTIONS)
    _write_encoded(path, kind, _bgr(pixels), *options)


def write_npy(path: str | os.PathLike[str], values: Tensor) -> None:
    """Write a tensor as NumPy file, type and shape unchanged."""
    data = io.BytesIO()
    np.save(data, values.detach().cpu().numpy(), allow_pickle=False)
    with atomic(path) as temporary:
        temporary.write_bytes(
            data.getvalue()
        )  # with getbuffer() a full disk crashes CPython 3.12.1


def tint_mask(pixels: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Pixels uint8 (H,W,3) RGB with a mask bool (H,W) tinted and outlined; a new array."""
    width = max(1, round(min(mask.shape) * OUTLINE))
    inside = mask.astype(np.uint8)
    brush = np.ones((3, 3), np.uint8)
    # A replicated border keeps the outline off the image's own edge.
    wide = cv2.erode(inside, brush, iterations=2 * width, borderType=cv2.BORDER_REPLICATE)
    thin = cv2.erode(inside, brush, iterations=width, borderType=cv2.BORDER_REPLICATE)
    tinted = cv2.LUT(pixels, TINTED)
    result = cv2.copyTo(tinted, inside, pixels.copy())
    flat = result.reshape(-1, 3)
    flat[np.flatnonzero(inside > wide)] = 0
    flat[np.flatnonzero(inside > thin)] = ORANGE
    return result


def with_caption(pixels: np.ndarray, caption: str) -> np.ndarray:
    """Pixels uint8 (H,W,3) with a line of white text on a dark rim, sized with the image."""
    if not caption:
        return pixels
    size = max(LETTERS, round(min(pixels.shape[:2]) / 22))
    band = Image.fromarray(pixels[: 2 * size])
    ImageDraw.Draw(band).text(
        (size // 2, size // 2),
        caption,
        "white",
        ImageFont.load_default(size),
        stroke_width=max(1, size // 12),
        stroke_fill="black",
    )
    return np.concatenate([np.asarray(band), pixels[2 * size :]])


def to_pixels(image: Tensor) -> np.ndarray:
    """An image (3,H,W) in [0,1] as uint8 (H,W,3)."""
    planes = image.detach().mul(255).round_().to(torch.uint8).cpu().numpy()
    return cv2.merge(list(planes))  # three times as fast as a permutation


def _bgr(pixels: np.ndarray) -> np.ndarray:
    """Pixels uint8 (H,W,3) RGB as OpenCV writes them."""
    return cv2.cvtColor(pixels, cv2.COLOR_RGB2BGR)


def png_bytes(pixels: np.ndarray, longest: int) -> bytes:
    """Pixels uint8 (H,W,3) RGB as the bytes of a PNG, made smaller to have that side at most."""
    height, width = pixels.shape[:2]
    scale = longest / max(height, width)
    if scale < 1:
        size = max(1, round(width * scale)), max(1, round(height * scale))
        pixels = cv2.resize(pixels, size, interpolation=cv2.INTER_AREA)
    return bytes(_encoded(".png", _bgr(pixels)))


def _encoded(kind: str, pixels: np.ndarray, *options: int) -> memoryview:
    return cv2.imencode(kind, np.ascontiguousarray(pixels), list(options))[1].data


def _write_encoded(
    path: str | os.PathLike[str], kind: str, pixels: np.ndarray, *options: int
) -> None:
    encoded = _encoded(kind, pixels, *options)
    with atomic(path) as temporary:
        temporary.write_bytes(encoded)
