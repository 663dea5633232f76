"""The bird's-eye view: against single points, a pinhole by hand, and the benchmark's own kit."""

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from roadtorch.camera.birds_eye import (
    cell_pixels,
    to_birds_eye,
)
from roadtorch.camera.calibration import Calibration, read_calibration
from tests.reference import bev as reference

HEIGHT, WIDTH = 120, 160
SHARED = Path(__file__).resolve().parents[3] / "shared/reference/kitti_vectors.json"


def write(path: Path, text: str) -> Path:
    path.write_text(text)
    return path


def pattern(height: int, width: int) -> torch.Tensor:
    """The picture of the kit's vectors: (r + 2c) mod 256."""
    return ((torch.arange(height)[:, None] + 2 * torch.arange(width)) % 256).to(torch.uint8)


@pytest.fixture
def rows() -> dict[str, np.ndarray]:
    return reference.made_up_rows()


# --- maps --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("size", "pitch"),
    [((HEIGHT, WIDTH), 0.02), ((70, 130), 0.02), ((HEIGHT, WIDTH), -0.6)],
    ids=["as usual", "near cells below the picture", "far cells above it"],
)
def test_every_cell_holds_the_pixel_its_centre_falls_on(size, pitch):
    rows = reference.made_up_rows(pitch)
    image = pattern(*size)
    cells = to_birds_eye(image, reference.calibration(rows))

    generator = np.random.default_rng(0)
    places = np.column_stack([generator.integers(0, 800, 3000), generator.integers(0, 400, 3000)])
    expected = [reference.cell_value(image.numpy(), rows, r, c) for r, c in places]

    assert cells.shape == (800, 400)
    assert cells.dtype == torch.uint8
    assert cells.numpy()[tuple(places.T)].tolist() == expected
    assert 0.02 < np.mean(np.array(expected) == 0) < 0.9


@pytest.mark.parametrize("dtype", [torch.bool, torch.uint8, torch.float32, torch.float64])
def test_any_type_and_any_leading_axes_and_zero_where_there_is_no_source(rows, dtype):
    calibration = reference.calibration(rows)
    stack = torch.rand(2, 3, HEIGHT, WIDTH).mul(9).to(dtype)
    if dtype.is_floating_point:
        stack[0, 0] = torch.nan

    cells = to_birds_eye(stack, calibration)

    _, inside = cell_pixels(calibration, HEIGHT, WIDTH)
    assert cells.dtype == dtype
    assert cells.shape == (2, 3, 800, 400)
    assert torch.equal(cells[1, 2], to_birds_eye(stack[1, 2], calibration))
    assert (cells[..., ~inside] == 0).all()
    assert cells[0, 0, inside].isnan().all() == dtype.is_floating_point


# --- calibration files -------------------------------------------------------------------


def test_a_file_is_read_whatever_else_it_holds(tmp_path, rows):
    path = write(tmp_path / "um_000000.txt", reference.calibration_text(rows))

    found, wanted = read_calibration(path), reference.calibration(rows)

    for name in ("projection", "rectification", "camera_to_road"):
        assert getattr(found, name) == pytest.approx(getattr(wanted, name), rel=1e-12, abs=1e-12)


# --- the kit's own numbers ---------------------------------------------------------------


@pytest.fixture(scope="module")
def vectors() -> dict[str, Any]:
    if not SHARED.is_file():
        pytest.skip("the benchmark's vectors are not beside the repository (../shared/reference)")
    return json.loads(SHARED.read_text())


@pytest.fixture
def calibrations(vectors, tmp_path) -> dict[str, Calibration]:
    return {
        name: read_calibration(write(tmp_path / f"{name}.txt", entry["file_text"]))
        for name, entry in vectors["calibration"].items()
    }


@pytest.mark.data
@pytest.mark.parametrize("name", ["um_000000", "uu_000093"])
def test_the_kits_whole_maps_byte_by_byte(vectors, calibrations, name):
    entry = vectors["calibration"][name]
    height, width = entry["image_height"], entry["image_width"]
    (forward,) = (case for case in vectors["warp_forward"] if case["calib"] == name)

    cells = to_birds_eye(pattern(height, width), calibrations[name])

    _, inside = cell_pixels(calibrations[name], height, width)
    assert int(inside.sum()) == forward["cells_inside"]
    digest = hashlib.sha256(cells.contiguous().numpy().tobytes()).hexdigest()
    assert digest == forward["sha256_rowmajor_uint8_800x400"]
