"""The settings of training: kinds, bounds, schedules, and the files that ship."""

from collections.abc import Iterator

import pytest

from roadtorch.errors import ConfigError
from roadtorch.settings import Settings, parse_assignments
from roadtorch.train.config import (
    KINDS,
    Descent,
    PatchTraining,
    as_values,
    build_training,
    with_current_names,
)
from roadtorch.train.folder import flat


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
        (
            {"kind": "pictures", "network": {"heads": 1, "width": 80}},
            r"network.width: 80 was given .*multiple of 32",
        ),
        (
            {"kind": "pictures", "network": {"wide": 7}},
            r"network.wide: 7 was given .*multiple of 8",
        ),
        (
            {"kind": "pictures", "network": {"heads": 1, "hight": 64}},
            r"network.hight: unknown setting \(did you mean network.height",
        ),
    ],
)
def test_mistakes_are_told_with_their_key(values: dict[str, object], told: str) -> None:
    with pytest.raises(ConfigError, match=told):
        build_training(values)


def renamed_keys(kind: type[Settings], path: str = "") -> Iterator[tuple[str, str]]:
    """All keys that had other names, old and new, with the path to them."""
    yield from ((path + old, path + new) for old, new in kind.renamed.items())
    for name, field in kind.model_fields.items():
        if isinstance(field.annotation, type) and issubclass(field.annotation, Settings):
            yield from renamed_keys(field.annotation, f"{path}{name}.")


@pytest.mark.parametrize(("kind", "count"), [("patches", 11), ("pictures", 13)])
def test_an_old_key_is_told_the_new_one_which_there_is(kind: str, count: int) -> None:
    names = dict(renamed_keys(KINDS[kind]))
    known = flat(KINDS[kind]().model_dump())

    assert len(names) == count
    for old, new in names.items():
        assert any(key == new or key.startswith(f"{new}.") for key in known)
        with pytest.raises(ConfigError, match=rf"has another name now \(write {new}\)"):
            build_training(parse_assignments([f"kind={kind}", f"{old}=0.1"]))


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
