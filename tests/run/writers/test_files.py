"""Files of grids as map_server reads them; labels and polygons, to the pixel."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
import yaml
from hypothesis import example, given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from PIL import Image
from skimage.draw import polygon2mask

from roadtorch.base.image import read_image
from roadtorch.camera.ground_grid import Grid
from roadtorch.data.polygons import coco_annotation, coco_polygons
from roadtorch.layout.labeller import LabellerSettings, label_layout
from roadtorch.run.ledger import IndexRow
from roadtorch.run.writers.coco import coco_text
from roadtorch.run.writers.grid import write_grid
from roadtorch.testing.scenes import render_scene, write_image
from tests.command import Call

CELLS = torch.tensor([[0, 100, -1], [-1, -1, 0]], dtype=torch.int8)
GRID = Grid(CELLS, torch.zeros(2, 3), 0.25, (0.5, -1.0))


def load_map(path: Path) -> tuple[np.ndarray, dict]:
    """Load a map as nav2_map_server does in trinary mode: int8 cells (y, x), and the YAML."""
    values = yaml.safe_load(path.read_text())
    grey = cv2.imread(str(path.parent / values["image"]), cv2.IMREAD_GRAYSCALE)
    assert grey is not None
    occupancy = np.float32(1) - grey.astype(np.float32) / np.float32(255)
    cells = np.full(grey.shape, -1, np.int8)
    cells[occupancy >= values["occupied_thresh"]] = 100
    cells[occupancy <= values["free_thresh"]] = 0
    return cells[::-1], values


def test_map_server_reads_the_same_three_values(tmp_path: Path) -> None:
    write_grid(tmp_path / "it's: a #1", GRID, "pitch 2 degrees")

    cells, values = load_map(tmp_path / "it's: a #1.grid.yaml")

    assert cells.tolist() == CELLS.tolist()
    assert (values["mode"], values["resolution"], values["negate"]) == ("trinary", 0.25, 0)
    assert values["origin"] == [0.5, -1, 0]


def test_images_have_y_upwards_and_numpy_has_the_rows_from_the_right(tmp_path: Path) -> None:
    write_grid(str(tmp_path / "a"), GRID)

    image, cells = (tmp_path / "a.grid.pgm").read_bytes(), np.load(tmp_path / "a.grid.npy")

    assert image == b"P5\n3 2\n255\n" + bytes([205, 205, 254, 254, 0, 205])
    assert cells.dtype == np.int8
    assert cells.tolist() == CELLS.tolist()
    assert len(list(tmp_path.iterdir())) == 3


# --- roadtorch label --------------------------------------------------------------------


@pytest.mark.parametrize(
    ("support", "values"), [("margin", {0, 1, 2, 255}), ("maximum", {0, 1, 2})]
)
def test_labels_are_bytes(
    call: Call, tmp_path: Path, out: Path, support: str, values: set[int]
) -> None:
    street = tmp_path / "in" / "sub" / "street.png"
    write_image(street, render_scene(1, 96, 128))

    result = call("label", tmp_path / "in", "--out", out, "--set", f"support={support}")

    assert (result.exit_code, result.stderr) == (0, f"roadtorch: 1 done; results in {out}\n")
    settings = LabellerSettings.model_validate({"support": support})
    labels = label_layout(read_image(street), settings).labels
    with Image.open(out / "sub" / "street.png") as written:
        assert written.mode == "L"
        assert np.array_equal(np.asarray(written), labels.numpy())
    assert set(labels.unique().tolist()) <= values


# --- polygons ---------------------------------------------------------------------------


MASKS = arrays(bool, array_shapes(min_dims=2, max_dims=2, min_side=1, max_side=14))


NESTED = np.zeros((14, 14), bool)
"""A square with a hole, an island in it; corners that touch; a dot."""
NESTED[1:-1, 1:-1], NESTED[3:-3, 3:-3], NESTED[5:-5, 5:-5] = True, False, True
NESTED[0, 0] = NESTED[0, -2] = True


def count_polygons(polygons: list[list[int]], shape: tuple[int, int]) -> np.ndarray:
    """Count the polygons that contain each pixel's centre; pixels extend from x to x + 1."""
    total = np.zeros(shape, int)
    for polygon in polygons:
        corners = np.array(polygon).reshape(-1, 2)[:, ::-1] - 0.5
        total += polygon2mask(shape, corners)
    return total


@example(mask=NESTED)
@given(mask=MASKS)
def test_coco_polygons_are_disjoint_and_exact(mask: np.ndarray) -> None:
    assert np.array_equal(count_polygons(coco_polygons(mask), mask.shape), mask.astype(int))


def test_a_rectangle_has_four_corners() -> None:
    mask = np.zeros((6, 8), bool)
    mask[1:5, 2:7] = True

    assert coco_polygons(mask) == [[7, 1, 7, 5, 2, 5, 2, 1]]


@given(st.lists(MASKS, max_size=3))
def test_coco_files_have_an_annotation_for_each_image_with_road(masks: list[np.ndarray]) -> None:
    shapes = [map(str, reversed(mask.shape)) for mask in masks]
    images = [IndexRow(f"{at}.png", *shape, trust="0.50") for at, shape in enumerate(shapes)]

    def regions(row: IndexRow) -> list[dict[str, object]]:
        mask = masks[images.index(row)]
        return [coco_annotation(mask, 1, 1, 1)] if mask.any() else []

    document = json.loads("".join(coco_text(images, regions)))

    assert [entry["id"] for entry in document["images"]] == list(range(1, len(masks) + 1))
    areas = {entry["image_id"]: entry["area"] for entry in document["annotations"]}
    assert areas == {at: mask.sum() for at, mask in enumerate(masks, 1) if mask.any()}
    for entry in document["annotations"]:
        x, y, width, height = entry["bbox"]
        mask = masks[entry["image_id"] - 1]
        assert mask[y : y + height, x : x + width].sum() == mask.sum() == entry["area"]
