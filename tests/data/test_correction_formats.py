"""Export and import of corrections without loss."""

import codecs
import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from roadtorch.base.errors import DatasetError
from roadtorch.data.catalogue import open_dataset
from roadtorch.data.correction_formats import CORRECTION_FORMATS, match_image_name, unpack_counts
from roadtorch.data.corrections import Correction
from roadtorch.data.events import LABEL_NAMES, layout_layer
from tests.data.conftest import write

SIZE = (19, 27)


def noise(seed: int) -> np.ndarray:
    """Return a random label for each pixel: the worst case for polygons."""
    return np.random.default_rng(seed).integers(0, len(LABEL_NAMES), SIZE).astype(np.uint8)


def nested(seed: int) -> np.ndarray:
    """Draw overlapping rings and discs: holes, holes in holes, several parts."""
    generator = np.random.default_rng(seed)
    labels = np.zeros(SIZE, np.uint8)
    for _ in range(14):
        centre = (int(generator.integers(SIZE[1])), int(generator.integers(SIZE[0])))
        radius, thickness = int(generator.integers(1, 9)), int(generator.choice([-1, 1, 3]))
        cv2.circle(labels, centre, radius, int(generator.integers(len(LABEL_NAMES))), thickness)
    return labels


def correction(labels: np.ndarray, name: str = "sub/a.jpg") -> Correction:
    return Correction(Path(name), name, labels, False, 1.0, 1, Path("log"))


CASES = {
    "noise": noise(0),
    "nested": nested(1),
    "nested more": nested(2),
    "nothing": np.zeros(SIZE, np.uint8),
    "all road": np.ones(SIZE, np.uint8),
    "all labels": np.tile(np.arange(8, dtype=np.uint8), (8, 1)),
    "large": np.repeat(np.arange(8, dtype=np.uint8), 2_000).reshape(100, 160),
    "a pixel": np.eye(1, 300, 7, dtype=np.uint8).reshape(15, 20),
    "diagonal": np.eye(20, dtype=np.uint8) * 2,
}


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("name", CORRECTION_FORMATS)
def test_labels_come_back_pixel_by_pixel(name: str, case: str, tmp_path: Path) -> None:
    labels = CASES[case]
    CORRECTION_FORMATS[name].write([correction(labels)], tmp_path)
    shape = (labels.shape[0], labels.shape[1])
    by_image = CORRECTION_FORMATS[name].read(tmp_path, {"sub/a.jpg": shape, "b.jpg": (5, 5)})
    assert by_image.keys() == {"sub/a.jpg"}
    assert (by_image["sub/a.jpg"] == labels).all()


def test_two_images_that_would_have_one_file_are_refused(tmp_path: Path) -> None:
    pair, labels = ["sub/a.jpg", "sub/a.png"], np.ones(SIZE, np.uint8)
    with pytest.raises(DatasetError, match=r"sub/a\.jpg and sub/a\.png: have one file, sub/a, in"):
        CORRECTION_FORMATS["png"].write([correction(labels, image) for image in pair], tmp_path)
    assert not list(tmp_path.rglob("a.*"))
    CORRECTION_FORMATS["png"].write([correction(labels, pair[0])], tmp_path)
    with pytest.raises(DatasetError, match="have one file"):
        CORRECTION_FORMATS["png"].read(tmp_path, dict.fromkeys(pair, SIZE))


def test_a_set_of_ones_own_reads_the_files_and_untouched_is_void(tmp_path: Path) -> None:
    labels = nested(4)
    write(tmp_path / "images/a.png", np.zeros((*SIZE, 3), np.uint8))
    CORRECTION_FORMATS["png"].write([correction(labels, "a.png")], tmp_path)
    dataset = open_dataset("folder", tmp_path)
    truth = dataset.truth(dataset.items[0])
    silent = [LABEL_NAMES.index(label) for label in ("untouched", "void", "horizontal")]
    assert (truth.valid.numpy() == ~np.isin(labels, silent)).all()
    assert (truth.road.numpy() == (labels == LABEL_NAMES.index("road"))).all()
    assert truth.layout is not None
    assert (truth.layout.numpy() == layout_layer(labels)).all()


# --- COCO -------------------------------------------------------------------------------


def coco(folder: Path, *segmentations: object) -> np.ndarray:
    """Return the labels (2, 4) of a COCO file with regions of road, sky, road, … of one id."""
    path = folder / "instances_default.json"
    regions = [
        {"id": 3, "image_id": 5, "category_id": 1 + number % 2, "segmentation": segmentation}
        for number, segmentation in enumerate(segmentations)
    ]
    images = [{"id": 5, "file_name": "images/1f2e3d4c-a.jpg", "width": 4, "height": 2}]
    images.append({"id": 6, "file_name": "elsewhere.jpg", "width": 9, "height": 9})
    categories = [{"id": 1, "name": "road"}, {"id": 2, "name": "sky"}]
    document = {"images": images, "categories": categories, "annotations": regions}
    path.write_text(json.dumps(document | {"licenses": [], "info": {}}))
    labels = CORRECTION_FORMATS["coco"].read(path, {"sub/a.jpg": (2, 4), "b.jpg": (9, 9)})
    return labels["sub/a.jpg"]


