import sys
from pathlib import Path
from types import ModuleType
from typing import Literal, NamedTuple

import numpy as np
import pytest
import torch
from PIL import Image
from torch import Tensor

from roadtorch.settings import Settings
from tests.cli.conftest import Call


class LayoutLabels(NamedTuple):
    potentials: Tensor
    labels: Tensor


class LabellerSettings(Settings):
    support: Literal["margin", "maximum"] = "margin"
    segments: int = 300


def label_layout(image: Tensor, settings: LabellerSettings) -> LayoutLabels:
    """Sky above, horizontal below, doubt between unless every pixel is to have a class."""
    height, width = image.shape[1:]
    labels = torch.full((height, width), 255 if settings.support == "margin" else 1)
    labels[: height // 4] = 0
    labels[height // 2 :] = 2
    return LayoutLabels(torch.zeros(3, height, width), labels)


@pytest.fixture(autouse=True)
def labeller(monkeypatch: pytest.MonkeyPatch) -> None:
    """A labeller whose labels are known: the real one has tests of its own."""
    module = ModuleType("roadtorch.layout.labeller")
    vars(module).update(label_layout=label_layout, LabellerSettings=LabellerSettings)
    monkeypatch.setitem(sys.modules, "roadtorch.layout", ModuleType("roadtorch.layout"))
    monkeypatch.setitem(sys.modules, "roadtorch.layout.labeller", module)


def labels_in(path: Path) -> np.ndarray:
    return np.asarray(Image.open(path))


def test_labels_are_written_as_one_byte_a_pixel(call: Call, footage: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"

    result = call("label", footage, "--out", out)

    assert result.exit_code == 0
    labels = labels_in(out / "sub" / "c.png")
    assert labels.dtype == np.uint8
    assert labels[[0, 20, 40], 5].tolist() == [0, 255, 2]
    assert sorted(path.name for path in out.iterdir()) == [
        "a.png",
        "b.png",
        "config.toml",
        "index.csv",
        "sub",
    ]


def test_maximum_support_labels_every_pixel(call: Call, footage: Path, tmp_path: Path) -> None:
    call("label", footage, "--out", tmp_path / "out", "--support", "maximum", "--overlay")

    assert set(np.unique(labels_in(tmp_path / "out" / "a.png"))) == {0, 1, 2}
    with Image.open(tmp_path / "out" / "a.overlay.jpg") as overlay:
        assert overlay.size == (64, 48)


def test_labels_never_replace_the_pictures(call: Call, footage: Path) -> None:
    before = (footage / "b.png").read_bytes()

    result = call("label", footage, "--out", footage)

    assert result.exit_code == 2
    assert "b.png: is one of the pictures" in result.stderr
    assert (footage / "b.png").read_bytes() == before


def test_broken_pictures_do_not_hold_up_the_others(
    call: Call, footage: Path, tmp_path: Path
) -> None:
    (footage / "empty.png").touch()

    result = call("label", footage, "--out", tmp_path / "out")

    assert result.exit_code == 1
    assert "3 done, 1 failed" in result.stderr


def test_settings_are_checked(call: Call, footage: Path, tmp_path: Path) -> None:
    result = call("label", footage, "--out", tmp_path / "out", "--set", "segment=3")

    assert result.exit_code == 2
    assert "segment: unknown setting (did you mean segments?)" in result.stderr
