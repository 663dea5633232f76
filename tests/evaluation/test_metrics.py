"""Measures against brute force, scikit-learn, cases by hand and KITTI's development kit."""

import math

import numpy as np
import pytest
import torch
from sklearn.metrics import confusion_matrix, jaccard_score, roc_auc_score

from roadtorch.base.errors import InputError
from roadtorch.evaluation import metrics
from roadtorch.evaluation.metrics import ConfusionCounts, RoadCounts
from tests.evaluation.conftest import count, random_map
from tests.reference import metrics as slow

# --- brute force ----------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(5))
def test_measures_equal_loops_over_thresholds_and_scikit_learn(seed):
    scores, road = random_map(seed)
    thresholds = np.arange(13) / 12

    counts = count(scores, road, levels=13)
    best, threshold = metrics.max_f(counts)

    expected, where = slow.max_f(scores, road, thresholds)
    assert float(best) == pytest.approx(expected, abs=1e-12)
    assert float(threshold) == pytest.approx(where, abs=1e-12)
    expected = slow.average_precision(scores, road, thresholds)
    assert float(metrics.average_precision(counts)) == pytest.approx(expected, abs=1e-12)
    area = roc_auc_score(road.ravel(), scores.ravel())
    assert float(metrics.auc(count(scores, road))) == pytest.approx(area, abs=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_iou_at_a_threshold_and_of_a_mask_leave_void_out(seed):
    scores, road = random_map(seed)
    valid = np.random.default_rng(1000 + seed).random(road.shape) < 0.7
    maps = torch.from_numpy(scores), torch.from_numpy(road), torch.from_numpy(valid)

    at_threshold = metrics.iou(metrics.confusion_at(metrics.count_levels(*maps), 0.5))
    outcome = metrics.count_mask(maps[0] >= 0.5, *maps[1:])

    expected = jaccard_score(road[valid], scores[valid] >= 0.5)
    assert float(at_threshold) == pytest.approx(expected, abs=1e-12)
    assert float(metrics.iou(outcome)) == pytest.approx(expected, abs=1e-12)
    assert int(outcome.true_negative) == (valid & ~road & (scores < 0.5)).sum()


@pytest.mark.parametrize("levels", [2, 13, 256, metrics.DEFAULT_LEVELS])
def test_level_counts_equal_counting_pixel_by_pixel(levels):
    generator = np.random.default_rng(levels)
    scores = generator.random((7, 9)).astype(np.float32)
    scores[0, :3] = 0, 1, 0.5
    road, valid = generator.random((2, 7, 9)) < [[[0.4]], [[0.8]]]

    maps = (torch.from_numpy(scores), torch.from_numpy(road), torch.from_numpy(valid))
    counts = metrics.count_levels(*maps, levels)

    on_road, background = slow.count_levels(scores, road, valid, levels)
    assert np.array_equal(counts.road.numpy(), on_road)
    assert np.array_equal(counts.background.numpy(), background)


# --- P1: precision, recall and F of a whole data set (eq. 11) -------------------------------------

# Table I: the method's own rows, as printed, in per cent.
TABLE_1 = [
    ("After-Rain", 93.56, 96.95, 95.22),
    ("Sunny-Shadows", 90.49, 94.23, 92.32),
    ("Nanjing", 92.32, 91.86, 92.09),
    ("Kitti-Layout", 76.65, 72.33, 74.43),
]


@pytest.mark.parametrize(("name", "precision", "recall", "f"), TABLE_1)
def test_f_of_table_1_follows_from_its_precision_and_recall(name, precision, recall, f):
    # Whole numbers of pixels with exactly this precision and recall, over two images.
    p, r = round(100 * precision), round(100 * recall)
    sums = torch.tensor([p * r, r * (10_000 - p), p * (10_000 - r), 0])
    first = sums // 3

    pooled = ConfusionCounts(*first) + ConfusionCounts(*(sums - first))

    assert float(metrics.precision(pooled)) == pytest.approx(precision / 100, abs=1e-12)
    assert float(metrics.recall(pooled)) == pytest.approx(recall / 100, abs=1e-12)
    assert round(100 * float(metrics.f_measure(pooled)), 2) == f


# --- KITTI's synthetic case -----------------------------------------------------------------------


def kitti_frame(f: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return 8-bit likelihoods, road and valid of the benchmark's synthetic frame (40, 50)."""
    r, c = np.mgrid[:40, :50]
    road = (r >= 12) & (abs(2 * c - 49 - 6 * f) <= 4 + r)
    noise = (37 * r + 101 * c + 13 * r * c + 59 * f) % 151
    scores = np.clip(40 + 85 * road + noise - r // 4, 0, 255)
    valid = ~((c < 6) & (r < 20)) & ~((r >= 36) & (c >= 46))
    return scores, road, valid


def kitti_counts(scores, road, valid, levels=256) -> RoadCounts:
    likelihood = torch.from_numpy(scores.astype(np.float32)) / 255
    return metrics.count_levels(likelihood, torch.from_numpy(road), torch.from_numpy(valid), levels)


def kitti_cases() -> dict[str, RoadCounts]:
    scores, road, valid = kitti_frame(0)
    return {
        "first": kitti_counts(*kitti_frame(0)),
        "second": kitti_counts(*kitti_frame(1)),
        "pooled": kitti_counts(*kitti_frame(0)) + kitti_counts(*kitti_frame(1)),
        "all valid": kitti_counts(scores, road, np.ones_like(valid)),
        "binary": kitti_counts(255 * (scores >= 128), road, valid),
        "and a frame without road": kitti_counts(scores, road, valid)
        + kitti_counts(scores, np.zeros_like(road), valid),
        "perfect": kitti_counts(255 * road, road, valid),
        "constant": kitti_counts(np.full_like(scores, 77), road, valid),
    }


# What the development kit itself gives for these frames, to six decimals. name, k*, MaxF, AP,
# then at k*: precision, recall, false positive rate.
KITTI_PRINTED = [
    ("first", 127, 0.792811, 0.895401, 0.682131, 0.946365, 0.360976),
    ("second", 120, 0.771550, 0.875705, 0.632432, 0.989130, 0.459459),
    ("pooled", 120, 0.780858, 0.885908, 0.645262, 0.988602, 0.439592),
    ("all valid", 127, 0.773346, 0.884801, 0.653783, 0.946429, 0.362931),
    ("binary", 1, 0.792377, 0.662721, 0.683983, 0.941597, 0.356098),
    ("and a frame without road", 177, 0.528395, 0.447700, 0.451096, 0.637664, 0.225337),
    ("perfect", 1, 1.0, 1.0, 1.0, 1.0, 0.0),
    ("constant", 0, 0.620792, 0.450107, 0.450107, 1.0, 1.0),
]


@pytest.mark.parametrize(("name", "k", "max_f", "ap", "pre", "rec", "fpr"), KITTI_PRINTED)
def test_measures_equal_those_of_the_development_kit(name, k, max_f, ap, pre, rec, fpr):
    counts = kitti_cases()[name]

    best, threshold = metrics.max_f(counts)
    outcome = metrics.confusion_at(counts, float(threshold))

    assert round(float(threshold) * 255) == k
    assert float(best) == pytest.approx(max_f, abs=6e-7)
    assert float(metrics.average_precision(counts)) == pytest.approx(ap, abs=6e-7)
    rates = (metrics.precision, metrics.recall, metrics.false_positive_rate)
    assert [float(rate(outcome)) for rate in rates] == pytest.approx([pre, rec, fpr], abs=6e-7)


def test_8_bit_maps_score_the_same_at_16_bits():
    scores, road, valid = kitti_frame(0)
    fine, coarse = kitti_counts(scores, road, valid, metrics.DEFAULT_LEVELS), kitti_cases()["first"]

    assert torch.equal(metrics.max_f(fine)[0], metrics.max_f(coarse)[0])
    assert torch.equal(metrics.auc(fine), metrics.auc(coarse))
    assert torch.equal(metrics.coarsen(fine).road, coarse.road)
    assert torch.equal(metrics.coarsen(fine).background, coarse.background)


@pytest.mark.parametrize("levels", [256, metrics.DEFAULT_LEVELS])
def test_a_threshold_means_the_lowest_level_that_reaches_it(levels):
    for k in range(0, levels, max(1, levels // 500)):
        assert metrics.threshold_level(k / (levels - 1), levels) == k
        assert metrics.threshold_level((k + 0.01) / (levels - 1), levels) == k + 1


# --- awkward input --------------------------------------------------------------------------------


def test_what_is_not_defined_is_nan():
    no_road, no_background = count([0.1, 0.9], [0, 0]), count([0.1, 0.9], [1, 1])

    assert math.isnan(metrics.auc(no_road))
    assert math.isnan(metrics.auc(no_background))
    assert all(math.isnan(part) for part in metrics.max_f(no_road))
    assert math.isnan(metrics.average_precision(no_road))
    assert math.isnan(metrics.precision(metrics.confusion_at(count([0.1], [1]), 0.5)))
    assert math.isnan(metrics.false_positive_rate(metrics.confusion_at(no_background, 0.5)))


@pytest.mark.parametrize(
    ("scores", "problem"),
    [
        *((torch.tensor([[0.5, wrong]]), "likelihood") for wrong in (math.nan, 1.5, -0.1)),
        (torch.zeros(2, 1), r"\(2, 1\).*\(1, 2\)"),
    ],
)
def test_values_that_are_no_likelihood_and_other_sizes_are_refused(scores, problem):
    road = torch.tensor([[False, True]])

    with pytest.raises(InputError, match=problem):
        metrics.count_levels(scores, road, torch.ones_like(road))


# --- layout ---------------------------------------------------------------------------------------


def test_layout_confusion_equals_counting_pixels():
    generator = np.random.default_rng(0)
    labels, truth = (generator.choice([0, 1, 2, 255], (7, 8)).astype(np.uint8) for _ in range(2))

    confusion = metrics.count_layout(torch.from_numpy(labels), torch.from_numpy(truth))

    assert np.array_equal(confusion.numpy(), confusion_matrix(truth.ravel(), labels.ravel()))


#                         sky vert. horiz. unlabelled
CONFUSION = torch.tensor([[8, 2, 0, 5], [1, 6, 3, 0], [0, 1, 9, 0], [0, 0, 4, 1]])


def test_a_class_without_pixels_has_no_recall_and_is_left_out_of_the_mean():
    confusion = torch.zeros(4, 4, dtype=torch.int64)
    confusion[1, :3] = torch.tensor([1, 3, 0])

    assert metrics.class_recalls(confusion).isnan().tolist() == [True, False, True]
    assert float(metrics.mean_class_recall(confusion)) == 0.75
    assert math.isnan(metrics.mean_class_recall(torch.zeros(4, 4, dtype=torch.int64)))


def test_measures_of_a_confusion_by_hand():
    shares = metrics.normalised_confusion(CONFUSION)
    literal = metrics.class_recalls(metrics.void_as_vertical(CONFUSION))

    rows = [[0.8, 0.2, 0.0], [0.1, 0.6, 0.3], [0.0, 0.1, 0.9]]
    assert shares.tolist() == [pytest.approx(row) for row in rows]
    assert float(metrics.mean_class_recall(CONFUSION)) == pytest.approx((0.8 + 0.6 + 0.9) / 3)
    assert metrics.class_recalls(CONFUSION).tolist() == pytest.approx([0.8, 0.6, 0.9])
    assert literal.tolist() == pytest.approx([0.8, 6 / 14, 0.9])


def test_measures_of_several_confusions_are_those_of_each():
    stacked = torch.stack([CONFUSION, 2 * CONFUSION.T])

    formulas = metrics.class_recalls, metrics.normalised_confusion, metrics.void_as_vertical
    for formula in (*formulas, metrics.mean_class_recall):
        alone = torch.stack([formula(CONFUSION), formula(2 * CONFUSION.T)])
        assert torch.equal(formula(stacked), alone)
