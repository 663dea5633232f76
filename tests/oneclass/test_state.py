"""Saving, loading, and taking over what another one has learned."""

from pathlib import Path

import pytest
import torch

from roadtorch.errors import WeightsError
from roadtorch.oneclass import CLASSIFIERS, fit, load, restored, save
from roadtorch.oneclass.base import Classifier
from tests.oneclass.cases import HS, RGB, around_red, asphalt, colours, every_classifier, readings


@every_classifier
def test_saved_and_loaded_it_says_the_same(classifier: Classifier, tmp_path: Path) -> None:
    fitted = fit(classifier, around_red(), HS, classifier.settings(hue="chord"))
    pixels = colours(planes=2)

    save(fitted, tmp_path / "road.safetensors")
    again = load(classifier, tmp_path / "road.safetensors")

    assert torch.equal(again.distance(pixels), fitted.distance(pixels))
    assert torch.equal(again.likelihood(pixels), fitted.likelihood(pixels))
    assert [path.name for path in tmp_path.iterdir()] == ["road.safetensors"]


@every_classifier
def test_a_fitted_one_takes_over_another_state_of_its_kind(classifier: Classifier) -> None:
    small, large = fit(classifier, asphalt(3), RGB), fit(classifier, asphalt(90, seed=4), RGB)

    small.load_state_dict(large.state_dict())

    assert torch.equal(small.likelihood(colours()), large.likelihood(colours()))


@pytest.mark.parametrize(("classifier", "reading"), readings())
def test_it_takes_over_a_state_of_its_kind_whatever_the_settings(
    classifier: Classifier, reading: dict[str, str]
) -> None:
    usual, other = (
        fit(classifier, around_red(90, seed), HS, classifier.settings.model_validate(told))
        for seed, told in ((0, {}), (1, reading))
    )
    pixels = colours(planes=2)
    expected = usual.likelihood(pixels)

    other.load_state_dict(usual.state_dict())

    assert torch.equal(other.likelihood(pixels), expected)


@every_classifier
def test_a_state_with_a_part_missing_or_cut_is_refused_and_changes_nothing(
    classifier: Classifier,
) -> None:
    fitted, state = fit(classifier, asphalt(), RGB), fit(classifier, asphalt(50), RGB).state_dict()
    before = fitted.distance(colours())

    for name in state:
        without = {key: value for key, value in state.items() if key != name}
        cut = state | {name: state[name].flatten()[:-1]}
        for spoilt in (without, cut):
            with pytest.raises(WeightsError, match=r"^state: "):
                fitted.load_state_dict(spoilt)
            with pytest.raises(WeightsError, match=r"^state: "):
                restored(classifier, spoilt)
    with pytest.raises(WeightsError, match=r"surplus is \(2,\)"):
        restored(classifier, state | {"surplus": torch.zeros(2)})

    assert torch.equal(fitted.distance(colours()), before)


@every_classifier
def test_the_state_of_another_classifier_is_refused(classifier: Classifier, tmp_path: Path) -> None:
    names = list(CLASSIFIERS)
    other = CLASSIFIERS[names[names.index(classifier.name) - 1]]
    foreign = fit(other, asphalt(), RGB)
    save(foreign, tmp_path / "road.safetensors")
    told = f"^state: is that of {other.name} .give one of {classifier.name}.$"

    with pytest.raises(WeightsError, match=told):
        restored(classifier, foreign.state_dict())
    with pytest.raises(WeightsError, match=told.replace("^state", r"road\.safetensors")):
        load(classifier, tmp_path / "road.safetensors")
    with pytest.raises(WeightsError, match=told):
        fit(classifier, asphalt(), RGB).load_state_dict(foreign.state_dict())


@every_classifier
def test_a_state_of_other_planes_is_refused(classifier: Classifier) -> None:
    of_hue = fit(classifier, around_red(), HS)

    with pytest.raises(WeightsError, match=r"was learned on the planes H, S .give one learned on"):
        fit(classifier, asphalt(), RGB).load_state_dict(of_hue.state_dict())
