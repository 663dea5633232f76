"""Masks as people have them: pairs, sizes, values, COCO."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from roadtorch.base.errors import ConfigError, DatasetError
from roadtorch.data.masks import read_masks
from tests.command import save_image
from tests.data.conftest import write as write_file

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


def picture(upper: int, lower: int, mode: str = "L", palette: tuple[int, ...] = ()) -> Image.Image:
    """Return an image of two levels, or of two indices of a palette."""
    image = Image.fromarray(halves(upper, lower))
    if palette:
        image.putpalette(palette)
    return image if palette else image.convert(mode)


BLACK, WHITE, GREY, RED = (0, 0, 0), (255, 255, 255), (70, 70, 70), (255, 0, 0)
TURNED = Image.Exif()
TURNED[0x0112] = 3  # EXIF orientation: upside down
PAINTED = Image.fromarray(np.where(halves(0, 1)[..., None], RED, 0).astype(np.uint8))
PALETTES = "different palettes"


@pytest.mark.parametrize(
    ("first", "second", "suffix", "road", "expected"),
    [
        (picture(1, 0, palette=WHITE + BLACK), None, "png", (), (NOT_ROAD, ROAD)),
        (picture(0, 1, palette=BLACK + RED), None, "png", (), (NOT_ROAD, ROAD)),
        (picture(1, 0, palette=RED + BLACK), None, "png", (), "first colour is not black.*road 0"),
        (picture(1, 0, palette=RED + BLACK), None, "png", ("0",), (NOT_ROAD, ROAD)),
        (picture(0, 1, palette=BLACK + GREY + RED), picture(0, 2, palette=BLACK + GREY + RED),
         "png", ("1",), (NOT_ROAD, ROAD)),
        (picture(0, 1, palette=BLACK + RED), picture(1, 0, palette=RED + BLACK), "png", ("1",),
         PALETTES),
        (picture(0, 255, "RGB"), None, "png", (), (NOT_ROAD, ROAD)),
        (picture(0, 255, "RGBA"), None, "png", (), (NOT_ROAD, ROAD)),
        (PAINTED, None, "png", (), "unknown meaning, such as #ff0000.*road '#ff0000'"),
        (PAINTED, None, "png", ("#ff0000",), (NOT_ROAD, ROAD)),
        (Image.merge("LA", [picture(0, 255)] * 2), None, "png", (), "has transparent pixels"),
        (picture(0, 1, "F"), None, "tif", (), "holds floating-point numbers"),
        (picture(0, 7, "I"), None, "tif", ("7",), (NOT_ROAD, ROAD)),
        (picture(0, 7), None, "jpg", (), "is a JPEG with levels up to 7"),
        (PAINTED, None, "jpg", (), "is a JPEG in colour"),
    ],
)  # fmt: skip
def test_a_mask_is_read_by_what_its_file_states_or_refused(
    first: Image.Image,
    second: Image.Image | None,
    suffix: str,
    road: tuple[str, ...],
    expected: tuple[int, int] | str,
    images: dict[str, Path],
    tmp_path: Path,
) -> None:
    folder = tmp_path / "masks"
    write_file(folder / f"a.{suffix}", first)
    if second:
        write_file(folder / f"drive/b.{suffix}", second)

    if isinstance(expected, str):
        with pytest.raises(DatasetError, match=expected):
            read_masks(folder, images, road)
    else:
        masks, _ = read_masks(folder, images, road)
        assert np.array_equal(masks[0].labels, halves(*expected))


def test_masks_are_upright_and_jpeg_is_told(images: dict[str, Path], tmp_path: Path) -> None:
    (tmp_path / "masks/drive").mkdir(parents=True)
    picture(255, 0).save(tmp_path / "masks/a.png", exif=TURNED)
    picture(0, 255).save(tmp_path / "masks/drive/b.jpg")

    with pytest.warns(UserWarning, match="1 masks are JPEG"):
        masks, _ = read_masks(tmp_path / "masks", images)

    assert [np.array_equal(mask.labels, halves(NOT_ROAD, ROAD)) for mask in masks] == [True, True]


def test_a_mask_that_cannot_be_read_fails_alone(images: dict[str, Path], tmp_path: Path) -> None:
    folder = write(tmp_path / "masks", a=halves(0, 1), drive__b=halves(0, 1))
    (folder / "a.png").write_bytes((folder / "a.png").read_bytes()[:50])

    (cut, whole), _ = read_masks(folder, images)

    assert np.array_equal(whole.labels, halves(NOT_ROAD, ROAD))
    with pytest.raises(DatasetError, match=r"a\.png: cannot be decoded"):
        _ = cut.labels


def test_a_value_is_road_or_void(images: dict[str, Path], tmp_path: Path) -> None:
    folder = write(tmp_path / "masks", a=halves(0, 255))

    with pytest.raises(ConfigError, match="--void: 255 is also --road"):
        read_masks(folder, images, ("255",), ("255",))


def coco(path: Path, segmentation: object = (0, 3, 8, 3, 8, 6, 0, 6)) -> Path:
    """Write regions of a road, and of a car in its first column, of a.jpg; b.png has none."""
    areas = [[segmentation], [[0, 3, 1, 3, 1, 6, 0, 6]]]
    document = {
        "images": [
            {"id": number, "file_name": name, "width": 8, "height": 6}
            for number, name in ((4, "x/a.jpg"), (5, "drive/b.png"))
        ],
        "categories": [{"id": 9, "name": "street"}, {"id": 2, "name": "car"}],
        "annotations": [
            {"id": number, "image_id": 4, "category_id": (9, 2)[number], "segmentation": area}
            for number, area in enumerate(areas)
        ],
    }
    path.write_text(json.dumps(document))
    return path


def test_regions_of_coco_cover_one_another_and_no_region_is_no_mask(
    images: dict[str, Path], tmp_path: Path
) -> None:
    path, expected = coco(tmp_path / "coco.json"), halves(NOT_ROAD, ROAD)
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
    with pytest.raises(DatasetError, match="an odd number"):
        read_masks(coco(path, (0, 3, 8, 3, 8, 6, 0)), images, ("street",))
