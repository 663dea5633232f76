"""Images that are damaged, declare a wrong size, or make decoders warn."""

import io
import re
import struct
import warnings
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image, ImageFile

from roadtorch.base.decoding import MEGAPIXELS_VARIABLE, check_pixels
from roadtorch.base.errors import DatasetError, InputError
from roadtorch.base.image import as_image, decode_image, read_image
from roadtorch.data.label_images import read_labels

# --- images ---------------------------------------------------------------------------


def noise(height: int = 64, width: int = 64) -> Image.Image:
    draw = np.random.default_rng(0).integers(0, 255, (height, width, 3), np.uint8)
    return Image.fromarray(draw)


def encode(image: Image.Image, form: str, **options: Any) -> bytes:
    """Encode an image in a format of Pillow."""
    data = io.BytesIO()
    image.save(data, form, **options)
    return data.getvalue()


def tiff(pixels: np.ndarray, **tags: int) -> bytes:
    """Encode pixels (H, W, C) as an uncompressed TIFF; tags by number, such as t262."""
    height, width, samples = pixels.shape
    size = {256: width, 257: height, 258: 8 * pixels.itemsize, 259: 1, 262: 1 if samples < 3 else 2}
    strips = {273: 8, 277: samples, 278: height, 279: pixels.nbytes}
    entries = {**size, **strips, **{int(tag[1:]): value for tag, value in tags.items()}}
    table = b"".join(struct.pack("<HHII", tag, 4, 1, entries[tag]) for tag in sorted(entries))
    start = struct.pack("<2sHI", b"II", 42, 8 + pixels.nbytes)
    return start + pixels.tobytes() + struct.pack("<H", len(entries)) + table + bytes(4)


def png(width: int, height: int, bits: int, colours: int, **chunks: bytes) -> bytes:
    """Make a PNG, grey (colours 0) or RGB (2), with these chunks after its header."""
    header = struct.pack(">IIBBBBB", width, height, bits, colours, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(content)) + body + struct.pack(">I", zlib.crc32(body))
        for kind, content in {"IHDR": header, **chunks, "IEND": b""}.items()
        for body in [kind[:4].encode() + content]
    )


def jpeg_declaring(width: int, height: int) -> bytes:
    """Make a small JPEG whose header declares another size."""
    data = bytearray(encode(Image.new("RGB", (64, 64)), "JPEG"))
    at = data.index(b"\xff\xc0") + 5
    data[at : at + 4] = struct.pack(">HH", height, width)
    return bytes(data)


def long_webp() -> bytes:
    """Make a small WebP whose VP8X header declares a long canvas."""
    frames = [Image.new("RGB", (90, 1), colour) for colour in ("red", "blue")]
    data = bytearray(encode(frames[0], "WEBP", save_all=True, append_images=frames[1:]))
    data[24:27] = (16_711_770 - 1).to_bytes(3, "little")
    return bytes(data)


JPEG = encode(noise(), "JPEG")
FORMS = {".jpg": "JPEG", ".png": "PNG", ".tif": "TIFF", ".webp": "WEBP", ".bmp": "BMP"}
DEEP = np.full((16, 16, 3), 100, np.uint16)

# --- refused files ----------------------------------------------------------------------


REFUSED: Mapping[str, tuple[bytes, str]] = {
    "empty.jpg": (b"", "is empty"),
    "text.jpg": (b"hello, world\n" * 9, "is not an image"),
    "gif.jpg": (b"GIF89a" + bytes(50), "is not an image"),
    **{
        f"{share}{suffix}": (whole[: int(len(whole) * share)], "cannot be decoded|is not an image")
        for suffix, form in FORMS.items()
        for whole in [encode(noise(), form)]
        for share in (0.1, 0.99)
    },
    "bomb.jpg": (jpeg_declaring(13_000, 13_000), "has .*more than 100 megapixels"),
    "larger bomb.jpg": (jpeg_declaring(65_000, 65_000), "has .*more than 100 megapixels"),
    "row.webp": (long_webp(), "cannot be decoded: a side of 16711770 pixels"),
    "no deep pixels.png": (png(4, 4, 16, 2), "cannot be decoded"),
    "short.tif": (encode(noise(), "TIFF", compression="tiff_deflate")[:-900], ".*"),
    **{
        f"{name}.tif": (data, "cannot be decoded: only TIFF of one plane|is not an image")
        for name, data in {
            "planes": tiff(DEEP, t284=2),
            "signed and deep": tiff(DEEP, t339=2),
            "ten bits": tiff(DEEP[..., :1], t258=10),
            "white is 0": tiff(DEEP[..., :1], t262=0),
            "float": encode(Image.new("F", (16, 16)), "TIFF"),
        }.items()
    },
}
"""Files by name: their bytes, and the pattern of the error."""


