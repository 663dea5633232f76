"""The steps before and behind a network, for a batch: the same as for one picture."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch.nn import functional as F

from roadtorch.export.graph import averaged, averaging, normalised, planes_of, size_at_work
from roadtorch.imaging.resize import WorkingSize, working_size
from roadtorch.layout.patch_network import Normalisation, normalise
from roadtorch.testing import street

SIDES = st.integers(1, 80)


@settings(max_examples=30)
@given(SIDES, SIDES, SIDES, SIDES)
def test_matrices_resize_as_torch_does(height: int, width: int, rows: int, columns: int) -> None:
    maps = torch.rand(2, 3, height, width)

    expected = F.interpolate(maps, (rows, columns), mode="bilinear", antialias=True)
    assert torch.allclose(averaged(maps, rows, columns), expected, atol=1e-5)


def test_halving_a_row_weighs_four_pixels_and_fewer_at_its_ends() -> None:
    matrix = averaging(6, 3)

    assert torch.allclose(matrix[1], torch.tensor([0, 1, 3, 3, 1, 0]) / 8)
    assert torch.allclose(matrix[0], torch.tensor([3, 3, 1, 0, 0, 0]) / 7)


@given(st.integers(16, 3000), st.integers(16, 3000))
def test_the_working_size_is_that_of_detectors(height: int, width: int) -> None:
    planes = torch.empty(1, 0, height, width)

    assert size_at_work(planes, WorkingSize()) == working_size(height, width, WorkingSize())


@pytest.mark.parametrize("kind", ["fixed", "picture", "brightened", "brightened picture"])
def test_each_picture_of_a_batch_is_normalised_for_itself(kind: str) -> None:
    normalisation = Normalisation.model_validate({"kind": kind})
    images = torch.stack([street(61, 80), street(61, 80) * 0.1, torch.zeros(3, 61, 80)])

    expected = torch.stack([normalise(image, normalisation).pixels for image in images])
    assert torch.allclose(normalised(images, normalisation), expected, atol=2e-5)


def test_bytes_become_planes() -> None:
    image = torch.tensor([[[[255, 0, 51]]]], dtype=torch.uint8)

    assert torch.equal(planes_of(image), torch.tensor([1, 0, 0.2]).view(1, 3, 1, 1))
