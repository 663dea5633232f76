"""Inputs that failed, after public bug reports: each case's script prints PASS."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
CASES = ROOT.parent / "shared" / "cases"
NEEDS = {"annotate_other_folder": "playwright", "ros_whole_number": "rclpy"}
"""Modules without which a case cannot run."""


@pytest.mark.slow
@pytest.mark.data
@pytest.mark.parametrize("name", sorted(path.parent.name for path in CASES.glob("*/run.sh")))
def test_a_case_passes(name: str) -> None:
    pytest.importorskip(NEEDS.get(name, "roadtorch"))
    if "roadtorch grid" in (CASES / name / "run.sh").read_text(encoding="utf-8"):
        pytest.skip("grid is an output of infer now; tests/camera and tests/run/test_grids.py")
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    words = ["bash", str(CASES / "run_all.sh"), name]

    done = subprocess.run(words, env={**os.environ, "PATH": path}, capture_output=True, text=True)

    assert done.stdout == f"PASS {name}\n", done.stdout + done.stderr
