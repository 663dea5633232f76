"""SLIC superpixels and their repair, and the squares that P2 compares them with."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage
from torch import Tensor

from roadtorch.imaging import slic as superpixels
from roadtorch.imaging.connectivity import connect
from roadtorch.imaging.slic import slic, squares
from tests.draws import seeded
from tests.reference import superpixels as reference


def textured(height: int, width: int, seed: int = 0) -> Tensor:
    """Soft blobs of colour with some grain, (3,H,W) in [0,1]."""
    generator = seeded(seed)
    coarse = torch.rand(1, 3, max(2, height // 12), max(2, width // 12), generator=generator)
    blobs = torch.nn.functional.interpolate(coarse, (height, width), mode="bicubic")[0]
    return (blobs + 0.03 * torch.randn(3, height, width, generator=generator)).clamp(0, 1)


def check_segments(labels: Tensor) -> int:
    """Assert that labels (H,W) are int64, without gaps and 4-connected; how many there are."""
    assert labels.dtype == torch.int64
    count = int(labels.max()) + 1
    assert torch.equal(labels.unique(), torch.arange(count))
    for number, place in enumerate(ndimage.find_objects(labels.numpy() + 1)):
        inside = labels.numpy()[place] == number
        pieces = np.zeros(inside.shape, np.int32)
        ndimage.label(inside, output=pieces)
        assert pieces.max() == 1, f"segment {number} is in pieces"
    return count


# --- slic ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("height", "width"),
    [(16, 16), (17, 16), (16, 201), (203, 17), (97, 131), (120, 160), (1, 60), (60, 1), (2, 33)],
)
def test_the_segments_of_a_picture_of_any_size_are_connected_and_numbered_without_gaps(
    height: int, width: int
) -> None:
    labels = slic(textured(height, width), segments=60)

    assert labels.shape == (height, width)
    check_segments(labels)


@pytest.mark.parametrize("grey", [0.0, 0.5, 1.0])
@pytest.mark.parametrize(("height", "width"), [(16, 16), (64, 96)])
def test_a_flat_picture_is_cut_into_even_pieces(grey: float, height: int, width: int) -> None:
    labels = slic(torch.full((3, height, width), grey), segments=12)

    count = check_segments(labels)
    assert 9 <= count <= 16
    sizes = labels.reshape(-1).bincount()
    assert sizes.max() <= 2 * sizes.min()


@pytest.mark.parametrize(("height", "width"), [(120, 160), (97, 211), (240, 320)])
@pytest.mark.parametrize("segments", [50, 300])
def test_about_as_many_segments_come_out_as_asked_for(
    height: int, width: int, segments: int
) -> None:
    count = int(slic(textured(height, width), segments).max()) + 1

    assert 0.75 * segments <= count <= 1.35 * segments


@pytest.mark.parametrize(("height", "width"), [(48, 64), (33, 47)])
def test_a_batch_gives_the_segments_of_each_picture_alone(height: int, width: int) -> None:
    images = torch.stack(
        [textured(height, width, 1), torch.zeros(3, height, width), textured(height, width, 2)]
    )

    alone = torch.stack([slic(image, segments=40) for image in images])
    assert torch.equal(slic(images, segments=40), alone)


def test_segments_keep_to_a_slanted_edge() -> None:
    light = torch.arange(160) / 160 > 0.3 + 0.37 * torch.arange(120)[:, None] / 120

    labels = slic(torch.where(light, 0.7, 0.3).expand(3, 120, 160), segments=80)

    lit, dark = (labels[side].bincount(minlength=100) for side in (light, ~light))
    assert torch.minimum(lit, dark).max() <= 4  # of about 240 pixels each


# --- the nearest of nine centres ----------------------------------------------------------


@pytest.mark.parametrize(("height", "width"), [(30, 44), (25, 31)])
def test_each_pixel_goes_to_the_nearest_of_the_nine_centres_around_its_cell(
    height: int, width: int
) -> None:
    # Inside slic, because its result is repaired by ``connect`` before it comes out.
    grid, image = superpixels._grid(height, width, 20), textured(height, width)
    moves = superpixels._moves(grid, 0.1 * 0.12, 1)
    sums = superpixels._move_centres(image[None], grid, moves)
    owner = superpixels._assign(image[None], superpixels._tables(sums, moves), grid)[0].numpy()
    metric, sums = moves.metric, sums[:-1]

    root = np.linalg.cholesky(metric.double().numpy()).T  # |f-c| in the metric is |root(f-c)|
    sums = sums.double().numpy().T.reshape(6, grid.rows, grid.columns)
    centres = sums[:5] / sums[5]
    centres[3] += (np.arange(grid.rows)[:, None] + 0.5) * grid.height - 0.5
    centres[4] += (np.arange(grid.columns) + 0.5) * grid.width - 0.5
    centres = np.einsum("ij,jrc->irc", root, centres)
    most = superpixels.MAX_LAB_SQUARE + metric[3, 3].item() * (grid.height**2 + grid.width**2) / 4
    for row, column in np.ndindex(height, width):
        pixel = root @ np.array([*image[:, row, column].double(), row, column])
        cell = (row // grid.height, column // grid.width)
        squared = reference.nine_distances(pixel, cell, centres)
        chosen = squared[divmod(int(owner[row, column]), grid.columns)]
        # What is compared is below twice ``most``; 2⁻¹⁹ of it is given away on purpose.
        assert chosen <= min(squared.values()) + 2 * most * (2**-19 + 2**-20)


# --- connect ------------------------------------------------------------------------------


@settings(max_examples=80)
@given(st.integers(0, 10**6), st.integers(1, 9), st.integers(1, 9), st.integers(1, 12))
def test_the_largest_region_of_each_label_stays_and_the_others_join_one(
    seed: int, height: int, width: int, smallest: int
) -> None:
    labels = torch.randint(5, (1, height, width), generator=seeded(seed))

    found = connect(labels, smallest)[0]

    check_segments(found)
    assert np.array_equal(found, reference.connected(labels[0].numpy(), smallest))


@pytest.mark.parametrize(
    ("labels", "smallest"),
    [
        ([[0, 1, 0], [1, 1, 0], [0, 1, 0]], 100),  # every region is too small
        ([[0, 0, 0, 1, 2, 3, 4]], 2),  # tiny ones that touch no settled one
    ],
)
def test_the_largest_one_takes_all_through_others(labels: list, smallest: int) -> None:
    assert not connect(torch.tensor([labels]), smallest).any()


def test_squares_are_numbered_by_rows_and_cut_off_at_the_edges():
    assert squares(3, 5, 2).tolist() == [[0, 0, 1, 1, 2], [0, 0, 1, 1, 2], [3, 3, 4, 4, 5]]
