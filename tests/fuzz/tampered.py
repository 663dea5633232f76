"""Strategies for what damage and malice make of files: of bytes, texts, values, images."""

import io
import json
import re
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import torch
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from PIL import Image

from roadtorch.base.image import read_image
from roadtorch.testing.scenes import render_scene

USUAL, SOME = 100, 40
"""Examples of hypothesis unless told otherwise, and of ours then: each is a file."""

Draw = Callable[[st.SearchStrategy[Any]], Any]

SHORT = (
    *(b"", b"\0", b"\xff", b"\xef\xbb\xbf", b"\r", b"\n\n", b'"', b"'", b'"""', b",", b"=", b":"),
    *(b"NaN", b"1e999", b"-Infinity", b"null", b"true", b"-1", b"0", b"1e308", b"0x", b"1_0"),
    *(b"\\ud800", b"\xed\xa0\x80", b"&lol;", b"<!DOCTYPE a [<!ENTITY b 'c'>]>", b"<![CDATA[", b"#"),
    "ß\N{RIGHT-TO-LEFT OVERRIDE}".encode(),
)
LONG = (
    *(b"9" * 5_000, b"[" * 3_000, b'{"a":' * 3_000, b"<a>" * 3_000),
    b"x" * 200_000,
)
PIECES = st.integers(0, 9).flatmap(lambda at: st.sampled_from(SHORT if at else LONG))
"""Pieces of text that have tripped parsers, ours or others'."""

VALUES = st.sampled_from(
    (
        *(None, True, -1, 0, 1e999, float("nan"), 1e308, 2**63, 10**400, "", "x", "\ud800", "\0"),
        *([], {}, [[]], "y" * 100_000, [0] * 1_000, "/dev/zero", "../../x", "nan", "inf"),
    )
)
"""Values that stand where a file of ours has another one."""

OF_BYTES = ("flip", "edge", "cut", "leave out", "swap", "repeat")
OF_TEXT = (*OF_BYTES, "insert", "insert", *("word",) * 8, "lines")
TYPES = ("F64", "F16", "BF16", "I32", "I64", "U8", "BOOL", "F8_E4M3", "C64", "X9")


def unhurried() -> settings:
    """As many examples as the profile says, of the usual one fewer; they may be large and slow."""
    count = settings().max_examples
    checks = [HealthCheck.too_slow, HealthCheck.data_too_large]
    return settings(max_examples=count if count > USUAL else SOME, suppress_health_check=checks)


def one_of(draw: Draw, *choices: Any) -> Any:
    return draw(st.sampled_from(choices))


def written(path: Path, data: bytes) -> Path:
    path.write_bytes(data)
    return path


def tampered(draw: Draw, data: bytes, kinds: tuple[str, ...] = OF_BYTES) -> bytes:
    """Bytes after one to three changes."""
    for _ in range(draw(st.integers(1, 3))):
        data = bytes(_changed(draw, bytearray(data), draw(st.sampled_from(kinds)))) or b"\0"
    return data


def _changed(draw: Draw, data: bytearray, kind: str) -> bytearray:
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
            one, other = data[at : at + length], data[to : to + length]
            data[at : at + length], data[to : to + length] = other, one
        case "repeat":
            data[to:to] = data[at:end]
        case "insert":
            data[at : at + draw(st.sampled_from((0, 0, 1, 5, 20)))] = draw(PIECES)
        case "word":
            words = list(re.finditer(rb"[\w.+-]+", data))
            if words:
                word, other = (draw(st.sampled_from(words)) for _ in range(2))
                data[word.start() : word.end()] = draw(st.just(bytes(other[0])) | PIECES)
        case "lines":
            lines = data.split(b"\n")
            data = bytearray(b"\n").join(draw(st.lists(st.sampled_from(lines), max_size=9)))
        case "size":
            _resize(draw, data)
    return data


