"""Intervals on real pictures, against a bootstrap of ten lines of NumPy that shares no code."""

from pathlib import Path

import numpy as np
import pytest

from roadtorch.base.image import read_image
from roadtorch.data.catalogue import open_dataset
from roadtorch.data.dataset import Dataset, every_kth, leave_out
from roadtorch.detectors.catalogue import load_detector
from roadtorch.evaluation import uncertainty
from roadtorch.evaluation.evaluate import evaluate

DRAWS = 2000
DETECTORS = ("prior:triangle", "grey-uniformity")


def opened(root: Path, name: str) -> Dataset:
    """Three sets: drives of one car, one group of another country's, fourteen cameras."""
    if name == "many":
        return leave_out(open_dataset("folder", root / "many"), ["india_zed"])
    return open_dataset(name.replace("_", "-"), root / name)


def counts(dataset: Dataset, name: str) -> dict[str, np.ndarray]:
    """Of each picture of a group: pixels found rightly, found wrongly, missed; int (n,3)."""
    detector, found = load_detector(name), dict[str, list[list[int]]]()
    for item in dataset.items:
        truth = dataset.truth(item)
        mask = detector.detect(read_image(item.image)).mask & truth.valid
        road = truth.road & truth.valid
        row = [int((mask & road).sum()), int((mask & ~road).sum()), int((~mask & road).sum())]
        found.setdefault(item.group or "", []).append(row)
    return {group: np.array(rows) for group, rows in found.items() if group not in dataset.left_out}


def bootstrap(found: list[dict[str, np.ndarray]], draws: int = DRAWS) -> np.ndarray:
    """F (draws,detectors), mean over the groups: pictures drawn anew in each, alike for all."""
    random, figures = np.random.default_rng(0), np.zeros((draws, len(found)))
    for group in found[0]:
        count = len(found[0][group])
        for draw in range(draws):
            chosen = random.integers(count, size=count)
            for number, own in enumerate(found):
                right, wrong, missed = own[group][chosen].sum(0)
                figures[draw, number] += 2 * right / (2 * right + wrong + missed) / len(found[0])
    return figures


@pytest.mark.data
@pytest.mark.slow
@pytest.mark.parametrize(("name", "limit"), [("camvid", 60), ("idd_lite", 60), ("many", 120)])
def test_intervals_are_those_of_a_plain_bootstrap(
    data_root: Path, name: str, limit: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(uncertainty, "REPLICATES", DRAWS)  # other tests have fewer
    dataset = every_kth(opened(data_root, name), limit)
    evaluation = evaluate(dataset, DETECTORS[1:], against=DETECTORS[0])

    figures = bootstrap([counts(dataset, detector) for detector in DETECTORS])

    own = evaluation.detectors[DETECTORS[1]].intervals["f_mask"]
    pair = evaluation.comparison.differences[DETECTORS[1]]["f_mask"].interval
    for ours, theirs in ((own, figures[:, 1]), (pair, figures[:, 1] - figures[:, 0])):
        low, high = np.quantile(theirs, (0.025, 0.975))
        assert ours.low == pytest.approx(low, abs=0.1 * (high - low))
        assert ours.high == pytest.approx(high, abs=0.1 * (high - low))
