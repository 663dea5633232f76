"""The settings of training: kinds, bounds, schedules, and the files that ship."""

import pytest

from roadtorch.base.errors import ConfigError
from roadtorch.train.config import (
    Descent,
    PatchTraining,
    as_values,
    build_training,
)


def test_the_defaults_are_p2s() -> None:
    training = build_training({})

    assert isinstance(training, PatchTraining)
    assert (training.augmentation.min_scale, training.augmentation.max_scale) == (0.6, 1.4)
    assert training.augmentation.rotation == 17
    assert (training.augmentation.min_noise, training.augmentation.max_noise) == (0.3, 1.2)
    assert training.centres.around == 4
    assert training.descent.method == "sgd"
    assert (training.stopping.rule, training.stopping.min_delta) == ("plateau", 0.001)


@pytest.mark.parametrize("kind", ["patches", "pictures"])
def test_settings_survive_the_way_to_nested_values_and_back(kind: str) -> None:
    training = build_training({"kind": kind, "random_seed": 5})

    assert build_training(as_values(training)) == training


@pytest.mark.parametrize(
    ("values", "told"),
    [
        ({"kind": "patch"}, r"patch: unknown kind of training \(did you mean patches\?\)"),
        ({"kind": "pictures", "mix": 3}, "mix: unknown setting"),
        (
            {"augmentation": {"min_scale": 2.0}},
            "augmentation.min_scale: 2 was given, and augmentation.max_scale is 1.4",
        ),
        ({"network": {"topology": {"size1": 9}}}, "topology: .* cannot halve"),
        (
            {"kind": "pictures", "network": {"heads": 1, "width": 80}},
            r"network.width: 80 was given .*multiple of 32",
        ),
        (
            {"kind": "pictures", "augmentation": {"ego_car": {"share": 0.5}}},
            r"augmentation.ego_car.share: is 0.5, .*recordings.separator",
        ),
        ({"kind": "pictures", "network": {"heads": 1}}, "start: is empty, and a backbone"),
    ],
)
def test_mistakes_are_told_with_their_key(values: dict[str, object], told: str) -> None:
    with pytest.raises(ConfigError, match=told):
        build_training(values)


def test_the_learning_rate_stays_or_falls_to_nothing() -> None:
    cosine = Descent(learning_rate=0.2, schedule="cosine")

    assert Descent(learning_rate=0.2).learning_rate_at(0.9) == 0.2
    assert cosine.learning_rate_at(0) == 0.2
    assert cosine.learning_rate_at(0.5) == pytest.approx(0.1)
    assert cosine.learning_rate_at(1) == pytest.approx(0)
