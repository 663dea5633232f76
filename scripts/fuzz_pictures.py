"""Pictures for ``scripts/fuzz.py``: rendered, of every format, still and animated."""

import io
import random
from pathlib import Path

import numpy as np
from PIL import Image

from roadtorch.io.image import read_image
from roadtorch.scenes.street import render_scene
from scripts.fuzz_bytes import BYTES, mutated

MODES = ("RGB", "L", "P", "RGBA", "1", "CMYK", "I;16")
FORMATS = ("JPEG", "PNG", "TIFF", "WEBP", "BMP")
ANIMATED = ("PNG", "WEBP", "TIFF", "GIF")
SIZES = ((64, 48), (1, 1), (1, 90), (90, 1), (320, 240))
ENDS = ("big", "little")

_SCENES: dict[int, Image.Image] = {}


def scene(seed: int) -> Image.Image:
    """A rendered street; rendered once."""
    if seed not in _SCENES:
        pixels = render_scene(seed).image.mul(255).round().byte().permute(1, 2, 0).numpy()
        _SCENES[seed] = Image.fromarray(np.ascontiguousarray(pixels))
    return _SCENES[seed]


def whole_picture(draw: random.Random) -> bytes:
    """A picture of a random size, mode, format and EXIF orientation; one in six has frames."""
    size = draw.choice(SIZES)
    if draw.random() < 1 / 6:
        return _animation(draw, size)
    picture = scene(draw.randrange(4)).resize(size)
    kind = draw.choice(FORMATS)
    exif = Image.Exif()
    exif[274] = draw.randrange(12)
    options = draw.choice([{}, {"exif": exif}, {"exif": draw.randbytes(60)}, {"progressive": True}])
    for mode in (draw.choice(MODES), "RGB"):
        data = io.BytesIO()
        try:
            picture.convert(mode).save(data, kind, **options)
            return data.getvalue()
        except Exception:  # Pillow raises anything
            options = {}  # this format knows no such mode or metadata
    data = io.BytesIO()
    picture.save(data, "PNG")
    return data.getvalue()


def _animation(draw: random.Random, size: tuple[int, int]) -> bytes:
    """Two to five frames or pages, of sizes of their own where the format allows it."""
    kind = draw.choice(ANIMATED)
    sizes = [draw.choice(SIZES) if kind == "TIFF" else size for _ in range(draw.randint(2, 5))]
    mode = draw.choice(("RGB", "L", "P") if kind == "TIFF" else ("RGB", "RGBA"))
    frames = [scene(draw.randrange(4)).resize(each).convert(mode) for each in sizes]
    data = io.BytesIO()
    frames[0].save(data, kind, save_all=True, append_images=frames[1:])
    return data.getvalue()


def resize(data: bytearray, draw: random.Random) -> None:
    """Write large or odd numbers where a format keeps width and height."""
    places = {b"\xff\xd8": _frame_header(data), b"\x89P": 18, b"BM": 18, b"RI": 26}
    at = places.get(bytes(data[:2]), draw.randrange(len(data)))
    number = draw.choice((0, 1, 3, 255, 13_000, 30_000, 65_535)).to_bytes(2, draw.choice(ENDS))
    data[at : at + 2] = number


def _frame_header(data: bytearray) -> int:
    """Where a JPEG has its height."""
    return max(data.find(b"\xff\xc0"), data.find(b"\xff\xc2"), 0) + 5


def make_picture(folder: Path, draw: random.Random) -> Path:
    """A picture that was tampered with."""
    path = folder / "picture.bin"
    path.write_bytes(mutated(whole_picture(draw), draw, (*BYTES, resize)))
    return path


def read_picture(path: Path) -> bool:
    """Read it; whether the values are in [0,1]."""
    image = read_image(path)
    return bool((image >= 0).all() and (image <= 1).all()) and image.ndim == 3
