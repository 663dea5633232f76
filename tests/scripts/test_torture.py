"""Kills at random moments, a few of them, and the comparison that finds what they broke."""

import subprocess
import sys
from pathlib import Path

import pytest
import torch

from scripts.torture import differences

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize(
    "command",
    [
        ("infer", "--kills", "6", "--detector", "prior:rows", "--jobs", "2"),
        pytest.param(
            ("evaluate", "--kills", "20", "--detector", "prior:rows"), marks=pytest.mark.slow
        ),
        pytest.param(("train", "--kills", "20"), marks=pytest.mark.slow),
    ],
    ids=lambda command: command[0],
)
def test_a_few_kills_break_nothing(command: tuple[str, ...]) -> None:
    script = ROOT / "scripts" / "torture.py"

    ended = subprocess.run(
        [sys.executable, script, *command, "--pictures", "4"],
        capture_output=True,
        text=True,
        timeout=900,
        check=False,
    )

    assert ended.returncode == 0, ended.stdout + ended.stderr
    assert ended.stdout.endswith("; 0 faults\n")


def test_differences_are_found(tmp_path: Path) -> None:
    quiet, out = tmp_path / "quiet", tmp_path / "out"
    for at, folder in enumerate((quiet, out)):
        folder.mkdir()
        torch.save({"steps": [torch.ones(2)]}, folder / "same.pt")
        torch.save({"steps": [torch.full((2,), at)]}, folder / "checkpoint.pt")
        (folder / "a.mask.png").write_bytes(b"same")
        (folder / f"{folder.name}.part").touch()
        (folder / "index.csv").write_text(folder.name)

    assert list(differences(quiet, out)) == [
        "quiet.part is missing",
        "out.part is stray",
        "checkpoint.pt has other values",
        "index.csv has other bytes",
    ]
