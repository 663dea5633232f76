"""Reading and writing of images."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import torch
from PIL import Image
from torch import Tensor

from roadtorch.base.errors import ConfigError, InputError
from roadtorch.base.image import (
    ORANGE,
    as_image,
    decode_image,
    overlay_pixels,
    read_image,
    tint_mask,
    write_labels,
    write_map,
    write_mask,
    write_npy,
    write_pixels,
    write_rgb,
)
from tests.base.test_decoding import tiff

# Every channel differs, and no turn or flip leaves it as it is.
PIXELS = (np.arange(5 * 7 * 3).reshape(5, 7, 3) * 2).astype(np.uint8)


def as_tensor(pixels: np.ndarray, levels: int = 255) -> Tensor:
    return torch.from_numpy(pixels.astype(np.float32) / levels).permute(2, 0, 1)


def save(path: Path, image: Image.Image, **options: Any) -> Path:
    image.save(path, **options)
    return path


# --- reading ----------------------------------------------------------------------------


EXACT = {".png": {}, ".bmp": {}, ".tif": {}, ".webp": {"lossless": True, "exact": True}}
"""Options with which formats are lossless."""


@pytest.mark.parametrize("suffix", EXACT)
@pytest.mark.parametrize("mode", ["RGB", "L", "P", "1", "LA", "RGBA"])
def test_every_mode_looks_as_in_pillow_over_black(tmp_path: Path, suffix: str, mode: str) -> None:
    mode = mode.removesuffix("A") if suffix == ".bmp" else mode  # which keeps no alpha
    alpha = np.full((5, 7, 1), 255, np.uint8)
    alpha[0], alpha[1:, :3] = 51, 0
    stored = Image.fromarray(np.dstack([PIXELS, alpha]) if "A" in mode else PIXELS).convert(mode)
    rgba = as_tensor(np.asarray(stored.convert("RGBA")))

    image = read_image(save(tmp_path / f"a{suffix}", stored, **EXACT[suffix]))

    assert image.dtype == torch.float32
    assert image.is_contiguous()
    np.testing.assert_allclose(image, rgba[:3] * rgba[3:], rtol=1.3e-6, atol=1e-5)
    assert torch.equal(as_image(image), image)


def test_a_transparent_palette_and_deep_or_printed_images(tmp_path: Path) -> None:
    palette = Image.new("P", (4, 4), 1)
    palette.putpalette([255, 255, 255, 10, 20, 30])
    grey = np.full((20, 24), 51, np.uint8)

    see_through = read_image(save(tmp_path / "b.png", palette, transparency=1))
    assert torch.equal(see_through, torch.zeros(3, 4, 4))
    deep, printed = Image.fromarray(grey * np.uint16(257)), Image.fromarray(grey).convert("CMYK")
    assert torch.allclose(as_image(deep), torch.full((3, 20, 24), 0.2), atol=0.005)
    assert as_image(printed).shape == (3, 20, 24)


@pytest.mark.parametrize("name", ["a.png", "a.tif"])
def test_sixteen_bits_are_kept(tmp_path: Path, name: str) -> None:
    deep = PIXELS.astype(np.uint16) * 257 + 13

    for stored in (deep[..., ::-1], deep[..., 0]):
        cv2.imwrite(str(tmp_path / name), stored)

        expected = as_tensor(deep if stored.ndim == 3 else deep[..., :1].repeat(3, 2), 65535)
        np.testing.assert_allclose(read_image(tmp_path / name), expected, rtol=0, atol=1e-7)


TURNS = {  # EXIF 2.3, tag 274: what has to be done to the stored pixels
    1: lambda a: a,
    2: np.fliplr,
    3: lambda a: np.rot90(a, 2),
    4: np.flipud,
    5: lambda a: a.swapaxes(0, 1),
    6: lambda a: np.rot90(a, -1),
    7: lambda a: np.rot90(a, 2).swapaxes(0, 1),
    8: np.rot90,
}


@pytest.mark.parametrize("orientation", TURNS)
def test_exif_orientation_is_applied(tmp_path: Path, orientation: int) -> None:
    blocks = np.kron(PIXELS[:2, :3], np.ones((16, 16, 1), np.uint8))
    exif = Image.Exif()
    exif[274] = orientation
    for suffix, options, within in (
        (".png", {"exif": exif}, 0),
        (".webp", {"exif": exif, "lossless": True}, 0),
        (".tif", {"tiffinfo": {274: orientation}}, 0),
        (".jpg", {"exif": exif, "quality": 98, "subsampling": 0}, 4 / 255),
    ):
        path = save(tmp_path / f"a{suffix}", Image.fromarray(blocks), **options)
        image = read_image(path)
        assert (image - as_tensor(TURNS[orientation](blocks))).abs().max() <= within, suffix
        with Image.open(path) as opened:
            assert (as_image(opened) - image).abs().max() <= within, suffix
    deep = decode_image(tiff(PIXELS.astype(np.uint16), t274=orientation), "deep.tif")
    expected = as_tensor(TURNS[orientation](PIXELS), 65535)
    np.testing.assert_allclose(deep, expected, rtol=1.3e-6, atol=1e-5)


# --- conversion -----------------------------------------------------------------------------


def test_arrays_tensors_pillow_images_and_paths_give_the_same_image(tmp_path: Path) -> None:
    path = save(tmp_path / "a.png", Image.fromarray(PIXELS))
    expected = as_tensor(PIXELS)

    for image in (path, str(path), Image.open(path), torch.from_numpy(PIXELS).permute(2, 0, 1)):
        assert torch.equal(as_image(image), expected)
    bgr = np.asarray(cv2.imread(str(path)))
    assert torch.equal(as_image(PIXELS, "rgb"), expected)
    for array in (
        bgr,
        cv2.cvtColor(bgr, cv2.COLOR_BGR2BGRA),
        bgr.astype(np.uint16) * 257,
        bgr.astype(np.float32) / 255,
    ):
        assert torch.equal(as_image(array, "bgr"), expected)
    np.testing.assert_allclose(
        as_image(bgr.astype(np.float64) / 255, "bgr"), expected, rtol=1.3e-6, atol=1e-5
    )
    assert as_image(expected) is expected
    assert torch.equal(as_image(PIXELS[..., 0]), as_tensor(PIXELS[..., :1].repeat(3, 2)))
    see_through = np.dstack([PIXELS, 0 * PIXELS[..., 0]])
    assert torch.equal(as_image(see_through, "rgb"), torch.zeros(3, 5, 7))


@pytest.mark.parametrize(
    ("image", "order", "problem"),
    [
        (PIXELS, None, "image: has no colour order"),
        (PIXELS.transpose(2, 0, 1), "rgb", "shape (3, 5, 7)"),
        (PIXELS[None], "bgr", "give all of them to detect_many"),
        ([PIXELS, PIXELS], "bgr", "image: is a list, not one image (give one, or all of them to"),
        (Image.new("F", (20, 20)), None, "mode F has no defined white level"),
        (PIXELS.astype(">f4"), "rgb", "is an array of >f4 (give uint8"),
        (PIXELS.astype("longdouble"), "rgb", "is an array of float128 (give uint8"),
        (None, "bgr", "is None (check its path: cv2.imread gives that"),
        (PIXELS, "RGB", "RGB: unknown colour order"),
    ],
)
def test_other_values_are_refused(image: Any, order: Any, problem: str) -> None:
    with pytest.raises((InputError, ConfigError)) as caught:
        as_image(image, order)

    assert problem in str(caught.value)


# --- writing ------------------------------------------------------------------------------


def stored(path: Path) -> np.ndarray:
    pixels = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    assert pixels is not None
    return pixels


def test_maps_are_rounded_to_the_nearest_level(tmp_path: Path) -> None:
    likelihood = torch.tensor([[0, 1, 0.5], [0.25, 1 / 255 * 1.6, 1 / 65535 * 2.4]])

    write_map(tmp_path / "8.png", likelihood)
    write_map(tmp_path / "16.png", likelihood, depth=16)

    assert stored(tmp_path / "8.png").tolist() == [[0, 255, 128], [64, 2, 0]]
    deep = stored(tmp_path / "16.png")
    assert deep.dtype == np.uint16
    assert deep.tolist() == [[0, 65535, 32768], [16384, 411, 2]]


def test_masks_labels_colours_and_arrays_keep_their_values(tmp_path: Path) -> None:
    image = as_tensor(PIXELS)

    write_mask(tmp_path / "mask.png", torch.tensor([[True, False]]))
    write_labels(tmp_path / "labels.png", torch.tensor([[0, 2, 255]]))
    write_rgb(tmp_path / "image.png", image)
    write_npy(tmp_path / "image.npy", image)
    write_pixels(tmp_path / "overlay.jpg", overlay_pixels(image, torch.ones(5, 7).bool()))

    assert stored(tmp_path / "mask.png").tolist() == [[255, 0]]
    assert stored(tmp_path / "labels.png").tolist() == [[0, 2, 255]]
    assert torch.equal(read_image(tmp_path / "image.png"), image)
    assert np.array_equal(np.load(tmp_path / "image.npy"), image.numpy())
    assert stored(tmp_path / "overlay.jpg").shape == (5, 7, 3)


@pytest.mark.parametrize("grey", [0, 128, 255])
def test_the_overlay_shows_on_any_grey_road(grey: int) -> None:
    pixels = np.full((240, 320, 3), grey, np.uint8)
    mask = np.zeros((240, 320), bool)
    mask[100:, 80:240] = True

    tinted = tint_mask(pixels, mask).astype(int)

    assert (tinted[~mask] == grey).all()  # the rest of the image is left alone
    assert np.abs(tinted[200, 160] - grey).max() > 20  # the tint
    assert tinted[100, 160].tolist() == list(ORANGE)  # the outline
    assert tinted[239, 160].tolist() == tinted[200, 160].tolist()  # none at the image's rim
