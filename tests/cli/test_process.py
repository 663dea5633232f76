"""The installed command as its users call it: real files in, real files out."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
from PIL import Image

from roadtorch.cli.group import BRIEF_WAITS
from roadtorch.scenes.street import render_scene

COMMAND = [sys.executable, "-m", "roadtorch"]


def run(*arguments: object, cwd: Path) -> subprocess.CompletedProcess[str]:
    words = [*COMMAND, *map(str, arguments)]
    return subprocess.run(words, capture_output=True, text=True, cwd=cwd, timeout=120)


def test_pictures_become_maps_and_a_broken_one_a_failed_row(tmp_path: Path) -> None:
    pictures = tmp_path / "pictures"
    pictures.mkdir()
    scene = (render_scene(3).image * 255).round().byte().permute(1, 2, 0).numpy()
    Image.fromarray(scene).save(pictures / "scene.jpg")
    (pictures / "broken.jpg").write_bytes((pictures / "scene.jpg").read_bytes()[:1000])

    done = run("infer", "pictures", "--detector", "grey-uniformity", "--out", "out", cwd=tmp_path)

    assert done.returncode == 1
    assert done.stdout == ""
    assert "pictures/broken.jpg: cannot be decoded" in done.stderr
    assert done.stderr.endswith("roadtorch: 1 done, 1 failed; results in out\n")
    likelihood = np.asarray(Image.open(tmp_path / "out" / "scene.likelihood.png"))
    assert likelihood.shape == (240, 320)
    assert likelihood.std() > 0
    mask = np.asarray(Image.open(tmp_path / "out" / "scene.mask.png"))
    assert set(np.unique(mask)) <= {0, 255}


def test_mistakes_are_one_line_without_a_traceback(tmp_path: Path) -> None:
    done = run("infer", "none.jpg", "--detector", "fusoin", cwd=tmp_path)

    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr.startswith("roadtorch: error: fusoin: unknown detector (")
    assert done.stderr.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_a_reader_that_leaves_early_is_no_crash(tmp_path: Path) -> None:
    with subprocess.Popen(
        [*COMMAND, "planes"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, cwd=tmp_path
    ) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdout.close()
        complaints = process.stderr.read()
        process.wait(timeout=120)

    assert complaints == b""


def test_threads_wait_briefly_unless_the_user_says_otherwise() -> None:
    code = "from roadtorch.cli import main; import os, atexit; atexit.register(lambda: print("
    code += "os.environ['OMP_WAIT_POLICY'], os.environ.get('GOMP_SPINCOUNT'))); main(['planes'])"
    words = [sys.executable, "-c", code]

    for given, kept in ({}, "passive 20000"), ({"OMP_WAIT_POLICY": "active"}, "active None"):
        rest = {k: v for k, v in os.environ.items() if k not in BRIEF_WAITS}
        done = subprocess.run(words, capture_output=True, text=True, env=rest | given, timeout=60)
        assert done.stdout.splitlines()[-1] == kept


def test_where_the_system_speaks_ascii_names_are_written_in_utf_8(tmp_path: Path) -> None:
    pictures = tmp_path / "pictures"
    pictures.mkdir()
    for name in (b"z\xff.png", "Straße.png".encode()):
        Image.new("RGB", (40, 30), (90, 90, 90)).save(pictures / os.fsdecode(name))
    words = [*COMMAND, "infer", "pictures", "--detector", "prior:rows", "--out", "out"]
    ascii_only = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}

    done = subprocess.run(words, cwd=tmp_path, env=os.environ | ascii_only, timeout=120)

    assert done.returncode == 0
    rows = (tmp_path / "out" / "index.csv").read_text(encoding="utf-8").splitlines()[1:]
    assert [row.partition(",")[0] for row in rows] == ["Straße.png", r"z\xff.png"]
    assert (tmp_path / "out" / "Straße.mask.png").exists()
