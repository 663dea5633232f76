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

OF_GRID = {"image_rect", "kitti_calibration"}
"""Cases of options that the command ``grid`` had: tests/camera/test_ground.py has their faults."""

AS_OUTPUT = """#!/bin/bash
[ "$1" = grid ] || exec {program} "$@"
shift; words=(); settings=()
while [ $# -gt 0 ]; do
  case $1 in
    --height | --pitch | --fov) settings+=(--set "grid.${{1#--}}=$2"); shift ;;
    --camera-info)
      {program} camera "${{words[0]}}" --out "${{2%.*}}.toml" --camera-info "$2" || exit
      settings+=(--camera "${{2%.*}}.toml"); shift ;;
    *) words+=("$1") ;;
  esac
  shift
done
exec {program} infer "${{words[@]}}" --save grid "${{settings[@]}}"
"""
"""roadtorch with the command ``grid``, which cases call, as the output of ``infer`` that it is."""


@pytest.mark.slow
@pytest.mark.data
@pytest.mark.parametrize("name", sorted(path.parent.name for path in CASES.glob("*/run.sh")))
def test_a_case_passes(name: str, tmp_path: Path) -> None:
    pytest.importorskip(NEEDS.get(name, "roadtorch"))
    if name in OF_GRID:
        pytest.skip("it calls options of a command that is gone")
    programs = Path(sys.executable).parent
    (tmp_path / "roadtorch").write_text(AS_OUTPUT.format(program=programs / "roadtorch"))
    (tmp_path / "roadtorch").chmod(0o755)
    path = os.pathsep.join([str(tmp_path), str(programs), os.environ["PATH"]])
    words = ["bash", str(CASES / "run_all.sh"), name]

    done = subprocess.run(words, env={**os.environ, "PATH": path}, capture_output=True, text=True)

    assert done.stdout == f"PASS {name}\n", done.stdout + done.stderr
