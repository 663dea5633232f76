"""The benchmark of sources: every source gives the same pictures, and it prints their speeds."""

import subprocess
import sys
from pathlib import Path

import torch

from roadtorch.image import read_image, write_colours
from roadtorch.scenes import render_scene
from roadtorch.sources.pictures import find_images
from scripts import bench_sources


def test_every_source_gives_the_same_pictures(tmp_path: Path) -> None:
    write_colours(tmp_path / "scene.png", render_scene(1, 48, 64).image)
    pictures = find_images([tmp_path])
    (tmp_path / "out").mkdir()
    for source in bench_sources.write_sources(pictures, tmp_path / "out").values():
        (frame,) = source.frames()
        assert torch.equal(frame.read(), read_image(pictures[0].path))


def test_it_prints_speeds_and_sizes(tmp_path: Path) -> None:
    for seed in range(2):
        write_colours(tmp_path / f"{seed}.png", render_scene(seed, 48, 64).image)
    words = [sys.executable, bench_sources.__file__, "--images", str(tmp_path), "--rounds", "1"]
    words += ["--detector", "prior:rows", "--keep", str(tmp_path / "bags")]
    done = subprocess.run(words, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    assert "a.zip" in done.stdout
    assert "masks and overlays" in done.stdout
    assert (tmp_path / "bags" / "masks" / "metadata.yaml").is_file()
