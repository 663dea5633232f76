import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]

CODE = """
import torch
{before}
from scripts.torchvision_shim import declare_missing_operators, torchvision
network = torchvision.models.mobilenet_v3_small(weights=None).eval()
with torch.no_grad():
    print(tuple(network(torch.zeros(1, 3, 32, 32)).shape), declare_missing_operators())
"""


def output_of(before: str) -> str:
    done = subprocess.run(
        [sys.executable, "-c", CODE.format(before=before)],
        capture_output=True,
        text=True,
        cwd=ROOT,  # from where ``scripts`` can be imported
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_torchvision_can_be_imported_and_its_networks_run() -> None:
    assert output_of("") == "(1, 1000) []"


def test_operators_that_somebody_declared_before_are_left_alone() -> None:
    declare = "torch.library.define('torchvision::nms', '(Tensor a, Tensor b, float c) -> Tensor')"

    # Where torchvision's own library loads it declares nms itself, and twice is an error.
    before = f"try: import torchvision\nexcept RuntimeError: {declare}"

    assert output_of(before) == "(1, 1000) []"
