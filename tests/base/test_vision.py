"""torchvision beside the torch that is installed, beside another one, and not there at all."""

import sys
from pathlib import Path

import pytest
import torch

from roadtorch.base import vision


def test_its_networks_and_transforms_run() -> None:
    network = vision.import_torchvision().models.mobilenet_v3_small(weights=None).eval()
    again = vision.import_torchvision.__wrapped__()  # declaring its operators twice is an error

    with torch.no_grad():
        assert network(torch.zeros(1, 3, 32, 32)).shape == (1, 1000)
    half = again.transforms.v2.functional.adjust_gamma(torch.ones(3, 1, 1) / 2, 2)
    assert half.sum() == 0.75


def test_one_of_another_build_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    broken = 'raise RuntimeError("compiled with another CUDA\\nand more")'
    (tmp_path / "torchvision.py").write_text(broken)
    for name in [name for name in sys.modules if name.partition(".")[0] == "torchvision"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.syspath_prepend(tmp_path)

    with pytest.raises(vision.RoadtorchError) as caught:
        vision.import_torchvision.__wrapped__()

    told = str(caught.value)
    assert told.startswith("torchvision: cannot be imported beside torch ")
    assert "compiled with another CUDA (pip install" in told
    assert "\n" not in told
