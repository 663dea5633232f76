"""Kills and calls that fail, a few of them: nothing is lost. The scripts do them all."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import torch

from scripts.torture import differences

SCRIPTS = Path(__file__).resolve().parents[2] / "scripts"
ROWS = ("--detector", "prior:rows", "--pictures", "4")


def told(script: str, *words: str) -> str:
    command = [sys.executable, SCRIPTS / script, *words]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=3600, check=False)
    assert ended.returncode == 0, ended.stdout + ended.stderr
    return ended.stdout


@pytest.mark.parametrize(
    "words",
    [
        ("torture.py", "infer", "--kills", "6", "--jobs", "2", *ROWS),
        pytest.param(("torture.py", "evaluate", "--kills", "20", *ROWS), marks=pytest.mark.slow),
        pytest.param(("torture.py", "train", "--kills", "20", *ROWS), marks=pytest.mark.slow),
        pytest.param(("torture.py", "adapt", "--kills", "20", *ROWS), marks=pytest.mark.slow),
        pytest.param(("torture_annotate.py", "--kills", "10"), marks=pytest.mark.slow),
    ],
    ids=["infer", "evaluate", "train", "adapt", "annotate"],
)
def test_a_few_kills_break_nothing(words: tuple[str, ...]) -> None:
    assert told(*words).endswith("; 0 faults\n")


@pytest.mark.skipif(shutil.which("cc") is None, reason="the failing calls need a C compiler")
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="LD_PRELOAD is Linux's")
@pytest.mark.parametrize(
    "words",
    [
        ("infer", "import", "--every", "59"),
        pytest.param(("--every", "5"), marks=pytest.mark.slow),
    ],
    ids=["some", "all"],
)
def test_a_call_that_fails_costs_nothing_when_the_command_is_started_again(
    words: tuple[str, ...],
) -> None:
    lines = told("faults.py", *words).splitlines()

    assert all(" cases (" in line and line.endswith("; 0 broken") for line in lines)


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
