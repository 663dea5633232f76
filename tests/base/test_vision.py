"""torchvision beside a torch of another build; threads, memory, devices."""

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

    told = str(caught.value)
    assert told.startswith("torchvision: cannot be imported beside torch ")
    assert "compiled with another CUDA (pip install" in told
    assert "\n" not in told


# --- compute ----------------------------------------------------------------------------


HELD = """
from roadtorch.base.compute import reset_peak_memory, peak_memory_mib
reset_peak_memory()
before = peak_memory_mib()
held = bytearray(64 * 2**20)
for place in range(0, len(held), 4096):  # pages count when they are written
    held[place] = 1
del held
print(before, peak_memory_mib())
"""


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere a peak cannot be forgotten")
def test_it_is_what_was_held_though_let_go_of_and_not_what_the_parent_held() -> None:
    parent = bytearray(b"1") * (256 * 2**20)

    told = subprocess.check_output([sys.executable, "-c", HELD], text=True)

    before, peak = map(float, told.split())
    assert 1 < before < len(parent) / 2**20
    assert before + 60 < peak < before + 90
