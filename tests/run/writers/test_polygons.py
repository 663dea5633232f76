"""Polygons are the mask, to the pixel, for the reader of outlines and for COCO's rules."""

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from skimage.draw import polygon2mask

from roadtorch.data.polygons import coco_polygons, labelme_document, read_outlined_mask
from roadtorch.run.writers.coco import CocoPicture, coco_text


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("labelme")


MASKS = arrays(bool, array_shapes(min_dims=2, max_dims=2, min_side=1, max_side=14))


NESTED = np.zeros((14, 14), bool)
"""A square with a hole, an island in it; corners that touch; a dot."""
NESTED[1:-1, 1:-1], NESTED[3:-3, 3:-3], NESTED[5:-5, 5:-5] = True, False, True
NESTED[0, 0] = NESTED[0, -2] = True


@settings(max_examples=40)
@example(mask=NESTED)
@given(mask=MASKS)
def test_labelme_outlines_are_exact(mask: np.ndarray, folder: Path) -> None:
    (folder / "x.json").write_text(json.dumps(labelme_document(mask, "x.png")))

    assert np.array_equal(read_outlined_mask(folder / "x.json", mask.shape), mask)


def drawn(polygons: list[list[int]], shape: tuple[int, int]) -> np.ndarray:
    """How many polygons hold each pixel's centre: pixels reach from x to x + 1."""
    total = np.zeros(shape, int)
    for polygon in polygons:
        corners = np.array(polygon).reshape(-1, 2)[:, ::-1] - 0.5
        total += polygon2mask(shape, corners)
    return total


@example(mask=NESTED)
@given(mask=MASKS)
def test_coco_polygons_are_disjoint_and_exact(mask: np.ndarray) -> None:
    assert np.array_equal(drawn(coco_polygons(mask), mask.shape), mask.astype(int))


def test_a_rectangle_has_four_corners() -> None:
    mask = np.zeros((6, 8), bool)
    mask[1:5, 2:7] = True

    assert coco_polygons(mask) == [[7, 1, 7, 5, 2, 5, 2, 1]]


@given(st.lists(MASKS, max_size=3))
def test_coco_files_have_an_annotation_for_each_picture_with_road(masks: list[np.ndarray]) -> None:
    by_file = {f"{at}.png": mask for at, mask in enumerate(masks)}
    pictures = [CocoPicture(file, mask.shape[::-1], 0.5) for file, mask in by_file.items()]

    document = json.loads("".join(coco_text(pictures, by_file.__getitem__)))

    assert [one["id"] for one in document["images"]] == list(range(1, len(masks) + 1))
    areas = {one["image_id"]: one["area"] for one in document["annotations"]}
    assert areas == {at: mask.sum() for at, mask in enumerate(masks, 1) if mask.any()}
    for one in document["annotations"]:
        left, top, width, height = one["bbox"]
        mask = masks[one["image_id"] - 1]
        assert mask[top : top + height, left : left + width].sum() == mask.sum() == one["area"]
