"""torchvision beside the torch that is installed, beside another one, and not there at all."""

import subprocess
import sys
from pathlib import Path

import pytest

from roadtorch.base import vision

CODE = """
import torch
from roadtorch.base.vision import import_torchvision
network = import_torchvision().models.mobilenet_v3_small(weights=None).eval()
with torch.no_grad():
    print(tuple(network(torch.zeros(1, 3, 32, 32)).shape))
again = import_torchvision.__wrapped__()  # its operators are declared now, and twice is an error
print(again.transforms.v2.functional.adjust_gamma(torch.ones(3, 1, 1) / 2, 2).sum())
"""


def test_its_networks_and_transforms_run() -> None:
    done = subprocess.run([sys.executable, "-c", CODE], capture_output=True, text=True, check=False)

    assert done.stdout == "(1, 1000)\ntensor(0.7500)\n", done.stderr


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
