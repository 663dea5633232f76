"""Corrections out to other programs and in again without loss."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from roadtorch.data.catalogue import open_dataset
from roadtorch.data.correction_formats import FORMATS
from roadtorch.data.correction_labels import LABELS
from roadtorch.data.corrections import Correction
from roadtorch.data.cvat import object_colours, voc_colour
from roadtorch.data.label_studio import _picture_of, packed_mask, unpacked_mask
from roadtorch.errors import DatasetError
from tests.data.conftest import write_png

SIZE = (37, 53)


def noise(seed: int) -> np.ndarray:
    """Every pixel its own label: the worst for polygons."""
    return np.random.default_rng(seed).integers(0, len(LABELS), SIZE).astype(np.uint8)


def nested(seed: int) -> np.ndarray:
    """Rings and discs one over the other: holes, holes in holes, several parts."""
    generator = np.random.default_rng(seed)
    labels = np.zeros(SIZE, np.uint8)
    for _ in range(14):
        centre = (int(generator.integers(SIZE[1])), int(generator.integers(SIZE[0])))
        radius, thickness = int(generator.integers(1, 14)), int(generator.choice([-1, 1, 3]))
        cv2.circle(labels, centre, radius, int(generator.integers(len(LABELS))), thickness)
    return labels


def correction(labels: np.ndarray, name: str = "sub/a.jpg") -> Correction:
    return Correction(Path(name), name, labels, False, ("ann",), 1.0, 1)


CASES = {
    "noise": noise(0),
    "nested": nested(1),
    "nested more": nested(2),
    "nothing": np.zeros(SIZE, np.uint8),
    "all road": np.ones(SIZE, np.uint8),
    "all labels": np.tile(np.arange(8, dtype=np.uint8), (8, 1)),
    "long runs": np.repeat(np.arange(8, dtype=np.uint8), 20_000).reshape(400, 400),
    "a pixel": np.eye(1, 300, 7, dtype=np.uint8).reshape(15, 20),
    "diagonal": np.eye(20, dtype=np.uint8) * 2,
}


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("name", FORMATS)
def test_labels_come_back_pixel_by_pixel(name: str, case: str, tmp_path: Path) -> None:
    labels = CASES[case]
    FORMATS[name].write([correction(labels)], tmp_path)
    shape = (labels.shape[0], labels.shape[1])
    found = FORMATS[name].read(tmp_path, {"sub/a.jpg": shape, "b.jpg": (5, 5)})
    assert found.keys() == {"sub/a.jpg"}
    assert (found["sub/a.jpg"] == labels).all()


@pytest.mark.parametrize("name", sorted(FORMATS.keys() - {"label-studio"}))
def test_two_pictures_that_would_have_one_file_are_refused(name: str, tmp_path: Path) -> None:
    pair = ["sub/a.jpg", "sub/a.png"]
    with pytest.raises(DatasetError, match=r"sub/a\.jpg and sub/a\.png: have one file, sub/a, in"):
        FORMATS[name].write([correction(noise(0), one) for one in pair], tmp_path)
    assert not list(tmp_path.rglob("a.*"))
    FORMATS[name].write([correction(noise(0), pair[0])], tmp_path)
    with pytest.raises(DatasetError, match="have one file"):
        FORMATS[name].read(tmp_path, dict.fromkeys(pair, noise(0).shape))


@pytest.mark.parametrize("name", FORMATS)
def test_labels_of_another_size_are_refused(name: str, tmp_path: Path) -> None:
    FORMATS[name].write([correction(nested(3))], tmp_path)
    with pytest.raises(DatasetError, match="53 by 37"):
        FORMATS[name].read(tmp_path, {"sub/a.jpg": (37, 54)})


@pytest.mark.parametrize("name", ["labelme", "xml", "png", "cvat"])
def test_a_folder_without_labels_is_told(name: str, tmp_path: Path) -> None:
    (tmp_path / "labelmap.txt").write_text("road:1,2,3::\n")
    with pytest.raises(DatasetError, match="has no file for any of the pictures"):
        FORMATS[name].read(tmp_path, {"a.jpg": SIZE})


@pytest.mark.parametrize(
    ("name", "kind", "place"),
    [("xml", "labelme", "images"), ("labelme", "labelme", "images"), ("png", "folder", ".")],
)
def test_our_own_sets_read_the_files_and_untouched_is_void(
    name: str, kind: str, place: str, tmp_path: Path
) -> None:
    labels = nested(4)
    write_png(tmp_path / "images/a.png", np.zeros((*SIZE, 3), np.uint8))
    FORMATS[name].write([correction(labels, "a.png")], tmp_path / place)
    dataset = open_dataset(kind, tmp_path)
    truth = dataset.truth(dataset.items[0])
    said = ("untouched", "void", *(("horizontal",) if name == "png" else ()))
    known = ~np.isin(labels, [LABELS.index(one) for one in said])
    assert (truth.valid.numpy() == known).all()
    assert (truth.road.numpy() == (labels == LABELS.index("road"))).all()
    if name == "png":
        assert truth.layout is not None
        assert (truth.layout.numpy() == correction(labels).layout).all()


# --- CVAT -------------------------------------------------------------------------------


def cvat_folder(folder: Path, labels: np.ndarray) -> Path:
    FORMATS["cvat"].write([correction(labels, "a.jpg")], folder)
    return folder / "SegmentationClass/a.png"


def test_cvat_has_its_files(tmp_path: Path) -> None:
    cvat_folder(tmp_path, nested(6))
    lines = (tmp_path / "labelmap.txt").read_text().splitlines()
    assert lines[:3] == [
        "# label:color_rgb:parts:actions",
        "background:0,0,0::",
        "road:128,64,128::",
    ]
    assert (tmp_path / "ImageSets/Segmentation/default.txt").read_text() == "a\n"
    with Image.open(tmp_path / "SegmentationObject/a.png") as picture:
        assert picture.mode == "RGB"


def test_voc_colours_are_those_of_the_palette() -> None:
    assert [voc_colour(n) for n in (0, 1, 2, 3, 8, 20)] == [
        (0, 0, 0),
        (128, 0, 0),
        (0, 128, 0),
        (128, 128, 0),
        (64, 0, 0),
        (0, 64, 128),
    ]


def test_every_part_is_an_object_and_a_hole_is_none() -> None:
    labels = np.zeros((20, 40), np.uint8)
    labels[2:18, 2:18] = 1
    labels[6:10, 6:10] = 0  # a hole (cvat 5137)
    labels[2:8, 25:35] = 1  # another part (cvat 7458)
    colours = object_colours(labels)
    assert colours[3, 3].tolist() == list(voc_colour(1))
    assert colours[3, 30].tolist() == list(voc_colour(2))
    assert colours[7, 7].tolist() == [0, 0, 0]
    assert len(np.unique(colours.reshape(-1, 3), axis=0)) == 3


def test_unknown_colours_are_named_and_counted(tmp_path: Path) -> None:
    path = cvat_folder(tmp_path, nested(7))
    pixels = np.asarray(Image.open(path)).copy()
    pixels[0, :3] = (255, 255, 255)  # cvat 7847
    Image.fromarray(pixels).save(path)
    with pytest.raises(DatasetError, match=r"unknown colours 255 255 255 \(3 pixels\)"):
        FORMATS["cvat"].read(tmp_path, {"a.jpg": SIZE})
    Image.fromarray(nested(7)).save(path)  # a mask of indices
    with pytest.raises(DatasetError, match="unknown colours"):
        FORMATS["cvat"].read(tmp_path, {"a.jpg": SIZE})


def test_a_class_of_somebody_elses_is_named_where_it_is_used(tmp_path: Path) -> None:
    path = cvat_folder(tmp_path, nested(9))
    with (tmp_path / "labelmap.txt").open("a") as file:
        file.write("cat:1,2,3::\n")
    assert FORMATS["cvat"].read(tmp_path, {"a.jpg": SIZE})
    pixels = np.asarray(Image.open(path)).copy()
    pixels[0, 0] = (1, 2, 3)
    Image.fromarray(pixels).save(path)
    with pytest.raises(DatasetError, match=r"class 'cat'.*name it one of road"):
        FORMATS["cvat"].read(tmp_path, {"a.jpg": SIZE})


@pytest.mark.parametrize(
    "line",
    ["road", "road:1,2::", "road:a,b,c::", "road:1,2,300::", "road:1,2,-1::", "other:128,64,128::"],
)
def test_a_broken_labelmap_is_named_by_its_line(line: str, tmp_path: Path) -> None:
    cvat_folder(tmp_path, nested(10))
    with (tmp_path / "labelmap.txt").open("a") as file:
        file.write(line + "\n")
    with pytest.raises(DatasetError, match=r"labelmap\.txt: .* line 10 has"):
        FORMATS["cvat"].read(tmp_path, {"a.jpg": SIZE})


# --- Label Studio -----------------------------------------------------------------------


def test_the_coding_of_brushes_bit_by_bit() -> None:
    bits = (
        f"{8:032b}"  # values: two pixels of four channels
        "00111"  # eight bits of a value
        "0010001101111111"  # counts of 3, 4, 8, 16 bits
        "1" "00" "011" "00000000"  # a run of four times 0
        "1" "00" "011" "11111111"  # a run of four times 255
        "0000000"  # to whole bytes
    )  # fmt: skip
    expected = [int(bits[i : i + 8], 2) for i in range(0, len(bits), 8)]
    assert packed_mask(np.array([[False, True]])) == expected
    assert unpacked_mask(expected, (1, 2)).tolist() == [[False, True]]


def test_values_that_are_no_run_are_read() -> None:
    # As the program itself writes them: one packet of eight single values.
    values = "".join(f"{value:08b}" for value in (0, 0, 0, 0, 9, 9, 9, 255))
    bits = f"{8:032b}" + "00111" + "0010001101111111" + "0" + "00" + "111" + values
    bits += "0" * (-len(bits) % 8)
    data = [int(bits[i : i + 8], 2) for i in range(0, len(bits), 8)]
    assert unpacked_mask(data, (1, 2)).tolist() == [[False, True]]


def task(**region: object) -> list[dict[str, object]]:
    values = {"type": "brushlabels", "original_width": 2, "original_height": 1, **region}
    return [
        {"data": {"image": "/data/upload/1/1f2e3d4c-a.jpg"}, "annotations": [{"result": [values]}]}
    ]


def test_an_annotation_with_a_prefixed_picture_and_a_polygon_is_read(tmp_path: Path) -> None:
    points = [[0, 0], [50, 0], [50, 100], [0, 100]]
    region = {"type": "polygonlabels", "value": {"points": points, "polygonlabels": ["road"]}}
    tasks = task(**region, original_width=20, original_height=10)
    (tmp_path / "tasks.json").write_text(json.dumps(tasks))
    found = FORMATS["label-studio"].read(tmp_path, {"a.jpg": (10, 20), "other.jpg": (1, 2)})
    assert found["a.jpg"][5].tolist() == [1] * 11 + [0] * 9


@pytest.mark.parametrize(
    ("image", "names", "expected"),
    [
        ("11.jpg", ["1.jpg"], None),
        ("x1.jpg", ["1.jpg"], None),
        ("drive/11.jpg", ["1.jpg", "drive/11.jpg"], "drive/11.jpg"),
        ("s3://bucket/sub/a%20b.jpg", ["a b.jpg", "sub/a b.jpg"], "sub/a b.jpg"),
        ("/data/local-files/?d=sub/1.jpg", ["1.jpg", "sub/1.jpg"], "sub/1.jpg"),
        ("/data/upload/3/1f2e3d4c-1.jpg", ["1.jpg", "11.jpg"], "1.jpg"),
        ("/data/upload/3/1f2e3d4c-1.jpg", ["sub/1.jpg"], "sub/1.jpg"),
        ("1f2e3d4c-1.jpg", ["1.jpg"], None),
        ("", ["1.jpg"], None),
    ],
)
def test_a_task_is_for_the_picture_of_its_whole_name(
    image: str, names: list[str], expected: str | None
) -> None:
    assert _picture_of(image, names) == expected


def test_an_upload_of_two_pictures_of_one_name_is_refused() -> None:
    with pytest.raises(ValueError, match=r"1\.jpg could be a/1\.jpg or b/1\.jpg"):
        _picture_of("/data/upload/3/1f2e3d4c-1.jpg", ["b/1.jpg", "a/1.jpg"])


BRUSH = {"rle": [0], "brushlabels": ["road"]}


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"value": {**BRUSH, "brushlabels": ["cat"]}}, "label 'cat'"),
        ({"value": BRUSH}, "ends too early"),
        ({"value": {**BRUSH, "rle": [300]}}, r"value\.rle\.0: .* 300 was given"),
        ({"value": {**BRUSH, "rle": [2**70]}}, r"value\.rle\.0: .* was given"),
        ({"value": {"brushlabels": ["road"]}}, "is empty"),
        ({"value": None}, "value: .*None was given"),
        ({"value": {}}, "label ''"),
        ({"value": {**BRUSH, "rle": packed_mask(np.ones((2, 2), np.bool_))}}, "16"),
        ({"value": BRUSH, "original_width": 3}, "is for 3 by 1 pixels"),
        ({"type": "polygonlabels", "value": {"points": [[0, float("nan")]]}}, "nan was given"),
        ({"type": "polygonlabels", "value": {"points": [[0, 1e9]]}}, "1000000000.0 was given"),
    ],
)
def test_broken_regions_are_named(changed: dict[str, object], words: str, tmp_path: Path) -> None:
    path = tmp_path / "tasks.json"
    path.write_text(json.dumps(task(**changed)))
    with pytest.raises(DatasetError, match=rf"tasks\.json: .*{words}"):
        FORMATS["label-studio"].read(tmp_path, {"a.jpg": (1, 2)})


def test_two_tasks_of_one_picture_are_refused_and_what_was_skipped_is_none(tmp_path: Path) -> None:
    path, sizes = tmp_path / "tasks.json", {"a.jpg": (1, 2)}
    said = {"type": "brushlabels", "original_width": 2, "original_height": 1}
    mask = packed_mask(np.ones((1, 2), np.bool_))
    said["value"] = {"rle": mask, "brushlabels": ["sky"]}
    annotations = [{"result": [said]}, {"result": [], "was_cancelled": True}]
    path.write_text(json.dumps([{"data": {"image": "a.jpg"}, "annotations": annotations}]))
    assert (FORMATS["label-studio"].read(tmp_path, sizes)["a.jpg"] == LABELS.index("sky")).all()
    path.write_text(json.dumps([{"data": {"image": f"{day}/a.jpg"}} for day in ("one", "two")]))
    with pytest.raises(DatasetError, match=r"one/a\.jpg and two/a\.jpg are both a\.jpg"):
        FORMATS["label-studio"].read(tmp_path, sizes)


WRONG = (
    {"annotations": {"result": []}},
    {"annotations": [{"result": "none"}]},
    {"annotations": [{"result": ["a region"]}]},
    {"data": []},
    {"data": {"image": "other.jpg"}},
)


@pytest.mark.parametrize(
    "text",
    ["", "{}", "[1]", "[" * 100_000, *(json.dumps([{**task()[0], **one}]) for one in WRONG)],
)
def test_what_is_no_list_of_tasks_is_refused(text: str, tmp_path: Path) -> None:
    (tmp_path / "tasks.json").write_text(text)
    with pytest.raises(DatasetError, match=r"tasks\.json: "):
        FORMATS["label-studio"].read(tmp_path, {"a.jpg": (1, 2)})
