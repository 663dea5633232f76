"""What is read of whole and of tampered pictures is what others read of them: Pillow and tifffile.

python -m pytest tests/fuzz/test_second_opinion.py                                # some
python -m pytest tests/fuzz/test_second_opinion.py --hypothesis-profile long -s   # thousands
"""

import io
import tempfile
import warnings
from collections import Counter
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image, ImageOps

from roadtorch.base.errors import InputError
from roadtorch.base.image import read_image
from tests.base.test_decoding import SAMPLES, tiff_of_layout
from tests.base.test_image import TURNS
from tests.fuzz.pictures import OF_PICTURES, scene, whole_picture
from tests.fuzz.tampered import Draw, one_of, tampered, unhurried

CLOSE = 1.5 / 255  # on average; decoders round otherwise, and Pillow reads 16 bits of RGB as 8


def whole_tiff(draw: Draw) -> bytes:
    """Of any layout, 8 or 16 bits."""
    colours, samples, extra = one_of(draw, *SAMPLES)
    pixels = np.asarray(scene(one_of(draw, 0, 1)).resize((53, 37)))
    alpha = pixels[..., :1]
    if extra == "assocalpha":  # which colours are multiplied with
        pixels = np.minimum(pixels, alpha)
    pixels = np.dstack([pixels[..., : samples - bool(extra)], alpha])[..., :samples]
    if one_of(draw, 8, 16) == 16:
        pixels = pixels.astype(np.uint16) * 257
    options: dict[str, Any] = one_of(draw, {"rowsperstrip": 10}, {"tile": (16, 16)}, {})
    options |= {"byteorder": one_of(draw, "<", ">"), "compression": one_of(draw, None, "zlib")}
    return tiff_of_layout(pixels, colours, extra, one_of(draw, "contig", "separate"), **options)


def pillows(data: bytes) -> np.ndarray:
    """(H,W,3) in [0,1]."""
    with Image.open(io.BytesIO(data), formats=("JPEG", "PNG", "TIFF", "WEBP", "BMP")) as picture:
        picture.load()
        upright: Image.Image = picture
        with suppress(SyntaxError):  # EXIF that is none
            upright = ImageOps.exif_transpose(picture)
        if upright.mode.startswith("I"):
            return np.repeat(np.array(upright).astype(float)[..., None] / 65535, 3, 2)
        pixels = np.array(upright.convert("RGBA")) / 255
        return pixels[..., :3] * (pixels[..., 3:] if upright.has_transparency_data else 1)


def tifffiles(data: bytes) -> np.ndarray:
    """(H,W,3) in [0,1], of grey and RGB."""
    with tifffile.TiffFile(io.BytesIO(data)) as file:
        page: Any = file.pages.first
        if page.photometric not in (1, 2) or page.dtype not in (np.uint8, np.uint16):
            raise ValueError("another kind")
        pixels = page.asarray(squeeze=False)[:, 0]
        pixels = np.moveaxis(pixels, 0, -1).reshape(*pixels.shape[1:3], -1)
        shares = pixels / np.iinfo(page.dtype).max
        colours = 3 if page.photometric == 2 else 1
        alpha = shares[..., colours : colours + 1] if page.extrasamples[:1] == (2,) else 1
        found = np.broadcast_to(shares[..., :colours] * alpha, (*shares.shape[:2], 3))
        return TURNS.get(page.tags.valueof(274), np.asarray)(found)


def distance(path: Path) -> float:
    """How far an image is from the first opinion on it that there is, on average; 1 without one."""
    image, data = read_image(path).permute(1, 2, 0).numpy(), path.read_bytes()
    for opinion in (tifffiles, pillows) if data[:2] in (b"II", b"MM") else (pillows,):
        try:
            with warnings.catch_warnings(action="ignore"):
                other = opinion(data)
        except Exception:  # decoders of foreign bytes raise anything
            continue
        return float(np.abs(image - other).mean()) if image.shape == other.shape else 1.0
    return 1.0


def test_what_is_read_is_what_others_read() -> None:
    seen: Counter[str] = Counter()

    @unhurried()
    @given(st.data())
    def check(data: st.DataObject) -> None:
        draw = data.draw
        content = whole_tiff(draw) if one_of(draw, 0, 1, 2) == 0 else whole_picture(draw)
        if one_of(draw, *range(8)):
            content = tampered(draw, content, OF_PICTURES)
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder, "picture.bin")
            path.write_bytes(content)
            try:
                apart = distance(path)
            except InputError:
                seen["refused"] += 1
            else:
                seen["read"] += 1
                assert apart < CLOSE

    check()

    print(seen)
    assert min(seen["read"], seen["refused"]) > 0
