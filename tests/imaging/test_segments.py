"""Superpixels and their repair, what is measured of them, their likeness, and densities."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage
from torch import Tensor

from roadtorch.imaging import slic as superpixels
from roadtorch.imaging.color import color_planes
from roadtorch.imaging.connectivity import connect
from roadtorch.imaging.segments import (
    Bandwidths,
    class_log_density,
    gradient_magnitude,
    measure_segments,
    paint_segments,
    segment_affinity,
    segment_borders,
    segment_histogram,
    segment_mean,
    segment_median,
    segment_size,
)
from roadtorch.imaging.slic import slic, square_grid
from tests.draws import random, seeded_generator
from tests.reference import superpixels as reference


def noise(height: int, width: int) -> Tensor:
    return random(3, height, width, dtype=torch.float32)


# --- statistics over segments -------------------------------------------------------------


def means_of(values: Tensor, labels: Tensor, count: int) -> Tensor:
    """Means of values (C,H,W) over each of ``count`` segments of labels (H,W): (C,count)."""
    return segment_mean(values, labels, segment_size(labels, count))


@pytest.mark.parametrize("seed", range(25))
def test_statistics_over_segments_are_those_of_loops(seed: int) -> None:
    generator = seeded_generator(seed)
    channels, height, width, count, bins = torch.randint(1, 7, (5,), generator=generator).tolist()
    values = torch.randn(channels, height, width, generator=generator).mul(3).round()
    labels = torch.randint(count, (height, width), generator=generator)  # some may be empty

    levels = (values[0].abs() * 2).long().clamp_max(bins - 1)
    histogram = segment_histogram(levels, labels, count, bins)
    pairs, means = segment_borders(labels, values[0])
    painted = paint_segments(torch.arange(2.0 * count).reshape(2, count), labels)

    for number in range(count):
        inside = values[:, labels == number]
        size = inside.shape[1]
        mean = inside.mean(1) if size else torch.zeros(channels)
        median = inside.sort(1).values[:, (size - 1) // 2] if size else torch.zeros(channels)
        np.testing.assert_allclose(means_of(values, labels, count)[:, number], mean, atol=1e-5)
        assert torch.equal(segment_median(values, labels, count)[:, number], median)
        shares = levels[labels == number].bincount(minlength=bins)
        assert histogram[number].tolist() == shares.tolist()
        assert (torch.tensor([number, count + number]) == painted[:, labels == number].T).all()
    expected = reference.borders(labels.numpy(), values[0].numpy())
    assert (pairs.dtype, pairs.shape) == (torch.int64, (2, len(expected)))
    found = {tuple(pair): mean for pair, mean in zip(pairs.T.tolist(), means.tolist(), strict=True)}
    assert found == pytest.approx(expected, abs=1e-5)


def test_the_mean_over_a_million_pixels_is_exact_to_five_digits() -> None:
    labels = torch.zeros(1000, 1000, dtype=torch.int64)

    mean = means_of(torch.full((1, 1000, 1000), 0.1), labels, 1)

    assert float(mean) == pytest.approx(0.1, abs=1e-6)


# --- measures -----------------------------------------------------------------------------


def test_gradients_are_those_of_numpy_but_0_at_the_edges() -> None:
    plane = noise(6, 5)[0]

    down, across = np.gradient(plane.numpy())

    down[[0, -1]], across[:, [0, -1]] = 0, 0
    np.testing.assert_allclose(gradient_magnitude(plane), np.hypot(across, down), atol=1e-6)


def test_segments_are_measured_by_their_pixels() -> None:
    image = noise(24, 36)
    labels = slic(image, 12)

    segments = measure_segments(image, labels)

    lab = color_planes(image, ("L", "a", "b"))
    gradient = gradient_magnitude(lab[0])
    for number in range(int(labels.max()) + 1):
        inside = labels == number
        rows, columns = inside.nonzero().T
        expected = {
            "gradient": gradient[inside].mean(),
            "contrast": lab[0][inside].std(unbiased=False),
            "row": (rows + 0.5).mean() / 24,
            "column": (columns + 0.5).mean() / 36,
            "size": inside.float().mean(),
        }
        np.testing.assert_allclose(segments.color[:, number], lab[:, inside].mean(1), atol=1e-5)
        for name, value in expected.items():
            measured = float(getattr(segments, name)[number])
            assert measured == pytest.approx(float(value), abs=2e-3 if name == "contrast" else 1e-5)
    assert float(segments.size.sum()) == pytest.approx(1, abs=1e-5)
    assert torch.equal(segments.pairs, segment_borders(labels, gradient)[0])
    assert segments.contrast_between.shape == (segments.pairs.shape[1],)


def test_the_contrast_between_segments_is_that_of_the_edge_between_them() -> None:
    image = torch.full((3, 20, 40), 0.5)
    image[1, :, 20:] = 0.6
    labels = torch.arange(40).div(10, rounding_mode="floor").expand(20, 40)

    segments = measure_segments(image, labels)

    assert segments.pairs.tolist() == [[0, 1, 2], [1, 2, 3]]
    first, edge, last = segments.contrast_between.tolist()
    assert max(first, last) < 1e-5
    assert edge > 0.005


# --- likeness and densities ---------------------------------------------------------------


@pytest.mark.parametrize("count", [9, 60])
def test_likeness_is_a_product_of_gaussians(count: int) -> None:
    image = noise(40, 60) * 0.5
    segments = measure_segments(image, slic(image, count))
    widths = Bandwidths(0.135, 0.045, 0.07, 0.09, 0.4, 0.3)

    alike = segment_affinity(segments, widths)

    squared = torch.zeros(len(segments.size), len(segments.size), dtype=torch.float64)
    for values, width in (
        (segments.color[0], widths.lightness),
        (segments.color[1], widths.chroma),
        (segments.color[2], widths.chroma),
        (segments.gradient, widths.gradient),
        (segments.contrast, widths.contrast),
        (segments.row, widths.row),
        (segments.column, widths.column),
    ):
        squared += ((values[:, None] - values[None]).double() / width).square()
    np.testing.assert_allclose(alike, (squared / -2).exp(), atol=1e-4)


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("apart", [0.5, 3.0, 20.0])
def test_the_density_of_a_class_is_a_weighted_mean_of_likeness(seed: int, apart: float) -> None:
    count, classes = seed % 6 + 1, seed % 3 + 1
    points = random(count, 2, seed=seed) * apart
    alike = torch.exp(-torch.cdist(points, points).square() / 2)
    posterior, size = random(count, classes, seed=seed + 1), random(count, seed=seed + 2) + 0.1

    found = class_log_density(alike, posterior, size / size.sum())

    weights = posterior * (size / size.sum())[:, None]
    for segment, kind in np.ndindex(count, classes):
        total = sum(float(weights[other, kind] * alike[segment, other]) for other in range(count))
        support = float(weights[:, kind].sum())
        expected = np.log(max(total / max(support, 1e-3), 1e-8))
        assert float(found[segment, kind]) == pytest.approx(expected, abs=1e-3)


# --- SLIC ---------------------------------------------------------------------------------


def textured(height: int, width: int, seed: int = 0) -> Tensor:
    """Soft blobs of colour with some grain, (3,H,W) in [0,1]."""
    generator = seeded_generator(seed)
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
def test_segments_of_any_image_are_connected_and_numbered(height: int, width: int) -> None:
    labels = slic(textured(height, width), segments=60)

    assert labels.shape == (height, width)
    check_segments(labels)


@pytest.mark.parametrize("grey", [0.0, 0.5, 1.0])
@pytest.mark.parametrize(("height", "width"), [(16, 16), (64, 96)])
def test_a_flat_image_is_cut_into_even_pieces(grey: float, height: int, width: int) -> None:
    labels = slic(torch.full((3, height, width), grey), segments=12)

    count = check_segments(labels)
    assert 9 <= count <= 16
    sizes = labels.reshape(-1).bincount()
    assert sizes.max() <= 2 * sizes.min()


@pytest.mark.parametrize(("height", "width"), [(120, 160), (97, 211), (240, 320)])
@pytest.mark.parametrize("segments", [50, 300])
def test_about_as_many_segments_as_asked_for(height: int, width: int, segments: int) -> None:
    count = int(slic(textured(height, width), segments).max()) + 1

    assert 0.75 * segments <= count <= 1.35 * segments


def test_segments_keep_to_a_slanted_edge() -> None:
    light = torch.arange(160) / 160 > 0.3 + 0.37 * torch.arange(120)[:, None] / 120

    labels = slic(torch.where(light, 0.7, 0.3).expand(3, 120, 160), segments=80)

    lit, dark = (labels[side].bincount(minlength=100) for side in (light, ~light))
    assert torch.minimum(lit, dark).max() <= 4  # of about 240 pixels each


# --- the nearest of nine centres ----------------------------------------------------------


@pytest.mark.parametrize(("height", "width"), [(30, 44), (25, 31)])
def test_each_pixel_goes_to_the_nearest_of_nine_centres(height: int, width: int) -> None:
    # Inside slic, because its result is repaired by ``connect`` before it comes out.
    grid, image = superpixels._grid(height, width, 20), textured(height, width)
    maps = superpixels._distance_maps(grid, 0.1 * 0.12)
    sums = superpixels._move_centres(image, grid, maps)
    owner = superpixels._assign(image, superpixels._coefficients(sums, maps), grid).numpy()
    metric, sums = maps.metric, sums[:-1]

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
def test_small_regions_join_others(seed: int, height: int, width: int, smallest: int) -> None:
    labels = torch.randint(5, (height, width), generator=seeded_generator(seed))

    found = connect(labels, smallest)

    check_segments(found)
    assert np.array_equal(found, reference.connected(labels.numpy(), smallest))


def test_squares_are_numbered_by_rows_and_cut_off_at_the_edges():
    assert square_grid(3, 5, 2).tolist() == [[0, 0, 1, 1, 2], [0, 0, 1, 1, 2], [3, 3, 4, 4, 5]]
