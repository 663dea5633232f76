"""Pictures that are damaged, that lie about their size, or that make decoders warn."""

import io
import itertools
import os
import re
import struct
import warnings
import zlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
import torch
from PIL import Image

from roadtorch.base.decoding import MEGAPIXELS_VARIABLE, check_pixels
from roadtorch.base.errors import InputError
from roadtorch.base.image import decode_image, read_image

# --- pictures ---------------------------------------------------------------------------


def noise(height: int = 64, width: int = 64) -> Image.Image:
    draw = np.random.default_rng(0).integers(0, 255, (height, width, 3), np.uint8)
    return Image.fromarray(draw)


def saved(picture: Image.Image, form: str, **options: Any) -> bytes:
    """The bytes of a picture in a format of Pillow's."""
    data = io.BytesIO()
    picture.save(data, form, **options)
    return data.getvalue()


def tiff(pixels: np.ndarray, **options: Any) -> bytes:
    """The bytes of a TIFF of tifffile's."""
    data = io.BytesIO()
    tifffile.imwrite(data, pixels, **options)
    return data.getvalue()


def tiff_of_layout(
    pixels: np.ndarray, colours: Any, extra: str, planes: str, **options: Any
) -> bytes:
    """The bytes of a TIFF of pixels (H,W,C), its colours one after the other or in planes."""
    samples = pixels.shape[2]
    stored = np.moveaxis(pixels, -1, 0) if planes == "separate" else pixels
    return tiff(
        stored if samples > 1 else pixels[..., 0],
        photometric=colours,
        planarconfig=planes if samples > 1 else None,
        extrasamples=[extra] if extra else None,
        **options,
    )


def png(width: int, height: int, bits: int, colours: int, **chunks: bytes) -> bytes:
    """A PNG of so many bits a sample, grey (0) or RGB (2), with chunks behind its header."""
    header = struct.pack(">IIBBBBB", width, height, bits, colours, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(content)) + body + struct.pack(">I", zlib.crc32(body))
        for kind, content in {"IHDR": header, **chunks, "IEND": b""}.items()
        for body in [kind[:4].encode() + content]
    )


def declaring(width: int, height: int) -> bytes:
    """A small JPEG that says it is large."""
    data = bytearray(saved(Image.new("RGB", (64, 64)), "JPEG"))
    at = data.index(b"\xff\xc0") + 5
    data[at : at + 4] = struct.pack(">HH", height, width)
    return bytes(data)


def long_row() -> bytes:
    """A small WebP whose canvas, of a VP8X, says it is long."""
    frames = [Image.new("RGB", (90, 1), colour) for colour in ("red", "blue")]
    data = bytearray(saved(frames[0], "WEBP", save_all=True, append_images=frames[1:]))
    data[24:27] = (16_711_770 - 1).to_bytes(3, "little")
    return bytes(data)


def with_thumbnail() -> bytes:
    """A JPEG with another one, whole, in its metadata."""
    thumbnail, whole = saved(noise(16, 16), "JPEG"), JPEG
    marker = b"\xff\xe1" + (len(thumbnail) + 2).to_bytes(2, "big")
    return whole[:2] + marker + thumbnail + whole[2:]


def flipped(data: bytes, at: int) -> bytes:
    """The bytes with one bit that is another."""
    return data[:at] + bytes([data[at] ^ 1]) + data[at + 1 :]


JPEG = saved(noise(), "JPEG")
FORMS = {".jpg": "JPEG", ".png": "PNG", ".tif": "TIFF", ".webp": "WEBP", ".bmp": "BMP"}
DEFLATED = tiff(
    np.random.default_rng(0).integers(0, 65536, (37, 53, 3), np.uint16),
    photometric="rgb",
    compression="zlib",
)
NO_PLANES = tiff(np.zeros((16, 16, 3), np.uint8), photometric="rgb", planarconfig="contig").replace(
    struct.pack("<HHI", 284, 3, 1), struct.pack("<HHI", 284, 3, 0)
)
SAYING_NOTHING = tiff(np.zeros((16, 16), np.uint8), photometric="minisblack").replace(
    struct.pack("<HHI", 262, 3, 1), struct.pack("<HHI", 263, 3, 1)
)
HUNDRED = np.full((16, 16), 100)

