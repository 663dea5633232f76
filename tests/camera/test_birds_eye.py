"""Bird's-eye view: against single points, a pinhole by hand, and the benchmark's own kit."""

import hashlib
import json
from pathlib import Path

import numpy as np
import pytest
import torch

from roadtorch.camera.birds_eye import cell_pixels, warp_to_birds_eye
from roadtorch.camera.calibration import read_calibration
from tests.reference import bev as reference

HEIGHT, WIDTH = 120, 160
SHARED = Path(__file__).resolve().parents[3] / "shared/reference/kitti_vectors.json"


def pattern(height: int, width: int) -> torch.Tensor:
    """Return the image of the kit's vectors: (r + 2c) mod 256."""
    return ((torch.arange(height)[:, None] + 2 * torch.arange(width)) % 256).to(torch.uint8)


# --- maps --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("size", "pitch"),
    [((HEIGHT, WIDTH), 0.02), ((70, 130), 0.02), ((HEIGHT, WIDTH), -0.6)],
    ids=["as usual", "near cells below the image", "far cells above it"],
)
def test_every_cell_holds_the_pixel_its_centre_falls_on(size, pitch):
    rows = reference.made_up_rows(pitch)
    image = pattern(*size)
    cells = warp_to_birds_eye(image, reference.calibration(rows))

    generator = np.random.default_rng(0)
    places = np.column_stack([generator.integers(0, 800, 3000), generator.integers(0, 400, 3000)])
    expected = [reference.cell_value(image.numpy(), rows, r, c) for r, c in places]

    assert cells.shape == (800, 400)
    assert cells.dtype == torch.uint8
    assert cells.numpy()[tuple(places.T)].tolist() == expected
    assert 0.02 < np.mean(np.array(expected) == 0) < 0.9


@pytest.mark.parametrize("dtype", [torch.bool, torch.uint8, torch.float32, torch.float64])
def test_any_type_and_any_leading_axes_and_zero_where_there_is_no_source(dtype):
    calibration = reference.calibration(reference.made_up_rows())
    stack = torch.rand(2, 3, HEIGHT, WIDTH).mul(9).to(dtype)
    if dtype.is_floating_point:
        stack[0, 0] = torch.nan

    cells = warp_to_birds_eye(stack, calibration)

    _, inside = cell_pixels(calibration, HEIGHT, WIDTH)
    assert cells.dtype == dtype
    assert cells.shape == (2, 3, 800, 400)
    assert torch.equal(cells[1, 2], warp_to_birds_eye(stack[1, 2], calibration))
    assert (cells[..., ~inside] == 0).all()
    assert cells[0, 0, inside].isnan().all() == dtype.is_floating_point


# --- calibration files -------------------------------------------------------------------


def test_a_file_is_read_whatever_else_it_holds(tmp_path):
    path, rows = tmp_path / "um_000000.txt", reference.made_up_rows()
    path.write_text(reference.calibration_text(rows))

    calibration, expected = read_calibration(path), reference.calibration(rows)

    for name in ("projection", "rectification", "camera_to_road"):
        values = getattr(expected, name)
        assert getattr(calibration, name) == pytest.approx(values, rel=1e-12, abs=1e-12)


# --- the kit's own numbers ---------------------------------------------------------------


@pytest.mark.data
@pytest.mark.parametrize("name", ["um_000000", "uu_000093"])
def test_the_kits_whole_maps_byte_by_byte(tmp_path, name):
    if not SHARED.is_file():
        pytest.skip("the benchmark's vectors are not beside the repository (../shared/reference)")
    vectors = json.loads(SHARED.read_text())
    entry = vectors["calibration"][name]
    (tmp_path / "kit.txt").write_text(entry["file_text"])
    calibration = read_calibration(tmp_path / "kit.txt")
    height, width = entry["image_height"], entry["image_width"]
    (forward,) = (case for case in vectors["warp_forward"] if case["calib"] == name)

    cells = warp_to_birds_eye(pattern(height, width), calibration)

    _, inside = cell_pixels(calibration, height, width)
    assert int(inside.sum()) == forward["cells_inside"]
    digest = hashlib.sha256(cells.contiguous().numpy().tobytes()).hexdigest()
    assert digest == forward["sha256_rowmajor_uint8_800x400"]
