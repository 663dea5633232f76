"""The benchmark of sources: every source gives the same pictures, and it prints their speeds."""

from pathlib import Path

import torch

from roadtorch.io.image import read_image, write_colours
from roadtorch.scenes.street import render_scene
from roadtorch.sources.pictures import find_images
from scripts import bench_sources
from tests.scripts.conftest import PrintedBy


def test_every_source_gives_the_same_pictures(tmp_path: Path) -> None:
    write_colours(tmp_path / "scene.png", render_scene(1, 48, 64).image)
    pictures = find_images([tmp_path])
    (tmp_path / "out").mkdir()
    for source in bench_sources.write_sources(pictures, tmp_path / "out").values():
        (frame,) = source.frames()
        assert torch.equal(frame.read(), read_image(pictures[0].path))


def test_it_prints_speeds_and_sizes(tmp_path: Path, printed_by: PrintedBy) -> None:
    for seed in range(2):
        write_colours(tmp_path / f"{seed}.png", render_scene(seed, 48, 64).image)
    words = ["--images", tmp_path, "--rounds", "1", "--detector", "prior:rows"]

    printed = printed_by(bench_sources, *words, "--keep", tmp_path / "bags")

    assert "a.zip" in printed
    assert "masks and overlays" in printed
    assert (tmp_path / "bags" / "masks" / "metadata.yaml").is_file()
