"""The installed command with real files and streams, and its imports."""

import os
import subprocess
import sys
from pathlib import Path

from roadtorch.cli.group import OPENMP_WAIT
from roadtorch.testing.scenes import render_scene, write_image

COMMAND = [sys.executable, "-m", "roadtorch"]

UNUSED = (
    *("torchvision", "matplotlib", "skimage", "sklearn", "pandas", "jinja2", "onnx"),
    *("onnxruntime", "av", "rosbags", "starlette", "scipy.optimize", "scipy.stats"),
    *("torch._dynamo", "torch._inductor"),
)
"""Slow imports that `infer` on images does not need."""

LISTING = """
import atexit, sys
from roadtorch.cli import main
atexit.register(lambda: open("loaded", "w").write(" ".join(sys.modules)))
main()
"""


def test_images_become_maps_and_a_broken_one_a_failed_row_even_in_ascii(tmp_path: Path) -> None:
    images, out = tmp_path / "images", tmp_path / "out"
    write_image(images / "Straße.png", render_scene(3))
    whole = (images / "Straße.png").read_bytes()
    (images / os.fsdecode(b"z\xff.png")).write_bytes(whole)
    (images / "broken.png").write_bytes(whole[:1000])
    ascii_only = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}

    words = [sys.executable, "-c", LISTING, "infer", "images", "--out", "out", "--jobs", "1"]
    options = {"env": os.environ | ascii_only, "encoding": "utf-8", "timeout": 600}
    done = subprocess.run(words, cwd=tmp_path, capture_output=True, **options)

    assert done.returncode == 1
    assert done.stdout.startswith("roadtorch: 0 doubtful of 2; least trusted (trust does")
    assert "images/broken.png: cannot be decoded" in done.stderr
    assert "roadtorch: 2 done, 1 failed; results in out\n" in done.stderr
    rows = (out / "index.csv").read_text(encoding="utf-8").splitlines()[1:]
    names = ["Straße.png", "broken.png", r"z\xff.png"]
    assert [row.partition(",")[0] for row in rows] == names
    assert (out / "Straße.mask.png").is_file()
    assert set(UNUSED).isdisjoint((tmp_path / "loaded").read_text().split())


def test_a_reader_that_leaves_early_is_no_crash() -> None:
    with subprocess.Popen(
        [*COMMAND, "--help"], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    ) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdout.close()
        complaints = process.stderr.read()
        process.wait(timeout=600)

    assert complaints == b""


def test_threads_wait_briefly_unless_the_user_says_otherwise() -> None:
    code = "from roadtorch.cli import main; import os, atexit; atexit.register(lambda: print("
    code += "os.environ['OMP_WAIT_POLICY'], os.environ.get('GOMP_SPINCOUNT'))); main(['--version'])"
    words = [sys.executable, "-c", code]

    for chosen, expected in ({}, "passive 20000"), ({"OMP_WAIT_POLICY": "active"}, "active None"):
        environment = {k: v for k, v in os.environ.items() if k not in OPENMP_WAIT}
        done = subprocess.run(
            words, capture_output=True, text=True, env=environment | chosen, timeout=600
        )
        assert done.stdout.splitlines()[-1] == expected
