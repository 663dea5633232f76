"""The working size and the way back."""

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor
from torch.nn import functional as F

from roadtorch.imaging.resize import (
    SHORTEST,
    WorkingSize,
    at_picture_size,
    at_working_size,
    resized,
    working_size,
)

SIDES = st.integers(16, 4000)


@given(SIDES, SIDES, st.integers(256, 10**6))
def test_the_working_size_is_the_pictures_shape_with_at_most_so_many_pixels(
    height: int, width: int, pixels: int
) -> None:
    tall, wide = working_size(height, width, WorkingSize(pixels=pixels))

    assert SHORTEST <= tall <= height
    assert SHORTEST <= wide <= width
    if min(tall, wide) > SHORTEST:
        assert tall * wide <= pixels + (tall + wide) / 2  # each side is rounded by a half
        assert abs(tall / height - wide / width) <= 0.5 / height + 0.5 / width
    if height * width <= pixels:
        assert (tall, wide) == (height, width)


# --- sizes of maps ------------------------------------------------------------------------


@given(SIDES.filter(lambda side: side < 400), st.integers(1, 300), st.integers(0, 9))
def test_averaging_is_torchs_antialiased_filter(height: int, tall: int, seed: int) -> None:
    maps = torch.rand(2, height, 37, generator=torch.Generator().manual_seed(seed))

    result = resized(maps, (tall, 16))

    batch = F.interpolate(maps[None], size=(tall, 16), mode="bilinear", antialias=True)
    torch.testing.assert_close(result, batch[0], atol=2e-5, rtol=0)


@pytest.mark.parametrize("shape", [(20, 30), (3, 20, 30), (2, 3, 20, 30)])
@pytest.mark.parametrize("size", [(10, 15), (7, 44), (41, 61)])
def test_maps_of_any_dimensions_are_resized_within_their_range(
    shape: tuple[int, ...], size: tuple[int, int]
) -> None:
    maps = torch.rand(shape, generator=torch.Generator().manual_seed(0))

    result = resized(maps, size)

    assert result.shape == (*shape[:-2], *size)
    assert result.min() >= maps.min() - 1e-5
    assert result.max() <= maps.max() + 1e-5


@pytest.mark.parametrize("size", [(20, 26), (21, 31), (5, 6)])
def test_labels_come_back_as_labels_and_masks_as_masks(size: tuple[int, int]) -> None:
    labels = torch.arange(130).reshape(10, 13)

    result, mask = at_picture_size(labels, size), at_picture_size(labels > 64, size)

    assert result.shape == mask.shape == size
    assert result.dtype == torch.int64
    assert torch.equal(mask, result > 64)
    for row, column in ((0, 0), (size[0] - 1, size[1] - 1), (size[0] // 2, 1)):
        assert result[row, column] == labels[row * 10 // size[0], column * 13 // size[1]]


def test_an_analysis_at_working_size_sees_a_small_picture_and_answers_at_full_size() -> None:
    seen = []

    def analyse(image: Tensor) -> dict[str, Tensor]:
        seen.append(image)
        return {"likelihood": image[0], "segments": (image[0] > 0.5).long(), "mask": image[1] > 0.5}

    image = torch.rand(3, 100, 200, generator=torch.Generator().manual_seed(0)).round()
    cues = at_working_size(analyse, image, WorkingSize(pixels=20 * 40))

    assert seen[0].shape == (3, 20, 40)
    assert 0 <= seen[0].min() <= seen[0].max() <= 1
    assert {name: tuple(cue.shape) for name, cue in cues.items()} == dict.fromkeys(
        ("likelihood", "segments", "mask"), (100, 200)
    )
    assert (cues["likelihood"].dtype, cues["mask"].dtype) == (torch.float32, torch.bool)
