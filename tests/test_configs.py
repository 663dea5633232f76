"""The configs that ship: read by their commands, and in agreement with the defaults."""

from pathlib import Path

import pytest

from roadtorch.base.settings import read_settings_file
from roadtorch.cli.options import DetectorOptions
from roadtorch.detectors.catalogue import detector_entry
from roadtorch.layout.patch_network import Topology
from roadtorch.train.config import PatchTraining, build_training

CONFIGS = Path(__file__).resolve().parents[1] / "configs"
THRESHOLDS = sorted((CONFIGS / "thresholds").glob("*.toml"))
TRAINING = sorted(CONFIGS.glob("*.toml"))
OWN = ("ufl", "ufl:original", "fusion", "fusion:untrained", "labeller")
"""Their default is not CamVid's: it is the mask that the method chooses (ufl), or serves seventeen
cameras (docs/results.md)."""


@pytest.mark.parametrize("path", TRAINING, ids=lambda path: path.stem)
def test_every_training_config_is_one(path: Path) -> None:
    assert build_training(read_settings_file(path)).descent.learning_rate > 0


def test_the_papers_config_is_to_the_letter_where_the_paper_says() -> None:
    paper = build_training(read_settings_file(CONFIGS / "cnn7-paper.toml"))

    assert isinstance(paper, PatchTraining)
    assert paper.network.topology == Topology()
    assert paper.network.normalisation.kind == "fixed"
    assert paper.labeller.support == "maximum"
    descent = paper.descent
    assert (descent.method, descent.momentum, descent.weight_decay) == ("sgd", 0, 0)
    assert paper.centres.extra == 4
    assert (paper.stopping.rule, paper.stopping.min_delta) == ("plateau", 0.001)
    assert 320 * 240 / paper.superpixels.pixels == 4.8e6 / 500 / 5


@pytest.mark.parametrize("path", THRESHOLDS, ids=lambda path: path.stem)
def test_the_default_threshold_is_the_one_that_was_chosen(path: Path) -> None:
    name, values = DetectorOptions(config=path).name_and_values()
    entry = detector_entry(name)

    chosen, default = (entry.make_settings(changes).model_dump() for changes in (values, {}))
    if name not in OWN:
        assert default.pop("threshold") == pytest.approx(chosen.pop("threshold"), abs=0.01)
    else:
        del default["threshold"], chosen["threshold"]
    assert chosen == default
    assert "#   roadtorch evaluate camvid" in path.read_text()
