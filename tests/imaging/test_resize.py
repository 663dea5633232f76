"""The working size and the way back; dense motion."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch.nn import functional as F

from roadtorch.base.errors import ConfigError
from roadtorch.base.settings import build_settings
from roadtorch.imaging.motion import dense_flow, flow_image, forward_backward_error, warp
from roadtorch.imaging.resize import (
    SHORTEST,
    WorkingSize,
    resize_maps,
    resize_to_image,
    working_size,
)
from roadtorch.testing.scenes import render_scene

SIDES = st.integers(16, 4000)


@given(SIDES, SIDES, st.integers(256, 10**6))
def test_the_working_size_keeps_shape_and_bound(height: int, width: int, pixels: int) -> None:
    tall, wide = working_size(height, width, WorkingSize(pixels=pixels))

    assert SHORTEST <= tall <= height
    assert SHORTEST <= wide <= width
    if min(tall, wide) > SHORTEST:
        assert tall * wide <= pixels + (tall + wide) / 2  # each side is rounded by a half
        assert abs(tall / height - wide / width) <= 0.5 / height + 0.5 / width
    if height * width <= pixels:
        assert (tall, wide) == (height, width)


def test_a_working_size_may_be_written_as_its_help_writes_it() -> None:
    settings = build_settings(WorkingSize, {"pixels": "320x240"})

    assert settings.pixels == 320 * 240
    for wrong in ("320", "320x", "4x4", "0x0"):
        with pytest.raises(ConfigError, match="pixels"):
            build_settings(WorkingSize, {"pixels": wrong})


# --- sizes of maps ------------------------------------------------------------------------


@given(SIDES.filter(lambda side: side < 400), st.integers(1, 300), st.integers(0, 9))
def test_averaging_is_torchs_antialiased_filter(height: int, tall: int, seed: int) -> None:
    maps = torch.rand(2, height, 37, generator=torch.Generator().manual_seed(seed))

    result = resize_maps(maps, (tall, 16))

    batch = F.interpolate(maps[None], size=(tall, 16), mode="bilinear", antialias=True)
    torch.testing.assert_close(result, batch[0], atol=2e-5, rtol=0)


@pytest.mark.parametrize("size", [(20, 26), (21, 31), (5, 6)])
def test_labels_come_back_as_labels_and_masks_as_masks(size: tuple[int, int]) -> None:
    labels = torch.arange(130).reshape(10, 13)

    result, mask = resize_to_image(labels, size), resize_to_image(labels > 64, size)

    assert result.shape == mask.shape == size
    assert result.dtype == torch.int64
    assert torch.equal(mask, result > 64)
    for row, column in ((0, 0), (size[0] - 1, size[1] - 1), (size[0] // 2, 1)):
        assert result[row, column] == labels[row * 10 // size[0], column * 13 // size[1]]


# --- motion -------------------------------------------------------------------------------


def everywhere(right: float, down: float, height: int = 40, width: int = 60) -> torch.Tensor:
    return torch.tensor([right, down], dtype=torch.float32).expand(height, width, 2).contiguous()


def test_values_come_from_where_the_flow_points() -> None:
    plane = torch.arange(40 * 60, dtype=torch.float32).reshape(40, 60)
    row = torch.tensor([[0.0, 1.0, 4.0]]).repeat(3, 1)
    large = torch.rand(80, 120, generator=torch.Generator().manual_seed(0))

    assert torch.equal(warp(plane, everywhere(3, -2))[2:, :-3], plane[:-2, 3:])
    # Between pixels they are interpolated; outside, those at the edge.
    assert warp(row, everywhere(0.5, 0, 3, 3))[1].tolist() == pytest.approx([0.5, 2.5, 4.0])
    # A flow of another size moves by the same share of the image.
    moved = warp(large, everywhere(2, 1))
    assert torch.allclose(moved[:-2, :-4], large[2:, 4:], atol=1e-6)


def test_a_round_trip_closes_misses_or_leaves_the_image() -> None:
    there, back, off = everywhere(4, 0), everywhere(-4, 0), everywhere(-4, 3)

    closed, missed = forward_backward_error(there, back), forward_backward_error(there, off)

    assert (closed[:, :-4] == 0).all()
    assert closed[:, -4:].isinf().all()
    assert (missed[:, :-4] == 3).all()


def test_the_flow_of_a_shifted_street_is_the_shift() -> None:
    street = flow_image(render_scene(1, 120, 160, noise=0.0).image, 160)
    here, there = street[:, :-6].contiguous(), street[:, 6:].contiguous()

    # What is at column x of ``here`` is at column x - 6 of ``there``.
    flow = dense_flow(here, there)

    inner = flow[20:-20, 30:-30]
    assert float(inner[..., 0].median()) == pytest.approx(-6, abs=0.1)
    assert float(inner[..., 1].median()) == pytest.approx(0, abs=0.1)


@pytest.mark.parametrize(
    ("size", "wanted"),
    [((270, 480), (135, 240)), ((33, 40), (33, 40)), ((16, 900), (32, 240)), ((16, 16), (32, 32))],
)
def test_small_images_keep_their_shape_and_enough_rows_for_the_flow(size, wanted) -> None:
    image = torch.full((3, *size), 0.5)

    grey = flow_image(image, 240)

    assert tuple(grey.shape) == wanted
    assert grey.dtype == torch.uint8
    assert set(np.unique(grey.numpy())) == {128}
