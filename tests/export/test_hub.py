"""Folder for a model hub: it holds the detector and its description."""

import shutil
from pathlib import Path

import pytest
import torch

from roadtorch import load_detector
from roadtorch.base.errors import ConfigError, InputError
from roadtorch.export.folders import export_hub
from roadtorch.layout.weights import read_terms
from roadtorch.testing import street
from tests.networks import write_ego_network


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    export_hub(load_detector("fusion", threshold=0.6), tmp_path / "first")
    return Path(shutil.move(tmp_path / "first", tmp_path / "moved"))


def test_the_folder_is_the_detector_wherever_it_is(folder: Path) -> None:
    image, expected = street(120, 160, 3), load_detector("fusion", threshold=0.6)

    loaded = load_detector(str(folder))

    assert loaded.settings.threshold == 0.6
    assert torch.equal(loaded(image).mask, expected(image).mask)
    assert loaded(image).trust == expected(image).trust
    assert load_detector(str(folder), threshold=0.7).settings.threshold == 0.7


def test_a_folder_named_like_a_detector_is_not_loaded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "fusion").mkdir()
    monkeypatch.chdir(tmp_path)

    assert load_detector("fusion").name == "fusion"


def test_its_cards_state_the_terms_and_have_no_dead_links(folder: Path) -> None:
    names = {path.name for path in folder.iterdir()}
    assert names == {"model.safetensors", "detector.toml", "README.md", "model.md"}
    front = (folder / "README.md").read_text(encoding="utf-8")
    assert front.startswith("---\nlicense: apache-2.0\n")
    assert "](../" not in front + (folder / "model.md").read_text(encoding="utf-8")
    assert read_terms(folder / "model.safetensors").startswith("anything")


def test_both_networks_of_a_detector_are_in_the_folder(tmp_path: Path) -> None:
    export_hub(load_detector("fusion:large"), tmp_path)

    names = {path.name for path in tmp_path.iterdir()}
    assert {"model.safetensors", "model.md", "second.safetensors", "second.md"} < names
    image = street(120, 160, 3)
    expected = load_detector("fusion:large")(image)
    assert torch.equal(load_detector(str(tmp_path))(image).likelihood, expected.likelihood)
    assert 'file = "second.safetensors"' in (tmp_path / "detector.toml").read_text()


def test_weights_without_a_card_have_terms_of_their_own(tmp_path: Path) -> None:
    weights = write_ego_network(tmp_path / "own.safetensors", bottom=0.25)

    export_hub(load_detector("fusion", weights={"file": str(weights)}), tmp_path / "hub")

    assert "license: other" in (tmp_path / "hub" / "README.md").read_text(encoding="utf-8")
    assert not (tmp_path / "hub" / "model.md").exists()


def test_what_has_no_network_and_what_is_no_such_folder_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="lbp: cannot be exported"):
        export_hub(load_detector("lbp"), tmp_path / "hub")
    with pytest.raises(InputError, match=r"detector\.toml: cannot be read"):
        load_detector(str(tmp_path))
