"""Pictures that are damaged, that lie about their size, or that make decoders warn."""

import io
import struct
import warnings
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
import torch
from PIL import Image

from roadtorch.errors import InputError
from roadtorch.io.decoding import MEGAPIXELS_VARIABLE
from roadtorch.io.image import read_image
from roadtorch.scenes.street import render_scene

# --- bounds -----------------------------------------------------------------------------


def declaring(path: Path, width: int, height: int) -> Path:
    """A small JPEG that says it is large."""
    Image.new("RGB", (64, 64)).save(path)
    data = bytearray(path.read_bytes())
    at = data.index(b"\xff\xc0") + 5
    data[at : at + 4] = struct.pack(">HH", height, width)
    path.write_bytes(data)
    return path


def test_a_small_file_that_declares_many_pixels_is_refused_before_decoding(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("cv2.imdecode", None)

    for size in ((13_000, 13_000), (65_000, 65_000)):
        path = declaring(tmp_path / "bomb.jpg", *size)
        with pytest.raises(InputError, match=r"bomb\.jpg: has .*more than 100 megapixels"):
            read_image(path)


def test_the_bound_on_pixels_can_be_set(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.png"
    Image.new("L", (200, 100)).save(path)

    monkeypatch.setenv(MEGAPIXELS_VARIABLE, "0.02")
    assert read_image(path).shape == (3, 100, 200)
    monkeypatch.setenv(MEGAPIXELS_VARIABLE, "0.019")
    with pytest.raises(InputError, match=r"has 200 by 100 pixels, more than 0\.019 megapixels"):
        read_image(path)
    monkeypatch.setenv(MEGAPIXELS_VARIABLE, "many")
    with pytest.raises(InputError, match="'many', not a number above 0"):
        read_image(path)


def test_a_row_of_many_megapixels_is_refused_before_decoding(tmp_path: Path) -> None:
    path = tmp_path / "row.webp"
    frames = [Image.new("RGB", (90, 1), colour) for colour in ("red", "blue")]
    frames[0].save(path, save_all=True, append_images=frames[1:])
    data = bytearray(path.read_bytes())
    data[24:27] = (16_711_770 - 1).to_bytes(3, "little")  # the canvas of a VP8X
    path.write_bytes(data)

    with pytest.raises(
        InputError, match=r"row\.webp: cannot be decoded: a side of 16711770 pixels"
    ):
        read_image(path)


# --- damage -----------------------------------------------------------------------------


@pytest.fixture(scope="module")
def scene() -> bytes:
    pixels = (render_scene(3).image * 255).round().byte().permute(1, 2, 0).numpy()
    data = io.BytesIO()
    Image.fromarray(pixels).save(data, "JPEG", quality=90)
    return data.getvalue()


def test_a_jpeg_damaged_inside_is_refused_with_its_name_and_nothing_else_is_told(
    tmp_path: Path, scene: bytes, capfd: pytest.CaptureFixture[str]
) -> None:
    middle = len(scene) // 2
    path = tmp_path / "damaged.jpg"
    path.write_bytes(scene[:middle] + scene[middle + 500 :])

    with pytest.raises(InputError, match=r"damaged\.jpg: cannot be decoded: Corrupt JPEG data"):
        read_image(path)

    assert capfd.readouterr() == ("", "")


def test_bytes_that_a_camera_fills_up_with_are_no_damage(tmp_path: Path, scene: bytes) -> None:
    path = tmp_path / "a.jpg"
    path.write_bytes(scene)
    expected = read_image(path)

    path.write_bytes(scene[:-2] + bytes(7) + scene[-2:])

    assert torch.equal(read_image(path), expected)


def chunk(kind: bytes, content: bytes) -> bytes:
    body = kind + content
    return struct.pack(">I", len(content)) + body + struct.pack(">I", zlib.crc32(body))


def test_a_png_without_pixels_is_refused(tmp_path: Path) -> None:
    header = chunk(b"IHDR", struct.pack(">IIBBBBB", 4, 4, 8, 2, 0, 0, 0))
    path = tmp_path / "a.png"
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + header + chunk(b"IEND", b""))

    with pytest.raises(InputError, match=r"a\.png: cannot be decoded"):
        read_image(path)


@pytest.mark.parametrize("bits", [8, 16])
def test_a_png_with_strange_metadata_is_read_and_nothing_is_told(
    tmp_path: Path, bits: int, capfd: pytest.CaptureFixture[str]
) -> None:
    header = chunk(b"IHDR", struct.pack(">IIBBBBB", 4, 4, bits, 2, 0, 0, 0))
    strange = chunk(b"iCCP", b"x\0\0" + zlib.compress(bytes(200)))
    pixels = chunk(b"IDAT", zlib.compress((b"\0" + b"\x33" * (4 * 3 * bits // 8)) * 4))
    path = tmp_path / "a.png"
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + header + strange + pixels + chunk(b"IEND", b""))

    assert torch.equal(read_image(path), torch.full((3, 4, 4), 0.2))
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("depth", [8, 16])
def test_a_tiff_that_ends_too_soon_is_refused_and_nothing_is_told(
    tmp_path: Path, depth: int, capfd: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "a.tif"
    tifffile.imwrite(path, np.zeros((16, 16), f"uint{depth}"))
    path.write_bytes(path.read_bytes()[:-9])

    with pytest.raises(InputError, match=r"a\.tif: cannot be decoded"):
        read_image(path)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("kind", [np.int32, np.uint32, np.int16, np.int8])
def test_a_tiff_whose_white_is_not_known_is_refused(tmp_path: Path, kind: Any) -> None:
    path = tmp_path / "a.tif"
    tifffile.imwrite(path, np.full((16, 16), 100, kind))

    with pytest.raises(InputError, match=r"a\.tif: cannot be decoded: TIFF of \d+ bits"):
        read_image(path)


def test_a_deep_tiff_whose_white_is_zero_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.tif"
    tifffile.imwrite(path, np.zeros((16, 16), np.uint16), photometric="miniswhite")

    with pytest.raises(InputError, match="black being 0"):
        read_image(path)


def test_one_row_turned_round_is_read(tmp_path: Path) -> None:
    exif = Image.Exif()
    exif[274] = 3
    row = np.arange(21, dtype=np.uint8).reshape(1, 7, 3)
    path = tmp_path / "a.png"
    Image.fromarray(row).save(path, exif=exif)

    assert torch.equal(read_image(path)[:, 0, -1], torch.arange(3) / 255)


# --- warnings ---------------------------------------------------------------------------


def test_warnings_about_pictures_are_no_failures_where_warnings_are_errors(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    picture = Image.new("RGB", (8, 8), (200, 100, 50))
    broken = b"Exif\0\0MM\0*\0\0\0\x08\0\x09" + bytes(20)
    picture.save(tmp_path / "a.jpg", exif=broken)
    picture.save(tmp_path / "b.png", exif=broken)
    picture.save(tmp_path / "c.webp", exif=broken)
    Image.new("L", (10, 9)).save(tmp_path / "d.png")

    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 89)  # beyond which Pillow warns
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = {path.name: read_image(path) for path in tmp_path.iterdir()}

    assert {name: image.shape[1:] for name, image in found.items()} == {
        **dict.fromkeys(("a.jpg", "b.png", "c.webp"), (8, 8)),
        "d.png": (9, 10),
    }
    for name in ("a.jpg", "b.png", "c.webp"):
        colour = found[name].mean((1, 2)) * 255
        assert torch.allclose(colour, torch.tensor([200.0, 100.0, 50.0]), atol=6)
