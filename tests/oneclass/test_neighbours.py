"""Nearest neighbour and minimum spanning tree against loops over samples and edges."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor

from roadtorch.errors import InputError
from roadtorch.oneclass import neighbours
from roadtorch.oneclass.neighbours import MST, NN, NearestSettings, SpanningTreeSettings
from tests.oneclass.cases import DIMENSIONS, doubles, fitted, kept, some
from tests.reference import oneclass_boundary as reference

RATIO = NearestSettings(reading="ratio")


def road(number: int, dimensions: int) -> Tensor:
    return some(number, dimensions, seed=1, spread=0.2)


def edges_of(samples: Tensor) -> list[tuple[int, int]]:
    return [(int(i), int(j)) for i, j in neighbours.spanning_tree(samples.double())]


# --- nearest neighbour ------------------------------------------------------------------


@DIMENSIONS
def test_nearest_distance_is_that_of_a_loop_and_zero_exactly_at_a_sample(dimensions):
    samples, pixels = road(90, dimensions), some(1000, dimensions)
    learned = fitted(NN, samples)
    expected = reference.nearest_distance(doubles(samples), doubles(pixels))
    np.testing.assert_allclose(doubles(learned.distance(pixels)), expected, rtol=1e-6, atol=0)
    assert (learned.distance(samples) == 0).all()


def test_near_pixels_keep_their_digits_far_from_the_origin():
    samples = torch.tensor([[0.9, 0.9, 0.9], [0.1, 0.1, 0.1]])
    pixels = samples[:1] + torch.tensor([[3e-5, 0, 0], [6e-5, 0, 0]])
    distance = doubles(fitted(NN, samples).distance(pixels))
    expected = reference.nearest_distance(doubles(samples), doubles(pixels))
    np.testing.assert_allclose(distance, expected, rtol=1e-6)


@DIMENSIONS
def test_ratio_is_that_of_a_loop_and_ignores_twins(dimensions):
    samples, pixels = road(40, dimensions), some(500, dimensions)
    expected = reference.nearest_ratio(doubles(samples), doubles(pixels))
    for given_samples in (samples, samples.repeat(2, 1)):
        ratio = fitted(NN, given_samples, RATIO).distance(pixels)
        np.testing.assert_allclose(doubles(ratio), expected, rtol=1e-5)


def test_ratio_of_samples_of_one_colour_is_the_distance():
    samples, pixels = torch.full((5, 3), 0.5), some(50, 3)
    ratio, plain = fitted(NN, samples, RATIO), fitted(NN, samples)
    assert torch.equal(ratio.distance(pixels), plain.distance(pixels))
    assert ratio.distance(pixels).isfinite().all()


@pytest.mark.parametrize(
    ("values", "reading", "half"),
    [
        ([0.1, 0.2, 0.4, 0.8], "distance", 0.15),  # to the next sample: 0.1, 0.1, 0.2, 0.4
        ([0.1, 0.2, 0.4, 0.8], "ratio", 1.5),  # over the next one's: 1, 1, 0.2/0.1, 0.4/0.2
        ([0.1, 0.1, 0.4, 0.8], "distance", 0.15),  # 0, 0, 0.3, 0.4: a twin is a neighbour
    ],
)
def test_threshold_leaves_each_sample_out(values, reading, half):
    settings = NearestSettings.model_validate({"rejected": 0.5, "reading": reading})
    learned = fitted(NN, torch.tensor(values)[:, None], settings)
    assert float(learned.threshold) == pytest.approx(half)
    assert len(kept(learned, "points")) == len(set(values))


@given(st.integers(1, 3), st.integers(1, 20), st.integers(0, 1000))
def test_order_and_twins_of_samples_change_no_distance(dimensions, number, seed):
    samples, pixels = some(number, dimensions, seed), some(30, dimensions, seed + 1)
    order = torch.randperm(number, generator=torch.Generator().manual_seed(seed))
    mixed = torch.cat([samples[order], samples[: number // 2]])
    for classifier in (NN, MST):
        plain, other = fitted(classifier, samples), fitted(classifier, mixed)
        assert torch.equal(plain.distance(pixels), other.distance(pixels))


def test_thousands_of_samples_on_a_line_are_searched_not_compared():
    samples, pixels = some(13_266, 1), some(20_000, 1, seed=5)
    learned = fitted(NN, samples)
    ordered = doubles(samples)[:, 0]
    ordered.sort()
    values = doubles(pixels)[:, 0]
    place = np.searchsorted(ordered, values).clip(1, len(ordered) - 1)
    expected = np.minimum(abs(ordered[place] - values), abs(values - ordered[place - 1]))
    np.testing.assert_allclose(doubles(learned.distance(pixels)), expected, rtol=1e-6)
    assert learned.learned.floats < 100


# --- minimum spanning tree --------------------------------------------------------------


@DIMENSIONS
def test_tree_is_as_short_as_kruskals(dimensions):
    samples = doubles(some(12, dimensions))
    length = reference.distance_matrix(samples, samples)
    edges = edges_of(torch.from_numpy(samples))
    expected = sum(length[edge] for edge in reference.kruskal(samples))
    assert sum(length[edge] for edge in edges) == pytest.approx(expected, rel=1e-12)
    assert len(edges) == 11
    assert len({node for edge in edges for node in edge}) == 12


@DIMENSIONS
def test_tree_distance_is_that_of_a_loop_over_segments(dimensions):
    samples, pixels = road(40, dimensions), some(300, dimensions)
    edges = reference.kruskal(doubles(samples))
    expected = reference.tree_distance(doubles(samples), edges, doubles(pixels))
    found = doubles(fitted(MST, samples).distance(pixels))
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-8)


def test_tree_threshold_is_a_length_of_an_edge():
    samples = torch.tensor([[0.1], [0.2], [0.4], [0.8]])
    lengths = {0.0: 0.4, 0.34: 0.2, 0.7: 0.1}
    for rejected, expected in lengths.items():
        learned = fitted(MST, samples, SpanningTreeSettings(rejected=rejected))
        assert float(learned.threshold) == pytest.approx(expected)


@pytest.mark.parametrize("apart", [1e-9, 1e-7])
def test_samples_that_differ_by_rounding_alone_still_make_a_tree(apart: float) -> None:
    grey = torch.tensor([[0.5, 0.5], [0.5, 0.5 + apart], [0.5 + apart, 0.5]], dtype=torch.float64)

    near = neighbours.spanning_tree(grey)
    far = neighbours.spanning_tree(torch.cat([grey, grey[:1] + 0.3]))

    assert {frozenset(edge) for edge in near.tolist()} == {frozenset((0, 1)), frozenset((0, 2))}
    assert len(far) == 3


def test_equal_edges_give_the_same_tree_every_time():
    grid = torch.cartesian_prod(torch.arange(4.0), torch.arange(4.0)) / 10
    pixels = some(200, 2)
    first, again = (fitted(MST, samples).distance(pixels) for samples in (grid, grid.flip(0)))
    assert torch.equal(first, again)


def test_too_many_different_samples_are_refused_with_what_to_do():
    with pytest.raises(InputError, match=r"4097 different samples.*one sample per superpixel"):
        fitted(MST, some(neighbours.MAX_DISTINCT + 1, 2))
