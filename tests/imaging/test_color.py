"""Colour planes against colorsys, OpenCV, scikit-image and their own definitions."""

import itertools

import numpy as np
import pytest
import torch
from hypothesis import example, given, settings
from hypothesis import strategies as st
from skimage.color import rgb2lab

from roadtorch.base.errors import ConfigError, InputError
from roadtorch.imaging.color import PLANES, color_plane, color_planes
from tests.reference.color import planes_of_pixel

CORNERS = list(itertools.product((0.0, 1.0), repeat=3))
HALVES = list(itertools.product((0.0, 0.5, 1.0), repeat=3))
UNIT = st.floats(0, 1, width=32)


def image_of(colors: list[tuple[float, ...]]) -> torch.Tensor:
    """One row of pixels, (3,1,n)."""
    return torch.tensor(colors).T[:, None]


def random_image(height: int = 40, width: int = 50, dtype: torch.dtype = torch.float32):
    generator = torch.Generator().manual_seed(1)
    return torch.rand(3, height, width, generator=generator, dtype=dtype)


@pytest.fixture(scope="module")
def colors() -> torch.Tensor:
    """Random colours, every mixture of 0, 1/2 and 1, and nearly black ones."""
    parts = [
        random_image().flatten(1),
        image_of(HALVES)[:, 0],
        random_image(5, 5).flatten(1) * 1e-4,
    ]
    return torch.cat(parts, 1)[:, None]


@pytest.mark.parametrize("name", planes_of_pixel(0, 0, 0))
def test_planes_follow_their_definition_pixel_by_pixel(colors, name):
    wanted = [planes_of_pixel(*pixel)[name] for pixel in colors[:, 0].T.double().tolist()]

    assert color_plane(colors.double(), name)[0].tolist() == pytest.approx(wanted, abs=1e-12)


@pytest.mark.parametrize("name", PLANES)
def test_single_precision_is_close_to_double(colors, name):
    difference = (color_plane(colors, name).double() - color_plane(colors.double(), name)).abs()
    if PLANES[name].circular:
        difference = torch.minimum(difference, 1 - difference)

    assert difference.max() < 3e-5  # the nearly black colours keep few digits


def test_lab_agrees_with_scikit_image(colors):
    wanted = rgb2lab(colors.double().permute(1, 2, 0).numpy()) / 100

    found = color_planes(colors.double(), ("L", "a", "b")).permute(1, 2, 0).numpy()

    # scikit-image divides by the tabulated white, of six digits
    np.testing.assert_allclose(found, wanted, atol=1e-4)


@pytest.mark.parametrize("name", PLANES)
def test_values_keep_to_their_bounds_and_the_corners_reach_them(colors, name):
    values = color_plane(torch.cat([colors, image_of(CORNERS)], 2), name)
    low, high = PLANES[name].low, PLANES[name].high

    assert values.min() >= low - 1e-6
    assert values.max() <= high + 1e-6
    if name != "H":
        corners = color_plane(image_of(CORNERS), name)
        assert corners.min() == pytest.approx(low, abs=1e-3)
        assert corners.max() == pytest.approx(high, abs=1e-3)


@given(st.tuples(UNIT, UNIT, UNIT))
@example((1.0, 0.0, 1e-30))  # just below red
@settings(max_examples=100, deadline=None)
def test_hue_never_reaches_a_whole_turn(color):
    assert 0 <= color_plane(image_of([color]), "H").item() < 1


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_batches_dtypes_and_the_image_are_kept(dtype):
    batch = torch.stack([random_image(dtype=dtype), random_image(dtype=dtype).flip(0)])
    before = batch.clone()

    found = color_planes(batch, tuple(PLANES))
    again = color_planes(batch[1], tuple(PLANES))

    assert found.shape == (2, len(PLANES), 40, 50)
    assert found.dtype == dtype
    torch.testing.assert_close(found[1], again)
    assert torch.equal(again[1], color_plane(batch[1], list(PLANES)[1]))
    again[:] = color_plane(batch[0], "R")[:] = 0  # no views of the image
    assert torch.equal(batch, before)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("size", [(1, 1), (3, 5), (241, 323)])
@pytest.mark.parametrize("name", ["nr", "ng", "O1", "O2", "a", "b", "H", "S"])
def test_chromatic_planes_of_grey_images_are_constant_to_the_bit(name, size, dtype):
    grey = torch.rand(1, *size, generator=torch.Generator().manual_seed(2), dtype=dtype)

    values = color_plane(grey.expand(3, -1, -1).contiguous(), name)

    expected = torch.tensor(1 / 3 if name in ("nr", "ng") else 0, dtype=dtype)
    assert torch.equal(values, expected.expand(size))


@pytest.mark.parametrize(
    ("shape", "names", "problem"),
    [
        ((3, 4, 4), ("R", "nrr"), "nrr: unknown plane .*nr"),
        ((4, 20, 20), ("R", "S"), r"image: has the shape .* \(give RGB as"),
        ((20, 20), ("R", "S"), r"image: has the shape .* \(give RGB as"),
    ],
)
def test_unknown_planes_and_what_is_no_image_are_refused(shape, names, problem):
    with pytest.raises((ConfigError, InputError), match=problem):
        color_planes(torch.zeros(shape), names)
