"""A few of the troubles of scripts/chaos.py: nothing is lost. The script tries them all."""

import subprocess
import sys
from pathlib import Path

import pytest
import torch

from scripts.chaos import TROUBLE, differences

SCRIPT = Path(__file__).resolve().parents[2] / "scripts" / "chaos.py"


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="workers are found in /proc")
@pytest.mark.parametrize(
    ("trouble", "words"),
    [
        ("kill", ("infer", "--times", "1", "--jobs", "2")),
        *(pytest.param(name, ("--times", "3"), marks=pytest.mark.slow) for name in TROUBLE),
    ],
)
def test_trouble_costs_nothing_after_another_start(trouble: str, words: tuple[str, ...]) -> None:
    command = [sys.executable, SCRIPT, trouble, *words]
    done = subprocess.run(command, capture_output=True, text=True, timeout=3600, check=False)

    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.splitlines()[-1].endswith("wrong 0")


def test_differences_are_reported(tmp_path: Path) -> None:
    quiet, out = tmp_path / "quiet", tmp_path / "out"
    for at, folder in enumerate((quiet, out)):
        folder.mkdir()
        torch.save({"steps": [torch.ones(2)], "seconds": float(at)}, folder / "same.pt")
        torch.save({"steps": [torch.full((2,), at)]}, folder / "checkpoint.pt")
        (folder / "a.mask.png").write_bytes(b"same")
        (folder / f"{folder.name}.part").touch()
        (folder / "index.csv").write_text(f"file,ms,road\na.png,{at},.5\n")
        (folder / "images.csv").write_text(f"file,ms,road\na.png,0,{at}\n")

    assert list(differences(quiet, out)) == [
        "quiet.part is missing",
        "out.part is stray",
        "checkpoint.pt has other content",
        "images.csv has other content",
    ]
