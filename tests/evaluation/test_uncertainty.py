"""Intervals and paired differences: the textbook case, a plain bootstrap, an evaluation."""

import itertools
import math
from collections.abc import Callable, Sequence

import pytest
import torch
from torch import Tensor

from roadtorch.data.dataset import Dataset
from roadtorch.detectors.detection import Detection
from roadtorch.evaluation import uncertainty
from roadtorch.evaluation.measures import MEASURES
from roadtorch.evaluation.result import DetectorScores
from roadtorch.testing.scenes import RenderedScene
from tests.evaluation.conftest import GROUPS, scores_of, tally_of

TRIALS = 2000


def by_images(values: Tensor, generator: torch.Generator) -> Tensor:
    weights = uncertainty.bootstrap_weights(values.shape[1], generator, 2000)
    return values @ weights.double().T / values.shape[1]


def by_few(values: Tensor, generator: torch.Generator) -> Tensor:
    weights = uncertainty.student_weights(values.shape[1], generator, 3000)
    return values @ weights.T / values.shape[1]


@pytest.mark.parametrize(
    ("draw", "count"), [(by_few, 3), (by_few, 5), (by_few, 14), (by_images, 150)]
)
def test_intervals_of_95_percent_cover_the_true_mean_that_often(
    draw: Callable[[Tensor, torch.Generator], Tensor], count: int
) -> None:
    generator = torch.Generator().manual_seed(1)
    samples = torch.randn(TRIALS, count, generator=generator, dtype=torch.float64)

    intervals = map(uncertainty.percentile_interval, draw(samples, generator))

    covered = [low <= 0 <= high for low, high in intervals]
    assert 0.94 <= sum(covered) / TRIALS <= 0.96


def test_the_interval_of_a_mean_covers_the_true_one_that_often() -> None:
    samples = torch.randn(2000, 4, generator=torch.Generator().manual_seed(2))
    covered = [low <= 0 <= high for low, high in map(uncertainty.mean_interval, samples)]

    assert 0.94 <= sum(covered) / len(covered) <= 0.96


def test_replicates_without_a_value_are_left_out():
    values = torch.tensor([math.nan, 1, 1, math.nan, 1], dtype=torch.float64)

    assert all(math.isnan(end) for end in uncertainty.percentile_interval(values[:1]))
    assert uncertainty.percentile_interval(values) == (1, 1)


# --- of a run -------------------------------------------------------------------------------------

Measured = tuple[DetectorScores, uncertainty.Replicates]


def blurred(road: Tensor, name: str, noise: float) -> Tensor:
    """Mix a road with noise, which depends on the image."""
    generator = torch.Generator().manual_seed(int(name[7:]))
    return (1 - noise) * road + noise * torch.rand(48, 64, generator=generator)


def measured(dataset: Dataset, scenes, noise: float) -> Measured:
    """Return scores and replicates of a detector whose road is mixed with so much noise."""

    def look(image, item):
        likelihood = blurred(scenes[item.name].road, item.name, noise)
        scores = scenes[item.name].layout
        blur = blurred(torch.zeros_like(likelihood), item.name, 3 * noise)
        layout = torch.stack([(scores == kind).float() for kind in range(3)]) + blur
        return Detection(likelihood, likelihood > 0.5, {"layout": layout})

    tally = tally_of(dataset, look)
    scores = scores_of(tally)
    return scores, uncertainty.bootstrap(tally, scores)


def test_every_headline_score_has_an_interval_around_it(dataset, scenes):
    scores, draws = measured(dataset, scenes, 0.7)

    intervals = uncertainty.score_intervals(draws)

    assert set(intervals) == {measure.key for measure in MEASURES if measure.interval}
    for name, (low, high) in intervals.items():
        assert low <= scores.headline[name] <= high
        assert 0 <= high - low < 0.2
    assert intervals["maxf"][1] > intervals["maxf"][0]


def test_a_score_that_some_groups_lack_has_the_interval_of_the_others(dataset, scenes):
    def look(image, item):
        likelihood = blurred(scenes[item.name].road, item.name, 0.7)
        scores = blurred(torch.rand(3, 48, 64), item.name, 0.5)
        cues = {"layout": scores} if item.name.startswith(GROUPS[0]) else {}
        return Detection(likelihood, likelihood > 0.5, cues)

    tally = tally_of(dataset, look)
    scores = scores_of(tally)

    low, high = uncertainty.score_intervals(uncertainty.bootstrap(tally, scores))["layout/mean"]

    assert low <= scores.headline["layout/mean"] <= high


def test_replicates_are_those_of_a_plain_bootstrap_the_same_for_both(dataset, scenes):
    masks = {
        noise: {name: blurred(scenes[name].road, name, noise) > 0.5 for name in scenes}
        for noise in (0.6, 0.8)
    }
    ours = torch.stack([measured(dataset, scenes, noise)[1]["f_mask"] for noise in masks], 1)

    f_of_draws = []  # of each group, the four equally likely draws of its two images
    for group in GROUPS:
        names = [name for name in scenes if name.startswith(group)]
        f_of_draws.append([
            [pooled_f([scenes[name] for name in draw], [of[name] for name in draw])
             for of in masks.values()]
            for draw in itertools.product(names, repeat=2)
        ])  # fmt: skip
    expected = torch.tensor(list(itertools.product(*f_of_draws)), dtype=torch.float64).mean(1)
    apart = (ours[:, None] - expected).abs().amax(2)
    assert apart.amin(1).max() < 1e-9
    assert len(apart.argmin(1).unique()) > 20  # of 27 different ones


def pooled_f(scenes: Sequence[RenderedScene], masks: Sequence[Tensor]) -> float:
    """Compute F of the masks of some scenes together, by loops."""
    right = decided = true = 0
    for scene, mask in zip(scenes, masks, strict=True):
        right += int((mask & scene.road & ~scene.void).sum())
        decided += int((mask & ~scene.void).sum())
        true += int((scene.road & ~scene.void).sum())
    return 2 * right / (decided + true)


def test_differences_are_signed_paired_and_of_measures_that_both_have(dataset, scenes):
    runs = {"good": measured(dataset, scenes, 0.72), "poor": measured(dataset, scenes, 0.75)}
    runs |= {"again": runs["good"], "bare": (runs["good"][0], dict(runs["good"][1]))}
    detectors = {name: scores for name, (scores, _) in runs.items()}
    draws = {name: values for name, (_, values) in runs.items()}
    draws["bare"] = {key: values for key, values in draws["bare"].items() if key != "layout/mean"}

    differences = uncertainty.compare_detectors(detectors, draws, "good").differences
    reverse = uncertainty.compare_detectors(detectors, draws, "poor").differences

    assert differences["again"]["maxf"].value == 0
    assert differences["again"]["maxf"].interval == (0, 0)
    assert differences["poor"]["maxf"].interval.high < 0  # worse on every image
    assert differences["poor"]["brier"].interval.low > 0
    low, high = differences["poor"]["maxf"].interval
    assert low < differences["poor"]["maxf"].value < high
    assert reverse["good"]["maxf"].interval == pytest.approx((-high, -low))
    # Paired, the interval is far narrower than those of the two scores.
    alone = uncertainty.score_intervals(draws["poor"])["maxf"]
    assert high - low < 0.7 * (alone.high - alone.low)
    assert set(differences["again"]) - set(differences["bare"]) == {"layout/mean"}
