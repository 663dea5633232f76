"""Rendered streets of three groups as a labelled set, and detectors with given answers."""

from collections.abc import Callable, Iterator

import numpy as np
import pytest
import torch
from torch import Tensor

from roadtorch.data.catalogue import open_dataset
from roadtorch.data.dataset import Dataset
from roadtorch.detectors.detection import Detection
from roadtorch.evaluation import metrics, uncertainty
from roadtorch.evaluation.evaluate import tally_images
from roadtorch.evaluation.methods import Contender, Predictor
from roadtorch.evaluation.metrics import RoadCounts
from roadtorch.evaluation.result import DetectorScores, summarise
from roadtorch.evaluation.tally import Tally
from roadtorch.testing.scenes import RenderedScene, render_scene
from tests.streets import write_camvid

GROUPS = ("0001TP", "0006R0", "0016E5")

Answer = Callable[[str], Tensor]
"""What a detector says about the image of that name."""


@pytest.fixture(scope="module", autouse=True)
def _few_draws() -> Iterator[None]:
    """Compute intervals from a tenth of the replicates."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(uncertainty, "REPLICATES", 100)
        yield


@pytest.fixture(scope="module")
def scenes() -> dict[str, RenderedScene]:
    return {f"{GROUPS[i % 3]}_{i}": render_scene(i, 48, 64) for i in range(6)}


@pytest.fixture(scope="module")
def dataset(scenes, tmp_path_factory) -> Dataset:
    root = tmp_path_factory.mktemp("camvid")
    write_camvid(root, "train", scenes)
    return open_dataset("camvid", root, "train")


def answering(likelihood: Answer, **cues: Answer) -> Predictor:
    """Return a detector whose likelihood and cues are functions of the item's name."""

    def look(image, item):
        values = likelihood(item.name).to(torch.float32)
        return Detection(values, values >= 0.5, {k: v(item.name) for k, v in cues.items()})

    return look


def tally_of(dataset: Dataset, look: Predictor) -> Tally:
    """Count one detector on every image of a set."""
    tallies, failures = tally_images(dataset, [Contender("it", lambda _: look)], 1, quiet=True)
    assert not failures
    return tallies["it"]


def scores_of(tally: Tally, threshold: float = 0.5) -> DetectorScores:
    """Compute the scores of a detector with this default threshold."""
    return summarise(Contender("it", lambda _: NotImplemented, threshold=threshold), tally)


# --- counts of made-up maps ------------------------------------------------------------------


def count(scores, road, levels=metrics.DEFAULT_LEVELS) -> RoadCounts:
    """Count one map, all of it valid."""
    scores, road = torch.as_tensor(scores), torch.as_tensor(road, dtype=torch.bool)
    return metrics.count_levels(scores, road, torch.ones_like(road), levels)


def stack(*parts: RoadCounts) -> RoadCounts:
    return RoadCounts(
        torch.stack([part.road for part in parts]), torch.stack([part.background for part in parts])
    )


def random_map(seed: int, levels: int = 12) -> tuple[np.ndarray, np.ndarray]:
    """Return likelihoods on a coarse grid, so that ties are frequent, and a road."""
    generator = np.random.default_rng(seed)
    road = generator.random((9, 11)) < 0.4
    road[0, :2] = True, False
    values = generator.integers(0, levels, road.shape) + 3 * road
    return np.clip(values, 0, levels) / levels, road