# --- what is refused --------------------------------------------------------------------


REFUSED: Mapping[str, tuple[bytes, str]] = {
    "empty.jpg": (b"", "is empty"),
    "text.jpg": (b"hello, world\n" * 9, "is not a picture"),
    "start.jpg": (b"\xff\xd8", "cannot be decoded|is not a picture"),
    "gif.jpg": (b"GIF89a" + bytes(50), "is not a picture"),
    **{
        f"{share}{suffix}": (whole[: int(len(whole) * share)], "cannot be decoded|is not a picture")
        for suffix, form in FORMS.items()
        for whole in [saved(noise(), form)]
        for share in (0.1, 0.5, 0.9, 0.99)
    },
    "thumbnail.jpg": (with_thumbnail()[:-200], "cannot be decoded: .*truncated"),
    "hole.jpg": (JPEG[:2000] + JPEG[2500:], "cannot be decoded: Corrupt JPEG data"),
    "bomb.jpg": (declaring(13_000, 13_000), "has .*more than 100 megapixels"),
    "larger bomb.jpg": (declaring(65_000, 65_000), "has .*more than 100 megapixels"),
    "row.webp": (long_row(), "cannot be decoded: a side of 16711770 pixels"),
    "no pixels.png": (png(4, 4, 8, 2), "cannot be decoded"),
    "no deep pixels.png": (png(4, 4, 16, 2), "cannot be decoded"),
    "short.tif": (tiff(np.zeros((16, 16), np.uint8))[:-9], "cannot be decoded"),
    "short and deep.tif": (tiff(np.zeros((16, 16), np.uint16))[:-9], "cannot be decoded"),
    "deflated.tif": (flipped(DEFLATED, len(DEFLATED) // 2), "cannot be decoded"),
    "black.tif": (SAYING_NOTHING, "cannot be decoded: .*does not say whether black is 0"),
    "planes.tif": (NO_PLANES, "cannot be decoded: its tags contradict each other"),
    "white.tif": (
        tiff(HUNDRED.astype(np.uint16), photometric="miniswhite"),
        "cannot be decoded: .* black being 0",
    ),
    "float.tif": (tiff(HUNDRED.astype(np.float32)), "cannot be decoded: floating-point"),
    **{
        f"{kind}.tif": (tiff(HUNDRED.astype(kind)), r"cannot be decoded: TIFF of \d+ bits")
        for kind in ("int32", "uint32", "int16", "int8")
    },
}
"""Files by name: their bytes, and what is said of them."""


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_no_whole_picture_is_refused_by_name_and_no_decoder_talks(
    name: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    data, what = REFUSED[name]
    path = tmp_path / name
    path.write_bytes(data)

    with pytest.raises(InputError) as caught:
        read_image(path)

    assert caught.value.where == str(path)
    assert re.match(what, caught.value.what)
    assert capfd.readouterr() == ("", "")


NO_FILES: Mapping[str, tuple[Callable[[Path], object], str]] = {
    "missing.png": (lambda path: None, "does not exist"),
    "folder.png": (Path.mkdir, "is a folder"),
    "pipe.png": (os.mkfifo, "cannot be read: it is a pipe or a device, not a file"),
    "device.png": (
        lambda path: path.symlink_to("/dev/zero"),
        "cannot be read: it is a pipe or a device, not a file",
    ),
    "loop.png": (
        lambda path: path.symlink_to(path),
        "cannot be read: Too many levels of symbolic links",
    ),
}


@pytest.mark.parametrize("name", NO_FILES)
def test_what_is_no_file_is_refused_by_name(name: str, tmp_path: Path) -> None:
    make, what = NO_FILES[name]
    make(tmp_path / name)

    with pytest.raises(InputError) as caught:
        read_image(tmp_path / name)

    assert (caught.value.where, caught.value.what) == (str(tmp_path / name), what)


def test_too_many_pixels_are_refused_before_decoding(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("simplejpeg.decode_jpeg", None)

    with pytest.raises(InputError, match="more than 100 megapixels"):
        decode_image(declaring(13_000, 13_000), "a.jpg")


def test_the_bound_on_pixels_can_be_set(monkeypatch: pytest.MonkeyPatch) -> None:
    picture = saved(Image.new("L", (200, 100)), "PNG")

    check_pixels(10_000, 10_000)  # what is allowed otherwise
    monkeypatch.setenv(MEGAPIXELS_VARIABLE, "0.02")
    assert decode_image(picture, "a.png").shape == (3, 100, 200)
    monkeypatch.setenv(MEGAPIXELS_VARIABLE, "0.019")
    with pytest.raises(InputError, match=r"has 200 by 100 pixels, more than 0\.019 megapixels"):
        decode_image(picture, "a.png")
    monkeypatch.setenv(MEGAPIXELS_VARIABLE, "many")
    with pytest.raises(InputError, match="'many', not a number above 0"):
        decode_image(picture, "a.png")


# --- what is no damage ------------------------------------------------------------------


@pytest.mark.parametrize(
    "strange",
    [JPEG[:-2] + bytes(7) + JPEG[-2:], with_thumbnail(), JPEG + b"camera maker's notes"],
    ids=["filled up", "with a thumbnail", "with notes behind its end"],
)
def test_what_cameras_add_to_a_jpeg_is_no_damage(strange: bytes) -> None:
    assert torch.equal(decode_image(strange, "a.jpg"), decode_image(JPEG, "b.jpg"))


def test_a_progressive_jpeg_is_read() -> None:
    assert decode_image(saved(noise(), "JPEG", progressive=True), "a.jpg").shape == (3, 64, 64)


@pytest.mark.parametrize("bits", [8, 16])
def test_a_png_with_strange_metadata_is_read(bits: int, capfd: pytest.CaptureFixture[str]) -> None:
    strange = b"x\0\0" + zlib.compress(bytes(200))
    pixels = zlib.compress((b"\0" + b"\x33" * (4 * 3 * bits // 8)) * 4)

    image = decode_image(png(4, 4, bits, 2, iCCP=strange, IDAT=pixels), "a.png")

    assert torch.equal(image, torch.full((3, 4, 4), 0.2))
    assert capfd.readouterr() == ("", "")


SAMPLES = [
    *(("minisblack", 1, ""), ("minisblack", 2, "unassalpha"), ("rgb", 3, "")),
    *(("rgb", 4, kind) for kind in ("unassalpha", "assocalpha", "unspecified")),
]


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("compression", [None, "zlib"])
@pytest.mark.parametrize("planes", ["contig", "separate"])
@pytest.mark.parametrize(("colours", "samples", "extra"), SAMPLES)
def test_a_tiff_of_any_layout_is_read_right_or_refused(
    bits: int,
    compression: str | None,
    planes: str,
    colours: Any,
    samples: int,
    extra: str,
    capfd: pytest.CaptureFixture[str],
) -> None:
    draw = np.random.default_rng(samples)
    pixels = draw.integers(0, 2**bits, (37, 53, samples)).astype(f"uint{bits}")
    own = samples - bool(extra)
    if extra == "assocalpha":  # colours that were multiplied with it
        pixels[..., :own] = np.minimum(pixels[..., :own], pixels[..., own:])
    shares = pixels / (2**bits - 1)
    expected = shares[..., :own] * (shares[..., own:] if extra == "unassalpha" else 1)
    expected = torch.from_numpy(np.broadcast_to(expected, (37, 53, 3)).copy()).permute(2, 0, 1)

    layouts: list[dict[str, Any]] = [
        {"rowsperstrip": 10},
        {"tile": (16, 16)},
        {"predictor": compression is not None},
    ]
    orders: tuple[Any, ...] = ("<", ">")
    for options, order in itertools.product(layouts, orders):
        more = {"byteorder": order, "compression": compression, **options}
        data = tiff_of_layout(pixels, colours, extra, planes, **more)
        try:
            image = decode_image(data, "a.tif")
        except InputError:
            assert planes == "separate" or samples == 2 or extra == "unspecified"
        else:
            within = 1.1 / 255 if extra == "assocalpha" and bits == 8 else 1e-5  # Pillow's rounding
            assert (image - expected).abs().max() < within
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("compression", [None, "zlib"])
def test_the_colour_map_of_a_tiff_has_16_bits_or_as_libtiff_knows_them_8(
    bits: int, compression: str | None, capfd: pytest.CaptureFixture[str]
) -> None:
    colours = np.random.default_rng(2).integers(0, 256, (3, 256))
    numbers = np.arange(256, dtype=np.uint8).reshape(16, 16)
    levels = (colours * (257 if bits == 16 else 1)).astype(np.uint16)
    data = tiff(numbers, photometric="palette", colormap=levels, compression=compression)

    image = decode_image(data, "a.tif")

    assert torch.equal(image.mul(255).round().long(), torch.from_numpy(colours.reshape(3, 16, 16)))
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("compression", [None, "zlib"])
@pytest.mark.parametrize(("tag", "value"), [(257, 30), (278, 3), (279, 7), (322, 80)])
def test_a_tiff_whose_strips_do_not_fill_its_height_is_refused(
    bits: int, compression: str | None, tag: int, value: int, capfd: pytest.CaptureFixture[str]
) -> None:
    pixels = np.random.default_rng(1).integers(0, 2**bits, (20, 32)).astype(f"uint{bits}")
    form: dict[str, Any] = {"tile": (16, 16)} if tag == 322 else {"rowsperstrip": 10}
    data = bytearray(tiff(pixels, photometric="minisblack", compression=compression, **form))
    with tifffile.TiffFile(io.BytesIO(data)) as file:
        entry: Any = file.pages.first.tags[tag]
        at, kind = entry.valueoffset, {3: "<H", 4: "<I"}[entry.dtype]
    struct.pack_into(kind, data, at, value)

    with pytest.raises(InputError, match=r"a\.tif: cannot be decoded"):
        decode_image(bytes(data), "a.tif")
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("bits", [8, 16])
def test_the_exif_of_a_png_counts_wherever_it_stands_and_further_frames_do_not(bits: int) -> None:
    rows = [[10, 20, 30], [40, 50, 60]]

    def packed(grey: list[list[int]]) -> bytes:
        levels = np.array(grey) * (2**bits - 1) // 255
        lines = [b"\0" + line.astype(f">u{bits // 8}").tobytes() for line in levels]
        return zlib.compress(b"".join(lines))

    control = struct.pack(">IIIIHHBB", 3, 2, 0, 0, 1, 10, 0, 0)
    exif = b"MM\0*\0\0\0\x08\0\x01" + struct.pack(">HHIHHI", 274, 3, 1, 3, 0, 0)
    frames = {"acTL": struct.pack(">II", 2, 0), "fcTL": bytes(4) + control, "IDAT": packed(rows)}
    frames |= {"fcTL2": b"\0\0\0\1" + control, "fdAT": b"\0\0\0\2" + packed([[0] * 3] * 2)}

    image = decode_image(png(3, 2, bits, 0, **frames, eXIf=exif), "a.png")

    assert torch.allclose(image[1], torch.tensor(rows).flip(0, 1) / 255, atol=1e-4)


def test_one_row_turned_round_is_read() -> None:
    exif = Image.Exif()
    exif[274] = 3
    row = np.arange(21, dtype=np.uint8).reshape(1, 7, 3)

    image = decode_image(saved(Image.fromarray(row), "PNG", exif=exif), "a.png")

    assert torch.equal(image[:, 0, -1], torch.arange(3) / 255)


def test_warnings_about_pictures_are_no_failures_where_warnings_are_errors(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    picture = Image.new("RGB", (8, 8), (200, 100, 50))
    broken = b"Exif\0\0MM\0*\0\0\0\x08\0\x09" + bytes(20)
    files = [saved(picture, form, exif=broken) for form in ("JPEG", "PNG", "WEBP")]
    large = saved(Image.new("L", (10, 9)), "PNG")

    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 89)  # beyond which Pillow warns
    with warnings.catch_warnings(action="error"):
        images = [decode_image(data, "a") for data in files]
        assert decode_image(large, "b").shape == (3, 9, 10)

    for image in images:
        assert image.shape == (3, 8, 8)
        assert torch.allclose(image.mean((1, 2)) * 255, torch.tensor([200.0, 100, 50]), atol=6)
