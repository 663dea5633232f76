"""Mutations of bytes, texts, values and images, as damage or malice makes them."""

import io
import json
import re
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from PIL import Image

from roadtorch.base.image import read_image
from roadtorch.testing.scenes import render_scene

USUAL, SOME = 100, 40
"""Default number of examples of hypothesis, and ours instead: each is a file."""

Draw = Callable[[st.SearchStrategy[Any]], Any]

SHORT = (
    *(b"", b"\0", b"\xff", b"\xef\xbb\xbf", b"\r", b"\n\n", b'"', b"'", b'"""', b",", b"=", b":"),
    *(b"NaN", b"1e999", b"-Infinity", b"null", b"true", b"-1", b"0", b"1e308", b"0x", b"1_0"),
    *(b"\\ud800", b"\xed\xa0\x80", b"&lol;", b"<!DOCTYPE a [<!ENTITY b 'c'>]>", b"<![CDATA[", b"#"),
    "ß\N{RIGHT-TO-LEFT OVERRIDE}".encode(),
)
LONG = (*(b"9" * 5_000, b"[" * 3_000, b'{"a":' * 3_000, b"<a>" * 3_000), b"x" * 200_000)
PIECES = st.integers(0, 9).flatmap(lambda at: st.sampled_from(SHORT if at else LONG))
"""Pieces of text that have tripped parsers, ours or others'."""

VALUES = st.sampled_from(
    (
        *(None, True, -1, 0, 1e999, float("nan"), 1e308, 2**63, 10**400, "", "x", "\ud800", "\0"),
        *([], {}, [[]], "y" * 100_000, [0] * 1_000, "/dev/zero", "../../x", "nan", "inf"),
    )
)
"""Values that replace those of a file."""

BYTE_MUTATIONS = ("flip", "edge", "cut", "leave out", "swap", "repeat")
TEXT_MUTATIONS = (*BYTE_MUTATIONS, "insert", "insert", *("word",) * 8, "lines")


def fuzz_settings() -> settings:
    """Return hypothesis settings with the profile's number of examples, fewer by default."""
    count = settings().max_examples
    checks = [HealthCheck.too_slow, HealthCheck.data_too_large]
    return settings(max_examples=count if count > USUAL else SOME, suppress_health_check=checks)


def choose(draw: Draw, *choices: Any) -> Any:
    return draw(st.sampled_from(choices))


def write_file(path: Path, data: bytes) -> Path:
    path.write_bytes(data)
    return path


def mutate(draw: Draw, data: bytes, kinds: tuple[str, ...] = BYTE_MUTATIONS) -> bytes:
    """Apply one to three mutations to bytes."""
    for _ in range(draw(st.integers(1, 3))):
        data = bytes(_mutate_once(draw, bytearray(data), draw(st.sampled_from(kinds)))) or b"\0"
    return data


def _mutate_once(draw: Draw, data: bytearray, kind: str) -> bytearray:
    at, to = draw(st.integers(0, len(data) - 1)), draw(st.integers(0, len(data) - 1))
    end = at + draw(st.integers(1, 200))
    match kind:
        case "flip":
            data[at] ^= 1 << draw(st.integers(0, 7))
        case "edge":  # near the beginning
            data[at % 200] = draw(st.sampled_from((0, 1, 127, 128, 254, 255)))
        case "cut":
            del data[max(1, at) :]
        case "leave out":
            del data[at:end]
        case "swap":
            length = min(end - at, len(data) - max(at, to))
            first, second = data[at : at + length], data[to : to + length]
            data[at : at + length], data[to : to + length] = second, first
        case "repeat":
            data[to:to] = data[at:end]
        case "insert":
            data[at : at + draw(st.sampled_from((0, 0, 1, 5, 20)))] = draw(PIECES)
        case "word":
            words = list(re.finditer(rb"[\w.+-]+", data))
            if words:
                word, substitute = (draw(st.sampled_from(words)) for _ in range(2))
                data[word.start() : word.end()] = draw(st.just(bytes(substitute[0])) | PIECES)
        case "lines":
            lines = data.split(b"\n")
            data = bytearray(b"\n").join(draw(st.lists(st.sampled_from(lines), max_size=9)))
        case "size":
            _resize(draw, data)
    return data