@pytest.mark.parametrize("name", REFUSED)
def test_a_damaged_image_is_refused_by_name(name: str, tmp_path: Path) -> None:
    data, problem = REFUSED[name]
    path = tmp_path / name
    path.write_bytes(data)

    with pytest.raises(InputError) as caught:
        read_image(path)

    assert caught.value.where == str(path)
    assert re.match(problem, caught.value.problem)


def test_too_many_pixels_are_refused_before_decoding(monkeypatch: pytest.MonkeyPatch) -> None:
    data = jpeg_declaring(13_000, 13_000)
    monkeypatch.setattr(ImageFile.ImageFile, "load", None)

    with pytest.raises(InputError, match="more than 100 megapixels"):
        decode_image(data, "a.jpg")


def test_the_bound_on_pixels_can_be_set(monkeypatch: pytest.MonkeyPatch) -> None:
    image = encode(Image.new("L", (200, 100)), "PNG")

    check_pixels(10_000, 10_000)  # the default limit
    monkeypatch.setenv(MEGAPIXELS_VARIABLE, "0.02")
    assert decode_image(image, "a.png").shape == (3, 100, 200)
    monkeypatch.setenv(MEGAPIXELS_VARIABLE, "0.019")
    with pytest.raises(InputError, match=r"has 200 by 100 pixels, more than 0\.019 megapixels"):
        decode_image(image, "a.png")
    monkeypatch.setenv(MEGAPIXELS_VARIABLE, "many")
    with pytest.raises(InputError, match="'many', not a number above 0"):
        decode_image(image, "a.png")


# --- accepted files ---------------------------------------------------------------------


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("samples", [1, 3, 4])
def test_a_tiff_of_8_or_16_bits_is_read(bits: int, samples: int) -> None:
    draw = np.random.default_rng(samples)
    pixels = draw.integers(0, 2**bits, (37, 53, samples)).astype(f"uint{bits}")
    shares = torch.from_numpy(pixels / (2**bits - 1)).permute(2, 0, 1)
    expected = shares[:3] * shares[3:] if samples == 4 else shares.expand(3, -1, -1)

    image = decode_image(tiff(pixels, **({"t338": 2} if samples == 4 else {})), "a.tif")

    assert torch.allclose(image.double(), expected, atol=1e-5)


@pytest.mark.parametrize("bits", [8, 16])
def test_the_exif_of_a_png_is_applied_before_or_after_its_pixels(bits: int) -> None:
    rows = [[10, 20, 30], [40, 50, 60]]

    def packed(grey: list[list[int]]) -> bytes:
        levels = np.array(grey) * (2**bits - 1) // 255
        lines = [b"\0" + line.astype(f">u{bits // 8}").tobytes() for line in levels]
        return zlib.compress(b"".join(lines))

    exif = b"MM\0*\0\0\0\x08\0\x01" + struct.pack(">HHIHHI", 274, 3, 1, 3, 0, 0)
    expected = torch.tensor(rows).flip(0, 1) / 255

    for chunks in {"eXIf": exif, "IDAT": packed(rows)}, {"IDAT": packed(rows), "eXIf": exif}:
        image = decode_image(png(3, 2, bits, 0, **chunks), "a.png")
        assert torch.allclose(image[1], expected, atol=1e-4)


def test_warnings_about_images_are_no_failures(monkeypatch: pytest.MonkeyPatch) -> None:
    image = Image.new("RGB", (8, 8), (200, 100, 50))
    broken = b"Exif\0\0MM\0*\0\0\0\x08\0\x09" + bytes(20)
    files = [encode(image, form, exif=broken) for form in ("JPEG", "PNG", "WEBP")]
    large = encode(Image.new("L", (10, 9)), "PNG")

    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 89)  # beyond which Pillow warns
    with warnings.catch_warnings(action="error"):
        images = [decode_image(data, "a") for data in files]
        assert decode_image(large, "b").shape == (3, 9, 10)

    for image in images:
        assert image.shape == (3, 8, 8)
        assert torch.allclose(image.mean((1, 2)) * 255, torch.tensor([200.0, 100, 50]), atol=6)


@pytest.mark.parametrize("form", ["JPEG", "PNG", "BMP", "TIFF", "WEBP"])
def test_half_an_image_is_refused_whatever_another_package_has_set(
    form: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ImageFile, "LOAD_TRUNCATED_IMAGES", True)
    data = encode(noise(), form)
    (tmp_path / "a.png").write_bytes(data[: len(data) // 2])

    with pytest.raises(InputError, match="image: "):
        as_image(data[: len(data) // 2])
    with pytest.raises(DatasetError, match="cannot be decoded"):
        read_labels(tmp_path / "a.png")
    assert ImageFile.LOAD_TRUNCATED_IMAGES  # of the other package
