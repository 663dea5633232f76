"""Curves and calibration: the worked example of the protocols, brute force and scikit-learn."""

import numpy as np
import pytest
import torch
from sklearn.calibration import calibration_curve
from sklearn.metrics import brier_score_loss, roc_auc_score
from sklearn.metrics import roc_curve as sklearn_roc

from roadtorch.evaluation import curves, metrics
from roadtorch.evaluation.metrics import RoadCounts
from tests.evaluation.conftest import count, random_map, stack
from tests.reference import curves as slow

# --- the worked example: two small images, numbers from reference/protocols.md 1.4 ----------------

FIRST = ([0.9, 0.8, 0.7, 0.6, 0.4, 0.3, 0.2, 0.1], [1, 1, 0, 1, 1, 0, 0, 0])
SECOND = ([0.7, 0.6, 0.6, 0.5, 0.5, 0.4, 0.3, 0.2, 0.1, 0.05], [1, 0, 1, 1, 0, 1, 0, 0, 0, 0])


def test_vertical_average_of_the_worked_example():
    images = stack(count(*FIRST), count(*SECOND))

    at_twentieths = curves.vertical_sample(images, 20).mean(0)
    curve = curves.vertical_average(curves.vertical_sample(images, 100).mean(0))

    average = [float(at_twentieths[round(20 * x)]) for x in (0, 0.1, 0.25, 0.5)]
    assert average == pytest.approx([0.375, 0.45, 0.8125, 1.0], abs=1e-12)
    assert (curve.x[:2].tolist(), curve.y[:2].tolist()) == ([0, 0], [0, 0.375])
    assert float(curves.area(curve)) == pytest.approx(0.8552, abs=6e-5)


# --- brute force and scikit-learn -----------------------------------------------------------------


ROAD = np.arange(12) < 5


@pytest.mark.parametrize(
    ("scores", "road"),
    [*map(random_map, range(3)), (ROAD * 1.0, ROAD), (np.full(12, 0.3), ROAD)],
    ids=["0", "1", "2", "perfect", "constant"],
)
def test_curves_equal_counting_at_every_score_and_scikit_learn(scores, road):
    flat = road.ravel(), scores.ravel()

    counts = count(scores, road)
    curve = curves.operating_points(counts)

    points = torch.stack([curve.x, curve.y]).unique_consecutive(dim=1)
    rates = sklearn_roc(*flat, drop_intermediate=False)[:2]
    assert points.numpy() == pytest.approx(np.stack(rates), abs=1e-12)
    assert float(curves.area(curve)) == pytest.approx(roc_auc_score(*flat), abs=1e-12)


@pytest.mark.parametrize("steps", [7, 10, 100])
def test_vertical_sample_equals_reading_the_curve_at_each_rate(steps):
    scores, road = random_map(steps)
    curve = slow.roc(scores, road)
    background = int((~road).sum())

    rates = curves.vertical_sample(count(scores, road), steps)

    # Whole pixels where i/steps is a point of the curve, so that the twin's "=" can be met.
    fpr = [
        i * background // steps / background if i * background % steps == 0 else i / steps
        for i in range(steps + 1)
    ]
    assert rates.tolist() == pytest.approx([slow.height(curve, x) for x in fpr], abs=1e-12)


@pytest.mark.parametrize("bins", [1, 7, 20])
def test_calibration_equals_scikit_learn(bins):
    generator = np.random.default_rng(bins)
    scores = generator.integers(0, 256, 500) / 255
    road = generator.random(500) < scores**2

    counts = count(scores, road, 256)
    curve = curves.reliability(counts, bins)

    observed, predicted = calibration_curve(road, scores, n_bins=bins)
    inside = np.searchsorted(np.linspace(0, 1, bins + 1)[1:-1], scores)
    filled = curve.fraction > 0
    assert curve.fraction.tolist() == (np.bincount(inside, minlength=bins) / 500).tolist()
    assert curve.predicted[filled].tolist() == pytest.approx(predicted.tolist(), abs=1e-12)
    assert curve.observed[filled].tolist() == pytest.approx(observed.tolist(), abs=1e-12)
    gaps = np.abs(observed - predicted) * curve.fraction[filled].numpy()
    assert float(curves.expected_calibration_error(counts, bins)) == pytest.approx(
        gaps.sum(), abs=1e-12
    )
    assert float(curves.brier_score(counts)) == pytest.approx(
        brier_score_loss(road, scores), abs=1e-12
    )


@pytest.mark.parametrize(
    "figure",
    [
        *(metrics.auc, metrics.average_precision),
        *(curves.brier_score, curves.expected_calibration_error),
        lambda counts: metrics.max_f(counts)[0],
        lambda counts: curves.operating_points(counts).x,
        lambda counts: curves.area(curves.operating_points(counts)),
        lambda counts: curves.vertical_sample(counts, 10),
    ],
)
def test_leading_dimensions_are_images(figure):
    images = [count(*random_map(seed), 16) for seed in (1, 2)]

    assert torch.equal(figure(stack(*images)), torch.stack([figure(image) for image in images]))


# --- what is not defined --------------------------------------------------------------------------


@pytest.mark.parametrize("road", [[0, 0], [1, 1]])
def test_curves_of_one_class_are_nan(road):
    lacking = count([0.2, 0.6], road, 11)

    assert bool(curves.vertical_sample(lacking, 5).isnan().all())
    assert bool(curves.area(curves.operating_points(lacking)).isnan())
    nothing = RoadCounts(torch.zeros(256, dtype=torch.int64), torch.zeros(256, dtype=torch.int64))
    assert curves.brier_score(nothing).isnan()
    assert curves.expected_calibration_error(nothing).isnan()