def _resize(draw: Draw, data: bytearray) -> None:
    """Large or odd numbers where an image's format keeps width and height."""
    of_jpeg = max(data.find(b"\xff\xc0"), data.find(b"\xff\xc2"), 0) + 5
    places = {b"\xff\xd8": of_jpeg, b"\x89P": 18, b"BM": 18, b"RI": 26}
    at = places.get(bytes(data[:2])) or draw(st.integers(0, len(data) - 1))
    number = draw(st.sampled_from((0, 1, 3, 255, 13_000, 30_000, 65_535)))
    data[at : at + 2] = number.to_bytes(2, draw(st.sampled_from(("big", "little"))))


def tampered_values(draw: Draw, values: Any) -> Any:
    """Nested values with one part, anywhere, replaced, removed, wrapped or written twice."""
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
            changed[key] = tampered_values(draw, changed[key])
    return changed


def tampered_json(draw: Draw, values: Any) -> bytes:
    """JSON, mostly its values tampered with, sometimes its text."""
    data = json.dumps(tampered_values(draw, values)).encode()
    return tampered(draw, data, OF_TEXT) if draw(st.integers(0, 2)) == 0 else data


def tampered_safetensors(draw: Draw, data: bytes) -> bytes:
    """The file with another header, other values or other bytes."""
    size = int.from_bytes(data[:8], "little")
    header, rest = json.loads(data[8 : 8 + size]), data[8 + size :]
    match draw(st.integers(0, 5)):
        case 0:
            return tampered(draw, data)
        case 1:
            return _with_header(tampered_json(draw, header), rest)
        case 2:
            name = draw(st.sampled_from([key for key in header if key != "__metadata__"]))
            header[name] = {**header[name], "dtype": draw(st.sampled_from(TYPES))}
        case 3:
            about = header.get("__metadata__", {})
            header["__metadata__"] = {key: _tampered_text(draw, about[key]) for key in about}
        case 4:
            value = draw(st.sampled_from([float("nan"), float("inf"), -1e30, 2e6, 0.0]))
            at = 4 * draw(st.integers(0, max(0, len(rest) // 4 - 1)))
            rest = rest[:at] + torch.tensor(value).numpy().tobytes() + rest[at + 4 :]
        case _:
            header = tampered_values(draw, header)
    return _with_header(json.dumps(header).encode(), rest)


def _with_header(text: bytes, rest: bytes) -> bytes:
    return len(text).to_bytes(8, "little") + text + rest


def _tampered_text(draw: Draw, text: str) -> str:
    """JSON inside metadata, its values tampered with."""
    try:
        values: Any = json.loads(text)
    except ValueError:
        return text
    return tampered_json(draw, values).decode(errors="replace")


# --- images ----------------------------------------------------------------------

OF_IMAGES = (*OF_BYTES, "size")
SIZES = ((64, 48), (1, 1), (1, 90), (90, 1), (320, 240))


@cache
def scene(seed: int) -> Image.Image:
    """A rendered street."""
    pixels = render_scene(seed).image.mul(255).round().byte().permute(1, 2, 0).numpy()
    return Image.fromarray(np.ascontiguousarray(pixels))


def whole_image(draw: Draw) -> bytes:
    """An image of some size, mode, format and EXIF; one in six has frames."""
    size, data = one_of(draw, *SIZES), io.BytesIO()
    if one_of(draw, *range(6)) == 0:
        frames = [scene(number).resize(size) for number in range(one_of(draw, 2, 5))]
        kind = one_of(draw, "PNG", "WEBP", "TIFF", "GIF")
        frames[0].save(data, kind, save_all=True, append_images=frames[1:])
        return data.getvalue()
    image = scene(one_of(draw, *range(4))).resize(size)
    exif = Image.Exif()
    exif[274] = one_of(draw, *range(12))
    options = one_of(draw, {}, {"exif": exif}, {"exif": b"no exif"}, {"progressive": True})
    kind = one_of(draw, "JPEG", "PNG", "TIFF", "WEBP", "BMP")
    try:
        mode = one_of(draw, "RGB", "L", "P", "RGBA", "1", "CMYK", "I;16")
        image.convert(mode).save(data, kind, **options)
    except Exception:  # Pillow raises anything where a format knows no such mode or metadata
        data = io.BytesIO()
        image.save(data, "PNG")
    return data.getvalue()


def reads_image(path: Path) -> bool:
    image = read_image(path)
    return bool((image >= 0).all() and (image <= 1).all()) and image.ndim == 3
