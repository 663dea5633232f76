"""The mean mask of other groups, and the baselines on real labels beside the project's figures."""

import pytest
import torch

from roadtorch.data.catalogue import open_dataset
from roadtorch.data.dataset import Dataset, every_kth
from roadtorch.evaluation import metrics
from roadtorch.evaluation.methods import (
    contenders,
    mean_masks,
    resize,
)
from roadtorch.road.fusion import prior_rows
from tests.evaluation.conftest import GROUPS


def test_the_mean_mask_is_the_other_groups(dataset, scenes):
    shares = {}
    for group in GROUPS:
        own = [scene for name, scene in scenes.items() if name.startswith(group)]
        road = torch.stack([scene.road & ~scene.void for scene in own]).double().sum(0)
        seen = torch.stack([~scene.void for scene in own]).double().sum(0)
        shares[group] = road / seen.clamp(min=1e-9)

    found = mean_masks(dataset)["0001TP"]

    assert torch.allclose(found, (shares["0006R0"] + shares["0016E5"]) / 2)
    assert mean_masks(every_kth(dataset, 1)) == {}  # one group alone teaches nothing


def test_a_mask_from_elsewhere_is_brought_to_the_size_of_the_image(dataset):
    one = every_kth(dataset, 1)

    *_, mean = contenders(one, (), {}, {}, mean_from=dataset)
    found = mean.prepare(one)(torch.zeros(3, 24, 32), one.items[0])

    assert mean.name == "prior:mean"
    assert found.likelihood.shape == (24, 32)
    assert found.likelihood[0].max() < 0.1
    assert found.likelihood[-1].mean() > 0.5


# --- on real labels ------------------------------------------------------------------------------


def baseline_scores(dataset: Dataset, maps: dict | None = None) -> dict[str, float]:
    """MaxF by group of the row prior, or of a map for each group; labels alone are read."""
    counts: dict[str, metrics.RoadCounts] = {}
    for item in dataset.items:
        truth, group = dataset.truth(item), item.group or ""
        size = truth.road.shape
        likelihood = resize(maps[group], size) if maps else prior_rows(*size)
        more = metrics.count_levels(likelihood, truth.road, truth.valid)
        counts[group] = counts[group] + more if group in counts else more
    return {group: float(metrics.max_f(part)[0]) for group, part in counts.items()}


@pytest.mark.data
def test_row_prior_on_camvid_by_group(data_root):
    found = baseline_scores(open_dataset("camvid", data_root / "camvid"))

    assert found == pytest.approx({"0001TP": 0.834, "0006R0": 0.905, "0016E5": 0.852}, abs=6e-4)


@pytest.mark.data
def test_row_prior_and_camvids_mean_mask_on_idd(data_root):
    idd = open_dataset("idd-lite", data_root / "idd_lite")
    some = every_kth(open_dataset("camvid", data_root / "camvid"), 100)  # for speed

    assert baseline_scores(idd)[""] == pytest.approx(0.813, abs=6e-4)
    assert baseline_scores(idd, mean_masks(idd, some))[""] == pytest.approx(0.834, abs=4e-3)
