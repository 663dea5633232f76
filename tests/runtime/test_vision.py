"""torchvision beside the torch that is installed, beside another one, and not there at all."""

import subprocess
import sys
from pathlib import Path

import pytest

from roadtorch.runtime import vision

CODE = """
import torch
{before}
from roadtorch.runtime.vision import import_torchvision
network = import_torchvision().models.mobilenet_v3_small(weights=None).eval()
with torch.no_grad():
    print(tuple(network(torch.zeros(1, 3, 32, 32)).shape))
print(import_torchvision().transforms.v2.functional.adjust_gamma(torch.ones(3, 1, 1) / 2, 2).sum())
"""

# Where torchvision's own library loads it declares nms itself, and twice is an error.
DECLARED = """
try: import torchvision
except RuntimeError:
    torch.library.define('torchvision::nms', '(Tensor a, Tensor b, float c) -> Tensor')
"""

OTHER_BUILD = 'raise RuntimeError("compiled with another CUDA\\nand more")'


def run(code: str, *first: Path) -> subprocess.CompletedProcess[str]:
    paths = [str(path) for path in first]
    code = f"import sys; sys.path[:0] = {paths}\n{code}"
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)


@pytest.mark.parametrize("before", ["", DECLARED])
def test_its_networks_and_transforms_run(before: str) -> None:
    done = run(CODE.format(before=before))

    assert done.stdout == "(1, 1000)\ntensor(0.7500)\n", done.stderr


def test_one_of_another_build_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "torchvision.py").write_text(OTHER_BUILD)

    done = run("from roadtorch.runtime.vision import *; import_torchvision()", tmp_path)

    told = done.stderr.splitlines()[-1]
    assert "RoadtorchError: torchvision: cannot be imported beside torch" in told
    assert "compiled with another CUDA (pip install" in told


def test_none_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(vision, "find_spec", lambda _: None)

    with pytest.raises(vision.RoadtorchError, match=r"torchvision: is not installed \(pip install"):
        vision.import_torchvision.__wrapped__()