def _resize(draw: Draw, data: bytearray) -> None:
    """Write large or odd numbers where an image format has width and height."""
    of_jpeg = max(data.find(b"\xff\xc0"), data.find(b"\xff\xc2"), 0) + 5
    offsets = {b"\xff\xd8": of_jpeg, b"\x89P": 18, b"BM": 18, b"RI": 26}
    at = offsets.get(bytes(data[:2])) or draw(st.integers(0, len(data) - 1))
    number = draw(st.sampled_from((0, 1, 3, 255, 13_000, 30_000, 65_535)))
    data[at : at + 2] = number.to_bytes(2, draw(st.sampled_from(("big", "little"))))


def mutate_values(draw: Draw, values: Any) -> Any:
    """Replace, remove, wrap or duplicate one part of nested values."""
    if not isinstance(values, dict | list) or not values or draw(st.integers(0, 6)) == 0:
        return draw(VALUES) if draw(st.integers(0, 4)) else [values]
    changed: Any = values.copy()
    key = draw(st.sampled_from(list(values) if isinstance(values, dict) else range(len(values))))
    match draw(st.integers(0, 5)):
        case 0:
            del changed[key]
        case 1 if isinstance(changed, list):
            changed.append(changed[key])
        case 1:
            changed[draw(st.sampled_from(["", "x", "shapes", f"{key} "]))] = changed[key]
        case _:
            changed[key] = mutate_values(draw, changed[key])
    return changed


def mutate_json(draw: Draw, values: Any) -> bytes:
    """Encode mutated values as JSON, sometimes with mutated text."""
    data = json.dumps(mutate_values(draw, values)).encode()
    return mutate(draw, data, TEXT_MUTATIONS) if draw(st.integers(0, 2)) == 0 else data


def mutate_safetensors(draw: Draw, data: bytes) -> bytes:
    """Mutate the bytes of a safetensors file, or its header alone."""
    if draw(st.booleans()):
        return mutate(draw, data)
    end = 8 + int.from_bytes(data[:8], "little")
    header = mutate_json(draw, json.loads(data[8:end]))
    return len(header).to_bytes(8, "little") + header + data[end:]


# --- images ----------------------------------------------------------------------

IMAGE_MUTATIONS = (*BYTE_MUTATIONS, "size")
SIZES = ((64, 48), (1, 1), (1, 90), (90, 1), (320, 240))


@cache
def scene(seed: int) -> Image.Image:
    """Render a street."""
    pixels = render_scene(seed).image.mul(255).round().byte().permute(1, 2, 0).numpy()
    return Image.fromarray(np.ascontiguousarray(pixels))


def encode_scene(draw: Draw) -> bytes:
    """Encode a scene with a random size, mode, format and EXIF; one in six has frames."""
    size, data = choose(draw, *SIZES), io.BytesIO()
    if choose(draw, *range(6)) == 0:
        frames = [scene(number).resize(size) for number in range(choose(draw, 2, 5))]
        kind = choose(draw, "PNG", "WEBP", "TIFF", "GIF")
        frames[0].save(data, kind, save_all=True, append_images=frames[1:])
        return data.getvalue()
    image = scene(choose(draw, *range(4))).resize(size)
    exif = Image.Exif()
    exif[274] = choose(draw, *range(12))
    options = choose(draw, {}, {"exif": exif}, {"exif": b"no exif"}, {"progressive": True})
    kind = choose(draw, "JPEG", "PNG", "TIFF", "WEBP", "BMP")
    try:
        mode = choose(draw, "RGB", "L", "P", "RGBA", "1", "CMYK", "I;16")
        image.convert(mode).save(data, kind, **options)
    except Exception:  # Pillow raises anything where a format knows no such mode or metadata
        data = io.BytesIO()
        image.save(data, "PNG")
    return data.getvalue()


def reads_image(path: Path) -> bool:
    image = read_image(path)
    return bool((image >= 0).all() and (image <= 1).all()) and image.ndim == 3
