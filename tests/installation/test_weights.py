import shutil
from pathlib import Path

import pytest

from roadtorch.installation import weights
from roadtorch.layout import weights as files


def test_the_shipped_weights_are_what_their_cards_state() -> None:
    found = {one.name: one for one in weights.check_weights()}

    assert {"cnn-7.safetensors", "layout.safetensors"} <= {*found}
    assert {one.state for one in found.values()} == {"ok"}
    assert found["layout.safetensors"].what.endswith("as layout.md states")


def test_other_bytes_are_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for path in files.SHIPPED.glob("cnn-7.*"):
        shutil.copy(path, tmp_path)
    changed = tmp_path / "cnn-7.safetensors"
    changed.write_bytes(changed.read_bytes()[:-1] + b"\xff")
    monkeypatch.setattr(files, "SHIPPED", tmp_path)

    (check,) = weights.check_weights()

    assert check.state == "broken"
    assert check.what == "is not the file whose SHA-256 cnn-7.md states"


def test_no_weights_at_all_are_broken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(files, "SHIPPED", tmp_path)

    assert [one.state for one in weights.check_weights()] == ["broken"]
