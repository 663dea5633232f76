"""SVDD, MPM, dLP, neighbours and trees against optimality, duality and brute force."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from roadtorch.base.errors import InputError
from roadtorch.oneclass import boundary, neighbours
from roadtorch.oneclass.base import ClassifierSettings
from roadtorch.oneclass.boundary import (
    DISSIMILARITIES,
    DLP,
    MPM,
    SVDD,
    MinimaxSettings,
    SvddSettings,
)
from roadtorch.oneclass.neighbours import MST, NN, squared_distances
from tests.oneclass.cases import DIMENSIONS, doubles, fitted, road, some
from tests.reference import oneclass_boundary as reference


def gram_of(samples: Tensor, sigma: float) -> np.ndarray:
    points = samples.double()
    return torch.expm1(-squared_distances(points.T, points) / sigma**2).numpy()


# --- SVDD -------------------------------------------------------------------------------


@settings(max_examples=20)
@given(
    st.integers(1, 40), st.integers(1, 3), st.floats(0, 1), st.sampled_from([0.02, 0.3, 5.0]),
    st.integers(0, 99),
)  # fmt: skip
def test_ball_meets_the_conditions_of_optimality(number, dimensions, rejected, sigma, seed):
    gram = gram_of(road(number, dimensions, seed), sigma)
    caps = np.full(number, min(1 / max(rejected * number, 1e-9), 2.0))
    weights = boundary.smallest_ball(gram, caps)
    slope = gram @ weights
    can_rise, can_fall = weights < caps, weights > 0
    if can_rise.any():
        gap = slope[can_fall].max() - slope[can_rise].min()
        allowed = 1e-5 if sigma < 0.1 else 1.01e-7
        assert gap <= allowed * max(gram.max() - gram.min(), 1e-12)
    assert weights.sum() == pytest.approx(1, abs=1e-9)


@DIMENSIONS
@pytest.mark.parametrize(("sigma", "rejected"), [(0.3, 0.025), (0.3, 0.5), (5.0, 0.1)])
def test_svdd_is_the_distance_to_the_centre_in_the_kernels_space(dimensions, sigma, rejected):
    samples, pixels = road(40, dimensions), some(300, dimensions)
    cap = min(1 / (rejected * 40), 2)
    learned = fitted(SVDD, samples, SvddSettings(sigma=sigma, rejected=rejected))
    weights = boundary.smallest_ball(gram_of(samples, sigma), np.full(40, cap))
    expected = reference.ball_distance(doubles(samples), weights, sigma, doubles(pixels))
    np.testing.assert_allclose(doubles(learned.distance(pixels)), expected, atol=2e-6)
    # Samples without weight lie inside the sphere, those of full weight outside, others on it.
    away, radius = doubles(learned.distance(samples)), float(learned.threshold)
    assert (away[weights == 0] <= radius * (1 + 1e-3)).all()
    assert (away[weights == cap] >= radius * (1 - 1e-3)).all()
    on_sphere = (weights > 1e-6) & (weights < cap - 1e-6)
    np.testing.assert_allclose(away[on_sphere], radius, rtol=1e-3)


# --- MPM --------------------------------------------------------------------------------


def score_of(samples: Tensor, pixels: Tensor, settings: MinimaxSettings) -> Tensor:
    points, counts = samples.double().unique(dim=0, return_counts=True)
    return boundary.minimax_score(points, counts, settings)(pixels.T)


@DIMENSIONS
@pytest.mark.parametrize("sigma", [1.0, 0.1])
def test_minimax_score_equals_the_toolbox(dimensions, sigma):
    samples, pixels = road(20, dimensions), some(400, dimensions)
    for given_samples in (samples, torch.cat([samples, samples[:7]])):
        score = score_of(given_samples, pixels, MinimaxSettings(sigma=sigma))
        expected = reference.minimax_score(doubles(given_samples), doubles(pixels), 1e-6, sigma)
        np.testing.assert_allclose(score, expected, rtol=1e-6, atol=1e-7)


@DIMENSIONS
def test_minimax_distance_ranks_as_its_score_does(dimensions):
    samples = road(60, dimensions)
    pixels = torch.cat([road(1500, dimensions, seed=5), some(500, dimensions)])
    distance = fitted(MPM, samples).distance(pixels)
    order = score_of(samples, pixels, MinimaxSettings()).argsort(descending=True)
    assert (distance[order].diff() >= 0).all()
    assert distance.unique().numel() > 0.97 * pixels.unique(dim=0).shape[0]


# --- dLP --------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", DISSIMILARITIES)
@pytest.mark.parametrize("rejected", [0.0, 0.025, 0.2])
def test_linear_program_reaches_the_value_of_its_dual_game(kind, rejected):
    points = doubles(some(12, 2))
    squared = torch.from_numpy(reference.distance_matrix(points, points) ** 2)
    between = DISSIMILARITIES[kind](squared).numpy()
    weights, margin = boundary.least_margin(between, np.ones(12), rejected)
    cap = min(1, 1 / (rejected * 12)) if rejected else 1
    slack = np.maximum(between @ weights - margin, 0).sum()
    value = margin + (slack / (rejected * 12) if rejected * 12 > 1 else 0)
    assert value == pytest.approx(reference.game_value(between, cap), abs=1e-7)
    assert weights.sum() == pytest.approx(1)
    assert weights.min() >= 0
    assert (weights > 0).sum() <= 12 - 2  # few samples are needed


def test_duplicates_count_as_often_as_they_occur():
    points = doubles(some(6, 2))
    twice = points[[0, 1, 2, 3, 4, 5, 0, 0, 3]]
    single, many = (reference.distance_matrix(rows, rows) for rows in (points, twice))
    _, margin = boundary.least_margin(single, np.array([3, 1, 1, 2, 1, 1]), 0.3)
    _, repeated = boundary.least_margin(many, np.ones(9), 0.3)
    assert margin == pytest.approx(repeated)


@pytest.mark.parametrize(
    ("classifier", "most", "planes"), [(DLP, boundary.MAX_CONSTRAINTS, 1), (MST, 4096, 2)]
)
def test_too_many_distinct_samples_are_refused_with_a_hint(classifier, most, planes):
    refusal = rf"{classifier.name}: has {most + 1} distinct samples.*one sample per superpixel"
    with pytest.raises(InputError, match=refusal):
        fitted(classifier, some(most + 1, planes))


# --- nearest neighbour ------------------------------------------------------------------


def test_near_pixels_keep_their_digits_far_from_the_origin():
    samples = torch.tensor([[0.9, 0.9, 0.9], [0.1, 0.1, 0.1]])
    pixels = samples[:1] + torch.tensor([[0, 0, 0], [3e-5, 0, 0], [6e-5, 0, 0]])
    expected = reference.nearest_distance(doubles(samples), doubles(pixels))
    np.testing.assert_allclose(fitted(NN, samples).distance(pixels), expected, rtol=1e-6, atol=0)


@pytest.mark.parametrize(
    ("classifier", "first", "rejected", "threshold"),
    [
        (NN, [0.1, 0.2], 0.5, 0.15),  # to the next sample: 0.1, 0.1, 0.2, 0.4
        (NN, [0.1, 0.1], 0.5, 0.15),  # 0, 0, 0.3, 0.4: a twin is a neighbour
        *((MST, [0.1, 0.2], *pair) for pair in ((0.0, 0.4), (0.34, 0.2), (0.7, 0.1))),  # an edge
    ],
)
def test_thresholds_are_distances_between_samples(classifier, first, rejected, threshold):
    samples = torch.tensor([*first, 0.4, 0.8])[:, None]
    learned = fitted(classifier, samples, ClassifierSettings(rejected=rejected))
    assert float(learned.threshold) == pytest.approx(threshold)


# --- minimum spanning tree --------------------------------------------------------------


@pytest.mark.parametrize("apart", [1e-9, 1e-7])
def test_samples_that_differ_by_rounding_alone_still_make_a_tree(apart: float) -> None:
    grey = torch.tensor([[0.5, 0.5], [0.5, 0.5 + apart], [0.5 + apart, 0.5]], dtype=torch.float64)

    near = neighbours.spanning_tree(grey)
    far = neighbours.spanning_tree(torch.cat([grey, grey[:1] + 0.3]))

    assert {frozenset(edge) for edge in near.tolist()} == {frozenset((0, 1)), frozenset((0, 2))}
    assert len(far) == 3


def test_equal_edges_give_the_same_tree_every_time():
    grid = torch.cartesian_prod(torch.arange(4.0), torch.arange(4.0)) / 10
    first, again = (fitted(MST, samples).distance(some(200, 2)) for samples in (grid, grid.flip(0)))
    assert torch.equal(first, again)
