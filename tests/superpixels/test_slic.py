"""SLIC superpixels, their repair, and statistics over segments."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy import ndimage
from torch import Tensor

from roadtorch.errors import ConfigError
from roadtorch.superpixels import slic as superpixels
from roadtorch.superpixels.connectivity import connect
from roadtorch.superpixels.segments import (
    borders,
    paint,
    segment_histogram,
    segment_mean,
    segment_median,
    segment_size,
)
from roadtorch.superpixels.slic import slic, squares
from tests.reference import superpixels as reference


def textured(height: int, width: int, seed: int = 0) -> Tensor:
    """Soft blobs of colour with some grain, (3,H,W) in [0,1]."""
    generator = torch.Generator().manual_seed(seed)
    coarse = torch.rand(1, 3, max(2, height // 12), max(2, width // 12), generator=generator)
    blobs = torch.nn.functional.interpolate(coarse, (height, width), mode="bicubic")[0]
    return (blobs + 0.03 * torch.randn(3, height, width, generator=generator)).clamp(0, 1)


def slanted(height: int, width: int) -> tuple[Tensor, Tensor]:
    """A dark and a light half that meet in a slanted line: the picture, and where it is light."""
    rows = torch.arange(height)[:, None] / height
    light = torch.arange(width) / width > 0.3 + 0.37 * rows
    return torch.where(light, 0.7, 0.3).expand(3, height, width), light


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


def test_one_segment_is_the_whole_picture() -> None:
    assert slic(textured(40, 30), segments=1).max() == 0


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

    together = slic(images, segments=40)

    assert together.shape == (3, height, width)
    for image, labels in zip(images, together, strict=True):
        assert torch.equal(labels, slic(image, segments=40))


def test_segments_keep_to_a_slanted_edge() -> None:
    image, light = slanted(120, 160)

    labels = slic(image, segments=80)

    size = labels.reshape(-1).bincount()
    lit = segment_mean(light[None].float(), labels, size)[0] * size
    mixed = torch.minimum(lit, size - lit)
    assert mixed.max() <= 4  # of about 240 pixels each


def test_a_compact_cut_ignores_the_edge_that_a_loose_one_follows() -> None:
    image, light = slanted(120, 160)

    def mixed(compactness: float) -> float:
        labels = slic(image, 80, compactness)
        share = means_of(light[None].float(), labels, int(labels.max()) + 1)[0]
        return float((share.minimum(1 - share)).max())

    assert mixed(0.05) < 0.05
    assert mixed(20.0) > 0.25


@pytest.mark.parametrize(
    "wrong",
    [
        {"segments": 0},
        {"segments": -3},
        {"compactness": 0.0},
        {"compactness": -1.0},
        {"iterations": 0},
    ],
)
def test_settings_out_of_range_are_refused(wrong: dict) -> None:
    ((name, value),) = wrong.items()

    with pytest.raises(ConfigError, match=f"superpixels: .*{name}={value}"):
        slic(torch.zeros(3, 16, 16), **wrong)


# --- the nearest of nine centres ----------------------------------------------------------


@pytest.mark.parametrize(("height", "width"), [(30, 44), (25, 31)])
def test_each_pixel_goes_to_the_nearest_of_the_nine_centres_around_its_cell(
    height: int, width: int
) -> None:
    # Inside slic, because its result is repaired by ``connect`` before it comes out.
    grid, image = superpixels._grid(height, width, 20), textured(height, width)
    moves = superpixels._moves(grid, 0.1 * 0.12, 1)
    sums = superpixels._move_centres(image[None], grid, moves, 3)
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


label_maps = st.tuples(st.integers(1, 9), st.integers(1, 9)).flatmap(
    lambda size: st.lists(
        st.integers(0, 4), min_size=size[0] * size[1], max_size=size[0] * size[1]
    ).map(lambda values: torch.tensor(values).reshape(*size))
)


@given(label_maps, st.integers(1, 12))
def test_the_largest_region_of_each_label_stays_and_the_others_join_one(
    labels: Tensor, smallest: int
) -> None:
    result = connect(labels[None], smallest)[0]

    check_segments(result)
    regions = reference.regions(labels.numpy())
    sizes: dict[int, list[set[tuple[int, int]]]] = {}
    for region in sorted(regions, key=len):
        sizes.setdefault(int(labels[next(iter(region))]), []).append(region)
    largest = [found[-1] for found in sizes.values() if len(found[-1]) >= smallest]
    assert int(result.max()) + 1 == max(1, len(largest))

    whole = [region for region in regions if len({int(result[place]) for place in region}) == 1]
    kept = set()
    for label, found in sizes.items():
        if len(found[-1]) >= smallest:
            # Of several equally large regions any one may stay.
            equal = [region for region in found if len(region) == len(found[-1])]
            numbers = {int(result[next(iter(region))]) for region in equal if region in whole}
            assert numbers, f"no largest region of label {label} stayed whole"
            kept |= numbers
    assert not largest or kept == set(range(len(largest)))


def test_where_every_region_is_too_small_the_largest_one_takes_all() -> None:
    labels = torch.tensor([[0, 1, 0], [1, 1, 0], [0, 1, 0]])

    assert torch.equal(connect(labels[None], smallest=100), torch.zeros(1, 3, 3, dtype=torch.int64))


def test_tiny_regions_that_touch_no_settled_one_are_reached_through_others() -> None:
    labels = torch.tensor([[0, 0, 0, 1, 2, 3, 4]])

    assert torch.equal(connect(labels[None], smallest=2), torch.zeros(1, 1, 7, dtype=torch.int64))


def test_pictures_of_a_batch_are_repaired_apart() -> None:
    generator = torch.Generator().manual_seed(0)
    labels = torch.randint(0, 5, (4, 11, 13), generator=generator)

    together = connect(labels, 3)

    for one, result in zip(labels, together, strict=True):
        assert torch.equal(connect(one[None], 3)[0], result)


# --- statistics over segments -------------------------------------------------------------


@st.composite
def segmented(draw: st.DrawFn) -> tuple[Tensor, Tensor, int]:
    """Values (C,H,W), labels (H,W) and a count of segments, some of which may be empty."""
    height, width, channels = draw(
        st.tuples(st.integers(1, 6), st.integers(1, 6), st.integers(1, 3))
    )
    count = draw(st.integers(1, 7))
    values = st.floats(-4, 4, width=32)
    pixels = height * width
    flat = draw(st.lists(values, min_size=channels * pixels, max_size=channels * pixels))
    labels = draw(st.lists(st.integers(0, count - 1), min_size=pixels, max_size=pixels))
    shape = (channels, height, width)
    return torch.tensor(flat).reshape(shape), torch.tensor(labels).reshape(shape[1:]), count


def means_of(values: Tensor, labels: Tensor, count: int) -> Tensor:
    """Means of values (C,H,W) over each of ``count`` segments of labels (H,W): (C,count)."""
    return segment_mean(values, labels, segment_size(labels, count))


def expected(statistic, values: Tensor, labels: Tensor, count: int) -> Tensor:
    """A statistic of each channel in each segment; 0 in empty ones."""
    found = reference.segment_values(values.double().numpy(), labels.numpy(), count)
    return torch.tensor(
        [[float(statistic(part)) if len(part) else 0.0 for part in channel] for channel in found]
    )


@given(segmented())
def test_means_are_those_of_a_loop(case: tuple[Tensor, Tensor, int]) -> None:
    torch.testing.assert_close(means_of(*case), expected(np.mean, *case), atol=1e-5, rtol=1e-5)


@given(segmented())
def test_medians_are_the_lower_middle_of_the_sorted_values(
    case: tuple[Tensor, Tensor, int],
) -> None:
    def lower_median(part: np.ndarray) -> float:
        return sorted(part)[(len(part) - 1) // 2]

    torch.testing.assert_close(
        segment_median(*case), expected(lower_median, *case), atol=0.0, rtol=0.0
    )


@given(segmented(), st.integers(2, 9))
def test_histograms_are_those_of_a_loop(case: tuple[Tensor, Tensor, int], bins: int) -> None:
    values, labels, count = case
    levels = (values[0].abs() * 2).long().clamp_max(bins - 1)

    counts = segment_histogram(levels, labels, count, bins)

    assert counts.dtype == torch.float32
    wanted = reference.histogram(levels.numpy(), labels.numpy(), count, bins)
    assert np.array_equal(counts.numpy(), wanted)


def test_pixels_without_weight_do_not_enter_a_histogram() -> None:
    levels = torch.tensor([[0, 1], [1, 1]])
    labels = torch.tensor([[0, 0], [1, 1]])
    usable = torch.tensor([[True, False], [True, True]])

    counts = segment_histogram(levels, labels, 3, 2, usable)

    assert counts.tolist() == [[1, 0], [0, 2], [0, 0]]


def test_the_mean_over_a_million_pixels_is_exact_to_five_digits() -> None:
    labels = torch.zeros(1000, 1000, dtype=torch.int64)

    mean = means_of(torch.full((1, 1000, 1000), 0.1), labels, 1)

    torch.testing.assert_close(mean, torch.tensor([[0.1]]), atol=1e-6, rtol=0.0)


def test_statistics_keep_the_dtype() -> None:
    values, labels = torch.rand(2, 4, 4, dtype=torch.float64), torch.zeros(4, 4, dtype=torch.int64)

    for statistic in (means_of, segment_median):
        assert statistic(values, labels, 1).dtype == torch.float64


@given(segmented())
def test_painting_gives_each_pixel_its_segments_value(case: tuple[Tensor, Tensor, int]) -> None:
    _, labels, count = case
    values = torch.arange(2.0 * count).reshape(2, count)

    painted = paint(values, labels)

    assert painted.shape == (2, *labels.shape)
    for row, column in np.ndindex(*labels.shape):
        assert torch.equal(painted[:, row, column], values[:, labels[row, column]])


@given(segmented())
def test_borders_are_those_of_a_double_loop(case: tuple[Tensor, Tensor, int]) -> None:
    values, labels, _ = case

    pairs, means = borders(labels, values[0])

    wanted = reference.borders(labels.numpy(), values[0].numpy())
    assert pairs.dtype == torch.int64
    assert pairs.shape == (2, len(wanted))
    assert {tuple(pair) for pair in pairs.T.tolist()} == set(wanted)
    for pair, mean in zip(pairs.T.tolist(), means.tolist(), strict=True):
        assert mean == pytest.approx(wanted[pair[0], pair[1]], abs=1e-5)


def test_a_single_segment_has_no_border() -> None:
    pairs, means = borders(torch.zeros(5, 4, dtype=torch.int64), torch.rand(5, 4))

    assert pairs.shape == (2, 0)
    assert means.shape == (0,)


def test_squares_are_numbered_by_rows_and_cut_off_at_the_edges():
    assert squares(3, 5, 2).tolist() == [[0, 0, 1, 1, 2], [0, 0, 1, 1, 2], [3, 3, 4, 4, 5]]


def test_squares_have_at_least_one_pixel():
    with pytest.raises(ConfigError, match="size: 0 was given"):
        squares(4, 4, 0)