@pytest.mark.parametrize(
    ("segmentations", "expected"),
    [
        ([], [[0, 0, 0, 0], [0, 0, 0, 0]]),
        ([[[1, 0, 3, 0, 3, 1, 1, 1]]], [[0, 1, 1, 0], [0, 0, 0, 0]]),
        ([[[0.6, 0, 1.6, 0, 1.6, 9, 0.6, 9]]], [[0, 1, 0, 0], [0, 1, 0, 0]]),  # centres inside
        ([[[0, 0, 1, 0, 1, 2, 0, 2], [0, 0, 2, 0, 2, 1, 0, 1]]], [[1, 1, 0, 0], [1, 0, 0, 0]]),
        ([{"counts": [1, 2, 5], "size": [2, 4]}], [[0, 1, 0, 0], [1, 0, 0, 0]]),  # by columns
        ([{"counts": "125", "size": [2, 4]}], [[0, 1, 0, 0], [1, 0, 0, 0]]),  # [1, 2, 5] packed
        ([{"counts": [0, 8]}, [[1, 0, 2, 0, 2, 2, 1, 2]]], [[1, 4, 1, 1], [1, 4, 1, 1]]),
    ],
    ids=["none", "polygon", "between pixels", "two unite", "counts", "packed", "later cover"],
)
def test_regions_of_others(
    tmp_path: Path, segmentations: list[object], expected: list[list[int]]
) -> None:
    assert coco(tmp_path, *segmentations).tolist() == expected


@settings(max_examples=50)
@given(st.lists(st.integers(0, 2**31 - 1), max_size=9))
def test_packed_counts_are_read_as_pycocotools_writes_them(counts: list[int]) -> None:
    text = ""
    for number, count in enumerate(counts):  # rleToString of its maskApi.c
        value, more = count - (counts[number - 2] if number > 2 else 0), True
        while more:
            bits, value = value & 31, value >> 5
            more = value != (-1 if bits & 16 else 0)
            text += chr(bits + 32 * more + 48)

    assert unpack_counts(text) == counts


def test_documents_may_begin_with_a_byte_order_mark(tmp_path: Path) -> None:
    labels = nested(3)
    CORRECTION_FORMATS["coco"].write([correction(labels, "a.jpg")], tmp_path)
    file = tmp_path / "coco.json"
    file.write_bytes(codecs.BOM_UTF8 + file.read_bytes())

    assert (CORRECTION_FORMATS["coco"].read(file, {"a.jpg": SIZE})["a.jpg"] == labels).all()


def test_a_coco_file_has_what_its_readers_ask_for(tmp_path: Path) -> None:
    labels = np.zeros(SIZE, np.uint8)
    labels[3:9, 4:14] = LABEL_NAMES.index("sky")
    labels[5:7, 6:8] = 0  # a hole
    CORRECTION_FORMATS["coco"].write([correction(labels)], tmp_path)
    document = json.loads((tmp_path / "coco.json").read_text())
    (region,) = document["annotations"]
    assert [category["name"] for category in document["categories"]] == list(LABEL_NAMES[1:])
    assert document["images"] == [{"id": 1, "file_name": "sub/a.jpg", "width": 27, "height": 19}]
    assert (region["id"], region["image_id"], region["category_id"]) == (1, 1, 4)
    assert (region["area"], region["bbox"], region["iscrowd"]) == (56, [4, 3, 10, 6], 0)


@pytest.mark.parametrize(
    ("file", "names", "expected"),
    [
        ("11.jpg", ["1.jpg"], None),
        ("x1.jpg", ["1.jpg"], None),
        ("drive/11.jpg", ["1.jpg", "drive/11.jpg"], "drive/11.jpg"),
        ("data/sub/a b.jpg", ["a b.jpg", "sub/a b.jpg"], "sub/a b.jpg"),
        ("images\\1.jpg", ["1.jpg"], "1.jpg"),
        ("images/1f2e3d4c-1.jpg", ["1.jpg", "11.jpg"], "1.jpg"),
        ("/data/upload/3/1f2e3d4c-1.jpg", ["sub/1.jpg"], "sub/1.jpg"),
        ("1f2e3d4c-1.jpg", ["1f2e3d4c-1.jpg", "1.jpg"], "1f2e3d4c-1.jpg"),
        ("", ["1.jpg"], None),
        ("images/u\u0308.jpg", ["ü.jpg"], "ü.jpg"),
        ("ü.jpg", ["u\u0308.jpg", "u.jpg"], "u\u0308.jpg"),
    ],
)
def test_the_image_of_a_whole_name(file: str, names: list[str], expected: str | None) -> None:
    assert match_image_name(file, names) == expected


def test_an_upload_of_two_images_of_one_name_is_refused() -> None:
    with pytest.raises(ValueError, match=r"1\.jpg could be a/1\.jpg or b/1\.jpg"):
        match_image_name("images/1f2e3d4c-1.jpg", ["b/1.jpg", "a/1.jpg"])
