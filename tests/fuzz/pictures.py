"""Pictures as they come, before and after they were tampered with."""

import io
from functools import cache
from pathlib import Path

import numpy as np
from PIL import Image

from roadtorch.base.image import read_image
from roadtorch.testing.scenes import render_scene
from tests.fuzz.tampered import OF_BYTES, Draw, one_of

OF_PICTURES = (*OF_BYTES, "size")
SIZES = ((64, 48), (1, 1), (1, 90), (90, 1), (320, 240))


@cache
def scene(seed: int) -> Image.Image:
    """A rendered street."""
    pixels = render_scene(seed).image.mul(255).round().byte().permute(1, 2, 0).numpy()
    return Image.fromarray(np.ascontiguousarray(pixels))


def whole_picture(draw: Draw) -> bytes:
    """A picture of some size, mode, format and EXIF; one in six has frames."""
    size, data = one_of(draw, *SIZES), io.BytesIO()
    if one_of(draw, *range(6)) == 0:
        frames = [scene(number).resize(size) for number in range(one_of(draw, 2, 5))]
        kind = one_of(draw, "PNG", "WEBP", "TIFF", "GIF")
        frames[0].save(data, kind, save_all=True, append_images=frames[1:])
        return data.getvalue()
    picture = scene(one_of(draw, *range(4))).resize(size)
    exif = Image.Exif()
    exif[274] = one_of(draw, *range(12))
    options = one_of(draw, {}, {"exif": exif}, {"exif": b"no exif"}, {"progressive": True})
    kind = one_of(draw, "JPEG", "PNG", "TIFF", "WEBP", "BMP")
    try:
        mode = one_of(draw, "RGB", "L", "P", "RGBA", "1", "CMYK", "I;16")
        picture.convert(mode).save(data, kind, **options)
    except Exception:  # Pillow raises anything where a format knows no such mode or metadata
        data = io.BytesIO()
        picture.save(data, "PNG")
    return data.getvalue()


def read_picture(path: Path) -> bool:
    image = read_image(path)
    return bool((image >= 0).all() and (image <= 1).all()) and image.ndim == 3
