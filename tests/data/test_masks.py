"""Masks as people have them: pairs, sizes, values, COCO."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from roadtorch.base.errors import ConfigError, DatasetError
from roadtorch.data.masks import read_masks
from tests.command import save_image
from tests.data.conftest import write

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


def picture(upper: int, lower: int, mode: str = "L", palette: tuple[int, ...] = ()) -> Image.Image:
    """Return an image of two levels, or of two indices of a palette."""
    image = Image.fromarray(halves(upper, lower))
    if palette:
        image.putpalette(palette)
    return image if palette else image.convert(mode)


BLACK, WHITE, GREY, RED = (0, 0, 0), (255, 255, 255), (70, 70, 70), (255, 0, 0)
PAINTED = Image.fromarray(np.where(halves(0, 1)[..., None], RED, 0).astype(np.uint8))
HIDDEN = picture(1, 0, palette=WHITE + BLACK)
HIDDEN.info["transparency"] = 0
BOTH = {"a.png": picture(0, 1), "drive/b.png": picture(0, 255)}
THREE = {"a.png": picture(0, 1, palette=BLACK + GREY + RED),
         "drive/b.png": picture(0, 2, palette=BLACK + GREY + RED)}  # fmt: skip
SWAPPED = {"a.png": picture(0, 1, palette=BLACK + RED),
           "drive/b.png": picture(1, 0, palette=RED + BLACK)}  # fmt: skip


@pytest.mark.parametrize(
    ("mask", "road", "void", "labels"),
    [
        (picture(0, 1), (), (), (NOT_ROAD, ROAD)),
        (picture(0, 255), (), (), (NOT_ROAD, ROAD)),
        (picture(127, 255), (), (), (VOID, ROAD)),
        (picture(255, 1), (), ("255",), (VOID, ROAD)),
        (picture(255, 1), ("1",), (), (NOT_ROAD, ROAD)),  # named values replace all that are known
        (picture(7, 0), ("0", "7"), (), (ROAD, ROAD)),
        (picture(1, 3), ("3",), ("1",), (VOID, ROAD)),
        (picture(0, 255, "1"), (), (), (NOT_ROAD, ROAD)),
        (picture(0, 255, "RGB"), (), (), (NOT_ROAD, ROAD)),
        (picture(0, 255, "RGBA"), (), (), (NOT_ROAD, ROAD)),
        (PAINTED, ("#ff0000",), (), (NOT_ROAD, ROAD)),
        (picture(1, 0, palette=WHITE + BLACK), (), (), (NOT_ROAD, ROAD)),
        (picture(0, 1, palette=BLACK + RED), (), (), (NOT_ROAD, ROAD)),
        (picture(1, 0, palette=RED + BLACK), ("0",), (), (NOT_ROAD, ROAD)),
        (THREE, ("1",), (), (NOT_ROAD, ROAD)),
        ({"a.tif": picture(0, 7, "I")}, ("7",), (), (NOT_ROAD, ROAD)),
    ],
)
def test_values_are_road_void_or_neither(mask, road, void, labels, images, tmp_path):
    for name, content in (mask if isinstance(mask, dict) else {"a.png": mask}).items():
        write(tmp_path / "masks" / name, content)

    masks, _ = read_masks(tmp_path / "masks", images, road, void)

    assert masks[0].image == images["a.jpg"]
    assert masks[0].labels.dtype == np.uint8
    assert np.array_equal(masks[0].labels, halves(*labels))


@pytest.mark.parametrize(
    ("files", "road", "message"),
    [
        ({"a.png": picture(0, 3)}, (), r"unknown meaning, such as 3: 0 \(50.0 %\), 3 \(50.0 %\)"),
        ({"a.png": picture(0, 3)}, ("4",), "has no value 4, but 0"),
        ({"a.png": picture(0, 0)}, (), r"has no road, but 0 \(100.0 %\)"),
        (BOTH, (), "has both 1 and 255"),
        ({"a.png": picture(0, 1), "a_mask.png": picture(0, 1)}, (), "are masks of a.jpg"),
        ({"c.png": picture(0, 1)}, (), "has a mask for none of 2 images"),
        ({"a.png": halves(0, 1)[:5]}, (), "has 8 by 5 pixels"),
        ({"a.png": picture(1, 0, palette=RED + BLACK)}, (), "first colour is not black.*road 0"),
        (SWAPPED, ("1",), "different palettes"),
        ({"a.png": PAINTED}, (), "unknown meaning, such as #ff0000.*road '#ff0000'"),
        ({"a.png": Image.merge("LA", [picture(0, 255)] * 2)}, (), "has transparent pixels"),
        ({"a.png": HIDDEN}, (), "has transparent pixels"),
        ({"a.tif": picture(0, 1, "F")}, (), "holds floating-point numbers"),
        ({"a.jpg": picture(0, 7)}, (), "is a JPEG with levels up to 7"),
        ({"a.jpg": PAINTED}, (), "is a JPEG in colour"),
    ],
)
def test_masks_that_cannot_be_meant_are_refused(files, road, message, images, tmp_path):
    for name, content in files.items():
        write(tmp_path / "masks" / name, content)

    with pytest.raises(DatasetError, match=message):
        read_masks(tmp_path / "masks", images, road)


def test_masks_are_paired_by_name_and_the_summary_reports_what_is_road(
    images: dict[str, Path], tmp_path: Path
) -> None:
    mask = halves(0, 255)
    mask[0] = 127
    for name, values in {"a_mask": halves(0, 255), "drive/b": mask, "other": mask}.items():
        write(tmp_path / f"masks/{name}.png", values)

    masks, summary = read_masks(tmp_path / "masks", images)

    assert [entry.image for entry in masks] == list(images.values())
    assert summary == (
        "2 of 2 images have a mask; road is 255 (50.0 %); not road is 0 (41.7 %); "
        "void is 127 (8.3 %)"
    )


def test_masks_are_upright_and_jpeg_is_told(images: dict[str, Path], tmp_path: Path) -> None:
    write(tmp_path / "masks/drive/b.jpg", picture(0, 255))
    exif = Image.Exif()
    exif[0x0112] = 3  # EXIF orientation: upside down
    picture(255, 0).save(tmp_path / "masks/a.png", exif=exif)

    with pytest.warns(UserWarning, match="1 masks are JPEG"):
        masks, _ = read_masks(tmp_path / "masks", images)

    assert [np.array_equal(mask.labels, halves(NOT_ROAD, ROAD)) for mask in masks] == [True, True]


def test_a_mask_that_cannot_be_read_fails_alone(images: dict[str, Path], tmp_path: Path) -> None:
    whole_mask = write(tmp_path / "masks/drive/b.png", halves(0, 1))
    write(tmp_path / "masks/a.png", whole_mask.read_bytes()[:50])

    (cut, whole), _ = read_masks(tmp_path / "masks", images)

    assert np.array_equal(whole.labels, halves(NOT_ROAD, ROAD))
    with pytest.raises(DatasetError, match=r"a\.png: cannot be decoded"):
        _ = cut.labels


def test_a_value_is_road_or_void(images: dict[str, Path], tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="--void: 255 is also --road"):
        read_masks(tmp_path, images, ("255",), ("255",))


def test_regions_of_coco_cover_one_another_and_no_region_is_no_mask(
    images: dict[str, Path], tmp_path: Path
) -> None:
    document = {
        "images": [
            {"id": number, "file_name": name, "width": 8, "height": 6}
            for number, name in ((4, "x/a.jpg"), (5, "drive/b.png"))
        ],
        "categories": [{"id": 9, "name": "street"}, {"id": 2, "name": "car"}],
        "annotations": [
            {"image_id": 4, "category_id": category, "segmentation": [[0, 3, x, 3, x, 6, 0, 6]]}
            for category, x in ((9, 8), (2, 1))
        ],
    }
    path, expected = write(tmp_path / "coco.json", json.dumps(document)), halves(NOT_ROAD, ROAD)
    expected[3:, 0] = VOID

    ((mask,), summary) = read_masks(path, images, ("street",), ("car",))

    assert np.array_equal(mask.labels, expected)
    assert mask.image == images["a.jpg"]
    assert summary == (
        "1 of 2 images have a mask, none for drive/b.png; road is street (43.8 %); "
        "not road is no region (50.0 %); void is car (6.2 %)"
    )
    for road, message in (((), "has no road, but no region"), (("0",), "has no value 0")):
        with pytest.raises(DatasetError, match=message):
            read_masks(path, images, road)
