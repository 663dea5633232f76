"""The settings of training: kinds, bounds, schedules, and the files that ship."""

import pytest

from roadtorch.errors import ConfigError
from roadtorch.settings import parse_assignments
from roadtorch.train.config import (
    Descent,
    PatchTraining,
    as_values,
    build_training,
    with_current_names,
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
        ({"kind": ["patches"]}, r"unknown kind of training"),
        ({"kind": "pictures", "mix": 3}, "mix: unknown setting"),
        ({"network": {"height": 120}}, "network.height: unknown setting"),
        ({"descent": {"ema": 1.0}}, "descent.ema: 1.0 was given"),
        (
            {"augmentation": {"min_scale": 2.0}},
            "augmentation.min_scale: 2 was given, and augmentation.max_scale is 1.4",
        ),
        ({"descent": {"learning_rate": 0.0}}, "descent.learning_rate: 0.0 was given"),
        ({"network": {"topology": {"size1": 9}}}, "topology: .* cannot halve"),
    ],
)
def test_mistakes_are_told_with_their_key(values: dict[str, object], told: str) -> None:
    with pytest.raises(ConfigError, match=told):
        build_training(values)


OLD = {
    "patches": {
        "seed": "random_seed",
        "sites": "centres",
        "jitter": "augmentation",
        "augmentation.smallest": "augmentation.min_scale",
        "augmentation.noisiest": "augmentation.max_noise",
        "descent.decay": "descent.weight_decay",
        "stopping.fall": "stopping.min_delta",
    },
    "pictures": {
        "seed": "random_seed",
        "road_weight": "heads.road",
        "visits": "samples_per_epoch",
        "light.gamma": "augmentation.light",
        "shift.move": "augmentation.geometry",
        "surfaces.share": "augmentation.surface",
        "shadows.share": "augmentation.shadow",
        "nights.share": "augmentation.night",
        "ego_cars.share": "augmentation.ego_car",
        "descent.rate": "descent.learning_rate",
        "descent.average": "descent.ema",
    },
}
"""Keys of older versions, by kind, and what to write."""


@pytest.mark.parametrize(
    ("kind", "old", "new"), [(k, *pair) for k, names in OLD.items() for pair in names.items()]
)
def test_an_old_key_is_told_the_new_one(kind: str, old: str, new: str) -> None:
    values = parse_assignments([f"kind={kind}", f"{old}=0.1"])

    with pytest.raises(ConfigError, match=rf"has another name now \(write {new}\)"):
        build_training(values)


def test_settings_that_an_older_version_wrote_down_get_todays_names() -> None:
    old = {
        "kind": "pictures",
        "seed": 3,
        "visits": 40,
        "road_weight": 2.0,
        "shift": {"move": 0.2},
        "ego_cars": {"share": 0.1},
        "descent": {"rate": 0.1, "decay": 0.2, "average": 0.3, "batch": 4},
        "stopping": {"rule": "fall", "fall": 0.5},
    }

    assert with_current_names(old) == {
        "kind": "pictures",
        "random_seed": 3,
        "samples_per_epoch": 40,
        "heads": {"road": 2.0},
        "augmentation": {"geometry": {"move": 0.2}, "ego_car": {"share": 0.1}},
        "descent": {"learning_rate": 0.1, "weight_decay": 0.2, "ema": 0.3, "batch": 4},
        "stopping": {"rule": "plateau", "min_delta": 0.5},
    }


def test_the_learning_rate_stays_or_falls_to_nothing() -> None:
    cosine = Descent(learning_rate=0.2, schedule="cosine")

    assert Descent(learning_rate=0.2).learning_rate_at(0.9) == 0.2
    assert cosine.learning_rate_at(0) == 0.2
    assert cosine.learning_rate_at(0.5) == pytest.approx(0.1)
    assert cosine.learning_rate_at(1) == pytest.approx(0)
