"""Polygons are the mask, to the pixel, for the reader of outlines and for COCO's rules."""

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from skimage.draw import polygon2mask

from roadtorch.base.errors import DatasetError
from roadtorch.data.polygons import coco_polygons, labelme_document, read_outlined_mask
from roadtorch.run.writers.coco import CocoPicture, coco_text

MASKS = arrays(bool, array_shapes(min_dims=2, max_dims=2, min_side=1, max_side=14))


def nested(size: int = 60) -> np.ndarray:
    """A square with a hole, an island in it, and a hole in that; corners that touch; a dot."""
    mask = np.zeros((size, size), bool)
    for inset in range(4):
        mask[5 * inset + 2 : -5 * inset - 2, 5 * inset + 2 : -5 * inset - 2] = inset % 2 == 0
    mask[0, 0] = mask[1, 1] = mask[0, 58] = True
    return mask


def reread(mask: np.ndarray, folder: Path) -> np.ndarray:
    (folder / "x.json").write_text(json.dumps(labelme_document(mask, "x.png")))
    return read_outlined_mask(folder / "x.json", mask.shape)


@settings(max_examples=40)
@given(mask=MASKS)
def test_labelme_outlines_are_exact(
    mask: np.ndarray, tmp_path_factory: pytest.TempPathFactory
) -> None:
    assert np.array_equal(reread(mask, tmp_path_factory.mktemp("labelme")), mask)


def test_nested_holes_and_dots_come_back(tmp_path: Path) -> None:
    mask = nested()

    labels = [one["label"] for one in labelme_document(mask, "x.png")["shapes"]]

    assert np.array_equal(reread(mask, tmp_path), mask)
    assert set(labels) == {"road", "not road"}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"imageWidth": 61}, "it is for 61 by 60 pixels"),
        ({"shapes": [{"label": "road", "points": [[1, 2], [3, 4]]}]}, "at least 3 items"),
    ],
)
def test_outlines_of_another_image_are_refused(
    change: dict[str, object], message: str, tmp_path: Path
) -> None:
    (tmp_path / "x.json").write_text(json.dumps(labelme_document(nested(), "x.png") | change))
    with pytest.raises(DatasetError, match=message):
        read_outlined_mask(tmp_path / "x.json", (60, 60))


def drawn(polygons: list[list[int]], shape: tuple[int, int]) -> np.ndarray:
    """How many polygons hold each pixel's centre: pixels reach from x to x + 1."""
    total = np.zeros(shape, int)
    for polygon in polygons:
        corners = np.array(polygon).reshape(-1, 2)[:, ::-1] - 0.5
        total += polygon2mask(shape, corners)
    return total


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
