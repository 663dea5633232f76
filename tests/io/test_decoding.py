"""Pictures that are damaged, that lie about their size, or that make decoders warn."""

import io
import itertools
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
from roadtorch.io.image import decode_image, read_image
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


def png(width: int, height: int, bits: int, colours: int, **chunks: bytes) -> bytes:
    """A PNG of so many bits a sample, grey (0) or RGB (2), with chunks behind its header."""
    header = struct.pack(">IIBBBBB", width, height, bits, colours, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(content)) + body + struct.pack(">I", zlib.crc32(body))
        for kind, content in {"IHDR": header, **chunks, "IEND": b""}.items()
        for body in [kind[:4].encode() + content]
    )


@pytest.mark.parametrize("bits", [8, 16])
def test_a_png_with_strange_metadata_is_read_and_one_without_pixels_refused(
    bits: int, capfd: pytest.CaptureFixture[str]
) -> None:
    strange = b"x\0\0" + zlib.compress(bytes(200))
    pixels = zlib.compress((b"\0" + b"\x33" * (4 * 3 * bits // 8)) * 4)

    found = decode_image(png(4, 4, bits, 2, iCCP=strange, IDAT=pixels), "a.png")

    assert torch.equal(found, torch.full((3, 4, 4), 0.2))
    with pytest.raises(InputError, match=r"a\.png: cannot be decoded"):
        decode_image(png(4, 4, bits, 2), "a.png")
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


@pytest.mark.parametrize(
    ("kind", "photometric", "told"),
    [
        *((kind, None, r"TIFF of \d+ bits") for kind in (np.int32, np.uint32, np.int16, np.int8)),
        (np.float32, None, "floating-point"),
        (np.uint16, "miniswhite", ".* black being 0"),
    ],
)
def test_a_tiff_whose_white_is_not_known_is_refused(
    tmp_path: Path, kind: Any, photometric: Any, told: str
) -> None:
    path = tmp_path / "a.tif"
    tifffile.imwrite(path, np.full((16, 16), 100, kind), photometric=photometric)

    with pytest.raises(InputError, match=rf"a\.tif: cannot be decoded: {told}"):
        read_image(path)


def test_a_tiff_that_does_not_say_whether_black_is_zero_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.tif"
    tifffile.imwrite(path, np.zeros((16, 16), np.uint8), photometric="minisblack")
    tag = struct.pack("<HHI", 262, 3, 1)
    path.write_bytes(path.read_bytes().replace(tag, struct.pack("<HHI", 263, 3, 1)))

    with pytest.raises(InputError, match="does not say whether black is 0"):
        read_image(path)


def test_a_deep_tiff_whose_deflated_bytes_are_damaged_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.tif"
    pixels = np.random.default_rng(0).integers(0, 65536, (37, 53, 3), np.uint16)
    tifffile.imwrite(path, pixels, photometric="rgb", compression="zlib")
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)

    with pytest.raises(InputError, match="cannot be decoded"):
        read_image(path)


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
    stored = np.moveaxis(pixels, -1, 0) if planes == "separate" else pixels
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
        data = io.BytesIO()
        tifffile.imwrite(
            data, stored if samples > 1 else pixels[..., 0], photometric=colours, byteorder=order,
            planarconfig=planes if samples > 1 else None, compression=compression,
            extrasamples=[extra] if extra else None, **options,
        )  # fmt: skip
        try:
            found = decode_image(data.getvalue(), "a.tif")
        except InputError:
            assert planes == "separate" or samples == 2 or extra == "unspecified"
        else:
            within = 1.1 / 255 if extra == "assocalpha" and bits == 8 else 1e-5  # Pillow's rounding
            assert (found - expected).abs().max() < within
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("compression", [None, "zlib"])
@pytest.mark.parametrize(("tag", "value"), [(257, 30), (278, 3), (279, 7), (322, 80)])
def test_a_tiff_whose_strips_do_not_fill_its_height_is_refused(
    bits: int, compression: str | None, tag: int, value: int, capfd: pytest.CaptureFixture[str]
) -> None:
    data = io.BytesIO()
    pixels = np.random.default_rng(1).integers(0, 2**bits, (20, 32)).astype(f"uint{bits}")
    form: dict[str, Any] = {"tile": (16, 16)} if tag == 322 else {"rowsperstrip": 10}
    tifffile.imwrite(data, pixels, photometric="minisblack", compression=compression, **form)
    with tifffile.TiffFile(io.BytesIO(data.getvalue())) as file:
        found: Any = file.pages.first.tags[tag]
        at, kind = found.valueoffset, {3: "<H", 4: "<I"}[found.dtype]
    whole = bytearray(data.getvalue())
    struct.pack_into(kind, whole, at, value)

    with pytest.raises(InputError, match=r"a\.tif: cannot be decoded"):
        decode_image(bytes(whole), "a.tif")
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

    found = decode_image(png(3, 2, bits, 0, **frames, eXIf=exif), "a.png")

    expected = torch.tensor(rows).flip(0, 1) / 255
    assert torch.allclose(found[1], expected, atol=1e-4)


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
