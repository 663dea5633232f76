"""Submissions to the KITTI road benchmark, from real files to the archive."""

import zipfile
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from roadtorch.base.image import read_image
from roadtorch.detectors.catalogue import load_detector
from roadtorch.testing.scenes import render_scene, write_image
from tests.command import GREY, Call, read_index_rows
from tests.reference import bev as reference

HEIGHT, WIDTH = 120, 160
SUBMIT = ("evaluate", "--submit", "kitti-road")
MAPS = ["um_road_000000.png", "umm_road_000003.png", "uu_road_000012.png"]


@pytest.fixture
def kitti(tmp_path: Path) -> Path:
    """Return ROOT with image_2 and calib, and an image of each category."""
    root = tmp_path / "kitti"
    (root / "calib").mkdir(parents=True)
    for seed, name in enumerate(("um_000000", "umm_000003", "uu_000012")):
        write_image(root / "image_2" / f"{name}.png", render_scene(seed, HEIGHT, WIDTH))
        rows = reference.made_up_rows(pitch=0.02 + 0.01 * seed)
        (root / "calib" / f"{name}.txt").write_text(reference.calibration_text(rows))
    return root


def test_an_archive_has_each_likelihood_from_above(
    call: Call, kitti: Path, out: Path, tmp_path: Path
) -> None:
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "testing").symlink_to(kitti)  # as the benchmark's archive has it

    words = (tmp_path / "data", *GREY, "--set", "threshold=0.9", "--out", out, "--jobs", "2")
    result = call(*SUBMIT, *words)

    assert result.exit_code == 0
    assert result.stderr.splitlines() == [
        f"roadtorch: 3 done; results in {out}",
        f"roadtorch: 3 maps in {out}/submission.zip",
    ]
    assert [row["status"] for row in read_index_rows(out).values()] == ["done"] * 3
    with zipfile.ZipFile(out / "submission.zip") as archive:
        assert archive.namelist() == MAPS
        for name in MAPS:
            assert archive.read(name) == (out / name).read_bytes()
    image = read_image(kitti / "image_2/umm_000003.png")
    likelihood = load_detector("grey-uniformity").detect(image).likelihood.double().numpy()
    levels = np.round(255 * likelihood).astype(np.uint8)
    with Image.open(out / "umm_road_000003.png") as written:
        assert (written.mode, written.size) == ("L", (400, 800))
        cells = np.asarray(written)
    rows = reference.made_up_rows(pitch=0.03)
    places = [(r, c) for r in range(0, 800, 19) for c in range(0, 400, 17)]
    expected = [int(reference.cell_value(levels, rows, r, c)) for r, c in places]
    assert [int(cells[place]) for place in places] == expected
    assert len(set(expected)) > 10


def test_broken_images_are_mended_by_a_second_run(call: Call, kitti: Path, out: Path) -> None:
    image, calibration = kitti / "image_2/um_000000.png", kitti / "calib/uu_000012.txt"
    whole, text = image.read_bytes(), calibration.read_text()
    image.write_bytes(whole[:1000])
    calibration.unlink()

    result = call(*SUBMIT, kitti, *GREY, "--out", out)

    assert result.exit_code == 1
    assert "um_000000.png: cannot be decoded" in result.stderr
    assert "calib/uu_000012.txt: cannot be read" in result.stderr
    assert result.stderr.splitlines()[-1].endswith("submission.zip not written: maps are missing")
    assert [path.name for path in out.iterdir() if path.suffix in (".png", ".zip")] == MAPS[1:2]
    assert read_index_rows(out)["uu_road_000012.png"]["status"].startswith("failed: ")

    image.write_bytes(whole)
    calibration.write_text(text)
    again = call(*SUBMIT, kitti, *GREY, "--out", out)

    assert again.exit_code == 0
    assert again.stderr.startswith("roadtorch: 2 done, 1 skipped (done before)")
    assert (out / "submission.zip").is_file()
