"""SVDD, MPM and dLP against general solvers, duality, scikit-learn and brute force."""

from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import rankdata
from sklearn.svm import OneClassSVM
from torch import Tensor

from roadtorch.errors import InputError
from roadtorch.oneclass import boundary
from roadtorch.oneclass.boundary import (
    DISSIMILARITIES,
    DLP,
    MPM,
    SVDD,
    LinearSettings,
    MinimaxSettings,
    SvddSettings,
)
from roadtorch.oneclass.neighbours import MST, NN, squared_distances
from tests.oneclass.cases import DIMENSIONS, doubles, fitted, kept, some
from tests.reference import oneclass_boundary as reference

ALL = pytest.mark.parametrize(
    "classifier", [NN, SVDD, MPM, MST, DLP], ids=lambda classifier: classifier.name
)


def road(number: int, dimensions: int, seed: int = 1) -> Tensor:
    generator = torch.Generator().manual_seed(seed)
    return 0.4 + 0.03 * torch.randn(number, dimensions, generator=generator)


def gram_of(samples: Tensor, sigma: float) -> np.ndarray:
    points = samples.double()
    return torch.expm1(-squared_distances(points.T, points) / sigma**2).numpy()


def correlation(left: Any, right: Any) -> float:
    """Spearman's."""
    return float(np.corrcoef(rankdata(left), rankdata(right))[0, 1])


def same_ranks(left: Any, right: Any) -> None:
    assert correlation(left, right) > 0.9999


# --- SVDD -------------------------------------------------------------------------------


