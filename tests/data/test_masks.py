"""Masks as people have them: pairs, sizes, values, COCO."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from roadtorch.base.errors import DatasetError
from roadtorch.data.masks import read_masks
from tests.command import save_image

SIZE = (6, 8)
ROAD, NOT_ROAD, VOID = 1, 2, 3


def halves(upper: int, lower: int) -> np.ndarray:
    """Return a mask with one value above the middle and another one below."""
    return np.repeat(np.array([upper, lower], np.uint8), 3)[:, None].repeat(8, 1)


@pytest.fixture
def images(tmp_path: Path) -> dict[str, Path]:
    """Make two images, one of them in a folder."""
    names = ("a.jpg", "drive/b.png")
    return {name: save_image(tmp_path / "images" / name, size=(8, 6)) for name in names}


def write(folder: Path, **masks: np.ndarray) -> Path:
    """Write masks by the stem of their files, a ``__`` being a folder."""
    for name, mask in masks.items():
        path = folder / f"{name.replace('__', '/')}.png"
        path.parent.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(path), mask)
    return folder


@pytest.mark.parametrize(
    ("upper", "lower", "road", "void", "labels"),
    [
        (0, 1, (), (), (NOT_ROAD, ROAD)),
        (0, 255, (), (), (NOT_ROAD, ROAD)),
        (127, 255, (), (), (VOID, ROAD)),
        (255, 1, (), ("255",), (VOID, ROAD)),
        (255, 1, ("1",), (), (NOT_ROAD, ROAD)),  # named values replace all that are known
        (7, 0, ("0", "7"), (), (ROAD, ROAD)),
        (1, 3, ("3",), ("1",), (VOID, ROAD)),
    ],
)
def test_values_are_road_void_or_neither(
    upper: int,
    lower: int,
    road: tuple[str, ...],
    void: tuple[str, ...],
    labels: tuple[int, int],
    images: dict[str, Path],
    tmp_path: Path,
) -> None:
    folder = write(tmp_path / "masks", a=halves(upper, lower))

    ((mask,), _) = read_masks(folder, images, road, void)

    assert mask.image == images["a.jpg"]
    assert mask.labels.dtype == np.uint8
    assert np.array_equal(mask.labels, halves(*labels))


def test_masks_are_paired_by_name_and_the_summary_reports_what_is_road(
    images: dict[str, Path], tmp_path: Path
) -> None:
    mask = halves(0, 255)
    mask[0] = 127
    folder = write(tmp_path / "masks", a_mask=halves(0, 255), drive__b=mask, other=mask)

    masks, summary = read_masks(folder, images)

    assert [entry.image for entry in masks] == list(images.values())
    assert summary == (
        "2 of 2 images have a mask; road is 255 (50.0 %); not road is 0 (41.7 %); "
        "void is 127 (8.3 %)"
    )


@pytest.mark.parametrize(
    ("masks", "road", "message"),
    [
        ({"a": halves(0, 3)}, (), r"unknown meaning, such as 3: 0 \(50.0 %\), 3 \(50.0 %\)"),
        ({"a": halves(0, 3)}, ("4",), "has no value 4, but 0"),
        ({"a": halves(0, 0)}, (), r"has no road, but 0 \(100.0 %\)"),
        ({"a": halves(0, 1), "drive__b": halves(0, 255)}, (), "has both 1 and 255"),
        ({"a": halves(0, 1), "a_mask": halves(0, 1)}, (), "are masks of a.jpg"),
        ({"c": halves(0, 1)}, (), "has a mask for none of 2 images"),
        ({"a": halves(0, 1)[:5]}, (), "has 8 by 5 pixels"),
    ],
)
def test_masks_that_cannot_be_meant_are_refused(
    masks: dict[str, np.ndarray],
    road: tuple[str, ...],
    message: str,
    images: dict[str, Path],
    tmp_path: Path,
) -> None:
    with pytest.raises(DatasetError, match=message):
        read_masks(write(tmp_path / "masks", **masks), images, road)


def coco(path: Path, segmentation: object = (0, 3, 8, 3, 8, 6, 0, 6)) -> Path:
    """Write regions of a road, and of a car in its first column, of a.jpg."""
    areas = [[segmentation], [[0, 3, 1, 3, 1, 6, 0, 6]]]
    document = {
        "images": [{"id": 4, "file_name": "x/a.jpg", "width": 8, "height": 6}],
        "categories": [{"id": 9, "name": "street"}, {"id": 2, "name": "car"}],
        "annotations": [
            {"id": number, "image_id": 4, "category_id": (9, 2)[number], "segmentation": area}
            for number, area in enumerate(areas)
        ],
    }
    path.write_text(json.dumps(document))
    return path


def test_regions_of_coco_cover_one_another(images: dict[str, Path], tmp_path: Path) -> None:
    path, expected = coco(tmp_path / "coco.json"), halves(NOT_ROAD, ROAD)
    expected[3:, 0] = VOID

    ((mask,), summary) = read_masks(path, images, ("street",), ("car",))

    assert np.array_equal(mask.labels, expected)
    assert summary.endswith(
        "road is street (43.8 %); not road is no region (50.0 %); void is car (6.2 %)"
    )
    for road, message in (((), "has no road, but no region"), (("0",), "has no value 0")):
        with pytest.raises(DatasetError, match=message):
            read_masks(path, images, road)
    with pytest.raises(DatasetError, match="an odd number"):
        read_masks(coco(path, (0, 3, 8, 3, 8, 6, 0)), images, ("street",))
