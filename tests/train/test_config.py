"""The settings of training: kinds, bounds, schedules, and the files that ship."""

from pathlib import Path

import pytest

from roadtorch.errors import ConfigError
from roadtorch.train.config import (
    Descent,
    PatchTraining,
    PictureTraining,
    as_values,
    build_training,
    read_training,
)

CONFIGS = Path(__file__).resolve().parents[2] / "configs"


def test_the_defaults_are_p2s() -> None:
    training = build_training({})

    assert isinstance(training, PatchTraining)
    assert (training.jitter.smallest, training.jitter.largest) == (0.6, 1.4)
    assert training.jitter.rotation == 17
    assert (training.jitter.faintest, training.jitter.noisiest) == (0.3, 1.2)
    assert training.sites.around == 4
    assert training.descent.method == "sgd"
    assert (training.stopping.rule, training.stopping.fall) == ("fall", 0.001)


@pytest.mark.parametrize("kind", ["patches", "pictures"])
def test_settings_survive_the_way_to_nested_values_and_back(kind: str) -> None:
    training = build_training({"kind": kind, "random_seed": 5})

    assert build_training(as_values(training)) == training


@pytest.mark.parametrize("path", sorted(CONFIGS.glob("*.toml")), ids=lambda path: path.stem)
def test_configs_that_ship_can_be_read(path: Path) -> None:
    assert isinstance(read_training(path), PatchTraining | PictureTraining)


@pytest.mark.parametrize(
    ("values", "told"),
    [
        ({"kind": "patch"}, r"patch: unknown kind of training \(did you mean patches\?\)"),
        ({"kind": ["patches"]}, r"unknown kind of training"),
        ({"kind": "pictures", "mix": 3}, "mix: unknown setting"),
        ({"network": {"height": 120}}, "network.height: unknown setting"),
        ({"seed": 0}, r"seed: has another name now \(write random_seed\)"),
        ({"kind": "pictures", "seed": 0}, r"seed: has another name now \(write random_seed\)"),
        (
            {"kind": "pictures", "road_weight": 1.0},
            r"road_weight: has another name now \(write heads.road\)",
        ),
        ({"descent": {"average": 1.0}}, "descent.average: 1.0 was given"),
        ({"jitter": {"smallest": 2.0}}, "jitter.smallest: 2 was given, and jitter.largest is 1.4"),
        ({"descent": {"rate": 0.0}}, "descent.rate: 0.0 was given"),
        ({"network": {"topology": {"size1": 9}}}, "topology: .* cannot halve"),
    ],
)
def test_mistakes_are_told_with_their_key(values: dict[str, object], told: str) -> None:
    with pytest.raises(ConfigError, match=told):
        build_training(values)


def test_the_step_length_stays_or_falls_to_nothing() -> None:
    cosine = Descent(rate=0.2, schedule="cosine")

    assert Descent(rate=0.2).rate_at(0.9) == 0.2
    assert cosine.rate_at(0) == 0.2
    assert cosine.rate_at(0.5) == pytest.approx(0.1)
    assert cosine.rate_at(1) == pytest.approx(0)