@given(
    st.integers(1, 60), st.integers(1, 3), st.floats(0, 1), st.sampled_from([0.02, 0.3, 5.0]),
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
def test_distance_is_that_to_the_centre_in_the_kernels_space(dimensions):
    samples, pixels = road(40, dimensions), some(500, dimensions)
    sigma, cap = 0.3, 1 / (0.1 * 40)
    learned = fitted(SVDD, samples, SvddSettings(sigma=sigma, rejected=0.1))
    weights = boundary.smallest_ball(gram_of(samples, sigma), np.full(40, cap))
    expected = reference.ball_distance(doubles(samples), weights, sigma, doubles(pixels))
    np.testing.assert_allclose(doubles(learned.distance(pixels)), expected, atol=2e-6)


@DIMENSIONS
@pytest.mark.parametrize(("sigma", "rejected"), [(0.3, 0.025), (0.3, 0.5), (5.0, 0.1)])
def test_svdd_is_the_one_class_machine_of_scikit_learn(dimensions, sigma, rejected):
    samples, pixels = road(90, dimensions), some(2000, dimensions)
    machine: Any = OneClassSVM(nu=rejected, tol=1e-10).set_params(gamma=1 / sigma**2)
    machine.fit(doubles(samples))
    decision = machine.decision_function(doubles(pixels))
    learned = fitted(SVDD, samples, SvddSettings(sigma=sigma, rejected=rejected))
    squared = doubles(learned.distance(pixels)) ** 2
    # One is an affine function of the other: |φ - a|² = const - 2 Σ a K.
    slope, offset = np.polyfit(decision, squared, 1)
    assert slope < 0
    np.testing.assert_allclose(squared, slope * decision + offset, atol=2e-5)
    accepted = squared <= offset  # where the machine's decision is 0
    assert (accepted == (decision >= 0)).mean() > 0.998


def test_a_wide_ball_is_the_smallest_ball_of_colour_space():
    corners = torch.tensor([[0.2, 0.2, 0.5], [0.6, 0.2, 0.5], [0.4, 0.3, 0.5]])
    pixels = some(500, 3)
    learned = fitted(SVDD, corners, SvddSettings(sigma=1000.0, rejected=0))
    centre = (pixels - torch.tensor([0.4, 0.2, 0.5])).norm(dim=1)
    torch.testing.assert_close(
        learned.distance(pixels) * 1000 / 2**0.5, centre, rtol=1e-3, atol=1e-4
    )
    assert float(learned.threshold) * 1000 / 2**0.5 == pytest.approx(0.2, rel=1e-4)


def test_rejecting_everything_leaves_parzens_density():
    samples, pixels = road(30, 2), some(300, 2)
    learned = fitted(SVDD, samples, SvddSettings(sigma=0.1, rejected=1.0))
    torch.testing.assert_close(kept(learned, "weights"), torch.full((30,), 1 / 30))
    density = np.exp(
        -(reference.distance_matrix(doubles(pixels), doubles(samples)) ** 2) / 0.1**2
    ).sum(1)
    clear = density > 1e-3
    same_ranks(doubles(learned.score(pixels))[clear], density[clear])


def test_median_width_is_the_median_distance_of_pairs():
    # Pairs: .1 .3 .4 .4 .7 .8, and 0 .1 .1 .3 .4 .4; the lower one in the middle.
    for values, median in (([0.1, 0.2, 0.5, 0.9], 0.4), ([0.1, 0.1, 0.2, 0.5], 0.1)):
        samples = torch.tensor(values, dtype=torch.float64)[:, None]
        points, counts = samples.unique(dim=0, return_counts=True)
        assert boundary._median_distance(points, counts) == pytest.approx(median)
    one = torch.tensor([[0.5]], dtype=torch.float64)
    assert boundary._median_distance(one, torch.tensor([3])) == 1.0


# --- MPM --------------------------------------------------------------------------------


def score_of(samples: Tensor, pixels: Tensor, settings: MinimaxSettings) -> Tensor:
    points, counts = samples.double().unique(dim=0, return_counts=True)
    return boundary.minimax_score(points, counts, settings)(pixels.T)


@DIMENSIONS
@pytest.mark.parametrize("sigma", [1.0, 0.1])
def test_minimax_score_is_the_toolboxs(dimensions, sigma):
    samples, pixels = road(20, dimensions), some(400, dimensions)
    for given_samples in (samples, torch.cat([samples, samples[:7]])):
        score = score_of(given_samples, pixels, MinimaxSettings(sigma=sigma))
        expected = reference.minimax_score(doubles(given_samples), doubles(pixels), 1e-6, sigma)
        np.testing.assert_allclose(score, expected, rtol=1e-6, atol=1e-7)


def test_minimax_direction_has_the_least_spread_for_its_margin():
    rows = doubles(some(15, 4))
    direction = boundary.minimax_direction(rows, np.ones(15), np.ones(4), 1e-3)
    matrix = np.cov(rows.T, bias=True) + 1e-3 * np.eye(4)
    assert direction @ rows.mean(0) == pytest.approx(1)
    strength = rows.mean(0) @ np.linalg.solve(matrix, rows.mean(0))  # ξ²
    assert direction @ matrix @ direction == pytest.approx(1 / strength)
    # The gradient stands on the plane of equal margin, and the problem is convex.
    gradient = matrix @ direction
    assert np.allclose(
        gradient / np.linalg.norm(gradient), rows.mean(0) / np.linalg.norm(rows.mean(0))
    )
    for step in doubles(some(20, 4)) - 0.5:
        other = direction + step - (step @ rows.mean(0)) * direction
        assert other @ matrix @ other >= direction @ matrix @ direction


def test_linear_kernel_is_the_closed_form():
    samples, pixels = road(50, 3), some(500, 3)
    settings = MinimaxSettings(kernel="linear", ridge=1e-4)
    values = doubles(samples)
    direction = np.linalg.solve(np.cov(values.T, bias=True) + 1e-4 * np.eye(3), values.mean(0))
    expected = doubles(pixels) @ direction / (values.mean(0) @ direction)
    np.testing.assert_allclose(score_of(samples, pixels, settings), expected, rtol=1e-9)
    found = fitted(MPM, samples, settings).score(pixels)
    assert correlation(found, expected) == pytest.approx(1)


@DIMENSIONS
def test_minimax_distance_ranks_as_its_score_does(dimensions):
    samples = road(90, dimensions)
    pixels = torch.cat([road(3000, dimensions, seed=5), some(1000, dimensions)])
    distance = fitted(MPM, samples).distance(pixels)
    order = score_of(samples, pixels, MinimaxSettings()).argsort(descending=True)
    assert (distance[order].diff() >= 0).all()
    assert distance.unique().numel() > 0.97 * pixels.unique(dim=0).shape[0]


# --- dLP --------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", DISSIMILARITIES)
@pytest.mark.parametrize("rejected", [0.0, 0.025, 0.2])
def test_programme_reaches_the_value_of_its_dual_game(kind, rejected):
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


def test_twins_count_as_often_as_they_occur():
    points = doubles(some(6, 2))
    twice = points[[0, 1, 2, 3, 4, 5, 0, 0, 3]]
    one, many = (reference.distance_matrix(rows, rows) for rows in (points, twice))
    _, margin = boundary.least_margin(one, np.array([3, 1, 1, 2, 1, 1]), 0.3)
    _, other = boundary.least_margin(many, np.ones(9), 0.3)
    assert margin == pytest.approx(other)


def test_dissimilarities_are_the_toolboxs_from_the_nearest_to_the_farthest():
    squared = torch.logspace(-12, 1, 50, dtype=torch.float64)
    found = {kind: of(squared.clone()) for kind, of in DISSIMILARITIES.items()}
    root = squared.sqrt()
    torch.testing.assert_close(found["toolbox"], 2 * torch.tanh(squared / 2), rtol=1e-12, atol=0)
    torch.testing.assert_close(found["euclid"], root)
    torch.testing.assert_close(
        found["euclid_sigmoid"], 2 * torch.tanh(root / 2), rtol=1e-12, atol=0
    )


@pytest.mark.parametrize("kind", DISSIMILARITIES)
@DIMENSIONS
def test_distance_ranks_as_the_weighted_sum_of_dissimilarities(kind, dimensions):
    samples, pixels = road(30, dimensions), some(1000, dimensions)
    learned = fitted(DLP, samples, LinearSettings(dissimilarity=kind))
    to_points, between = (
        reference.distance_matrix(doubles(each), doubles(samples)) for each in (pixels, samples)
    )
    dissimilarity = {
        "toolbox": lambda away: 4 / (1 + np.exp(-(away**2))) - 2,
        "euclid": lambda away: away,
        "euclid_sigmoid": lambda away: 4 / (1 + np.exp(-away)) - 2,
    }[kind]
    apart = dissimilarity(between)
    weights, _ = boundary.least_margin(apart / apart.mean(), np.ones(30), 0.025)
    same_ranks(learned.distance(pixels), dissimilarity(to_points) @ weights)


@DIMENSIONS
@pytest.mark.parametrize("rejected", [0.025, 0.1])
def test_threshold_is_the_programmes_margin(dimensions, rejected):
    samples = road(90, dimensions)
    learned = fitted(DLP, samples, LinearSettings(rejected=rejected))
    outside = (learned.distance(samples) > learned.threshold * (1 + 1e-4)).sum()
    assert outside <= rejected * 90
    # The boundary goes through samples, not between them.
    assert ((learned.distance(samples) / learned.threshold - 1).abs() < 1e-3).any()


def test_toolbox_dissimilarity_makes_dlp_the_wide_svdd():
    two_kinds_of_road = torch.cat([road(60, 1), 1.4 * road(30, 1, seed=3)])
    pixels = some(3000, 1)

    def as_svdd(settings: LinearSettings) -> float:
        wide, linear = fitted(SVDD, two_kinds_of_road), fitted(DLP, two_kinds_of_road, settings)
        return correlation(wide.score(pixels), linear.score(pixels))

    assert as_svdd(LinearSettings()) > 0.99999
    assert as_svdd(LinearSettings(dissimilarity="euclid")) < 0.999


def test_too_many_different_samples_are_refused_with_what_to_do():
    with pytest.raises(InputError, match=r"dlp: has 1025 different samples.*superpixel"):
        fitted(DLP, some(boundary.MAX_CONSTRAINTS + 1, 1))


# --- all five ---------------------------------------------------------------------------


@ALL
def test_a_constant_plane_changes_no_rank_among_pixels_that_share_it(classifier):
    samples, pixels = road(40, 2), some(300, 2)
    with_constant, pixels_too = (
        torch.cat([values, torch.full((len(values), 1), 0.25)], 1) for values in (samples, pixels)
    )
    plain = fitted(classifier, samples).distance(pixels)
    same_ranks(plain, fitted(classifier, with_constant).distance(pixels_too))


@ALL
def test_samples_on_a_byte_grid_with_twins_give_finite_ordered_distances(classifier):
    samples = (road(500, 1) * 255).round() / 255
    pixels = torch.arange(256.0)[:, None] / 255
    distance = fitted(classifier, samples).distance(pixels)
    assert distance.isfinite().all()
    upper = distance[pixels[:, 0] > samples.max()]
    assert (upper.diff() > 0).all()
