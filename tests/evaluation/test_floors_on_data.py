"""The floors on real labels, beside the figures that the project's claims are measured against."""

import pytest

from roadtorch.data.catalogue import open_dataset
from roadtorch.data.dataset import Dataset
from roadtorch.evaluation import floors, metrics, runner
from roadtorch.priors import prior_rows

pytestmark = pytest.mark.data


def floor_scores(dataset: Dataset, maps: dict | None = None) -> dict[str, float]:
    """MaxF by drive of the row prior, or of a map for each drive; labels alone are read."""
    counts: dict[str, metrics.RoadCounts] = {}
    for item in dataset.items:
        truth, group = dataset.truth(item), item.group or ""
        size = truth.road.shape
        likelihood = floors.resize(maps[group], size) if maps else prior_rows(*size)
        more = metrics.count_levels(likelihood, truth.road, truth.valid)
        counts[group] = counts[group] + more if group in counts else more
    return {group: float(metrics.max_f(part)[0]) for group, part in counts.items()}


def test_row_prior_on_camvid_by_drive(data_root):
    found = floor_scores(open_dataset("camvid", data_root / "camvid"))

    assert found == pytest.approx({"0001TP": 0.834, "0006R0": 0.905, "0016E5": 0.852}, abs=6e-4)


def test_row_prior_and_camvids_mean_mask_on_idd(data_root):
    idd = open_dataset("idd-lite", data_root / "idd_lite")
    some = runner.every_kth(open_dataset("camvid", data_root / "camvid"), 100)  # for speed

    assert floor_scores(idd)[""] == pytest.approx(0.813, abs=6e-4)
    learned = {"": floors.mean_of(floors.road_shares(some))}
    assert floor_scores(idd, learned)[""] == pytest.approx(0.834, abs=4e-3)
