"""Import of torchvision beside another build of torch, and peak memory."""

import subprocess
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

    message = str(caught.value)
    assert message.startswith("torchvision: cannot be imported beside torch ")
    assert "compiled with another CUDA (pip install" in message
    assert "\n" not in message


# --- compute ----------------------------------------------------------------------------


ALLOCATION = """
from roadtorch.base.compute import peak_memory_mib
base = peak_memory_mib()
block = bytearray(64 * 2**20)
for position in range(0, len(block), 4096):  # pages count when they are written
    block[position] = 1
del block
print(base, peak_memory_mib())
"""


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere it begins with the parent's")
def test_peak_memory_includes_freed_memory_but_not_that_of_the_parent() -> None:
    parent = bytearray(b"1") * (256 * 2**20)

    output = subprocess.check_output([sys.executable, "-c", ALLOCATION], text=True)

    base, peak = map(float, output.split())
    assert 1 < base < len(parent) / 2**20
    assert base + 60 < peak < base + 90
