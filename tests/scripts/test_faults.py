"""Calls that fail, a few of each command; kills of the correction page. The scripts do them all."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPTS = Path(__file__).resolve().parents[2] / "scripts"


def told(script: str, *words: str) -> str:
    command = [sys.executable, SCRIPTS / script, *words]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=3600, check=False)
    assert ended.returncode == 0, ended.stdout + ended.stderr
    return ended.stdout


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


@pytest.mark.slow
def test_kills_of_the_page_lose_no_act_that_was_acknowledged() -> None:
    assert told("torture_annotate.py", "--kills", "10").endswith("; 0 faults\n")
