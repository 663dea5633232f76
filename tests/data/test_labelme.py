"""LabelMe's XML and labelme's JSON as truth."""

import base64
import io
import json
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from roadtorch.data.annotations import read_annotation
from roadtorch.data.catalogue import open_dataset
from roadtorch.data.dataset import Item
from roadtorch.data.labelme import PolygonLabels
from roadtorch.errors import ConfigError, DatasetError

SIZE = (12, 16)
BLOB, SECOND_BLOB = [(2, 3), (9, 3), (9, 8), (2, 8)], [(11, 6), (14, 6), (14, 10), (11, 10)]
BENS = [(2, 3), (10, 3), (10, 8), (2, 8)]
SIZE_XML = "<imagesize><nrows>12</nrows><ncols>16</ncols></imagesize>"


def polygon_xml(points, user: str = "") -> str:
    username = f"<username>{user}</username>" if user else ""
    corners = "".join(f"<pt><x>{x}</x><y>{y}</y></pt>" for x, y in points)
    return f"<polygon>{username}{corners}</polygon>"


def object_xml(*polygons: str, name: str = "road", deleted: int = 0) -> str:
    return f"<object><name>{name}</name><deleted>{deleted}</deleted>{''.join(polygons)}</object>"


def xml(*objects: str, size: str = SIZE_XML) -> str:
    return f"<annotation><filename>a.png</filename>{size}{''.join(objects)}</annotation>"


TWO_PEOPLE = xml(
    object_xml(polygon_xml(BLOB, "anna"), polygon_xml(SECOND_BLOB, "anna")),
    object_xml(polygon_xml(BENS, "ben")),
)


def shape(points: Any, kind: str | None = "polygon", label: str = "road", **more: Any) -> dict:
    return {"label": label, "points": points, "shape_type": kind, "group_id": None, **more}


def document(*shapes: Any, **more: Any) -> str:
    size = {"imageHeight": 12, "imageWidth": 16}
    return json.dumps({"version": "5.5.0", "shapes": list(shapes), "imageData": None} | size | more)


@pytest.fixture
def picture(tmp_path) -> Path:
    path = tmp_path / "images/a.png"
    write_picture(path)
    return path


def write_picture(path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.zeros((*SIZE, 3), np.uint8)).save(path)


def write(path: Path, text: str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
    return path


def truth_of(picture: Path, text: str, ending: str = ".xml", **settings: Any):
    label = write(picture.with_suffix(ending), text)
    return PolygonLabels(**settings).truth(Item(picture.stem, picture, label))


def road_pixels(picture: Path, text: str, ending: str = ".xml", **settings: Any) -> int:
    return int(truth_of(picture, text, ending, **settings).road.sum())


# --- people ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("settings", "pixels"),
    [
        ({"user": "anna"}, 68),
        ({"user": "ben"}, 54),
        ({"agreement": "intersection"}, 48),
        ({"agreement": "union"}, 74),
        ({}, 48),  # one of two is no majority
    ],
)
def test_two_people_in_one_file(picture, settings, pixels):
    assert road_pixels(picture, TWO_PEOPLE, **settings) == pixels


@pytest.mark.parametrize(
    "files", [("anna/a.xml", "ben/a.xml"), ("a.anna.xml", "a.ben.xml"), ("a.anna.xml", "ben/a.xml")]
)
def test_a_file_for_each_person(tmp_path, picture, files):
    hers = xml(object_xml(polygon_xml(BLOB), polygon_xml(SECOND_BLOB, "anonymous")))
    for name, text in zip(files, (hers, xml(object_xml(polygon_xml(BENS)))), strict=True):
        write(tmp_path / "annotations" / name, text)

    counts = {}
    for name in ("labelme", "labelme:union", "labelme:intersection"):
        dataset = open_dataset(name, tmp_path)
        assert dataset.name == name
        counts[name] = int(dataset.read(dataset.items[0])[1].road.sum())

    assert counts == {"labelme": 48, "labelme:union": 74, "labelme:intersection": 48}


def test_who_drew_nothing_in_a_file_of_their_own_saw_no_road(tmp_path, picture):
    write(tmp_path / "annotations/anna/a.xml", TWO_PEOPLE)
    write(tmp_path / "annotations/ben/a.json", document())
    dataset = open_dataset("labelme:intersection", tmp_path)

    assert not dataset.truth(dataset.items[0]).road.any()


def test_an_unknown_person(picture):
    with pytest.raises(DatasetError, match=r"a\.xml: has nothing from .* carl .*by anna, ben"):
        truth_of(picture, TWO_PEOPLE, user="carl")


def test_two_files_of_one_person(tmp_path, picture):
    for name in ("a.xml", "a.json"):
        write(tmp_path / "annotations" / name, TWO_PEOPLE)

    with pytest.raises(DatasetError, match=r"a\.xml: and a\.json are both for the picture a"):
        open_dataset("labelme", tmp_path)


def test_the_reader_travels_to_other_processes():
    reader = PolygonLabels(user="anna", root=Path("annotations"))

    assert pickle.loads(pickle.dumps(reader)) == reader
    with pytest.raises(ConfigError, match=r"most: unknown agreement .*majority"):
        PolygonLabels(agreement="most")  # pyright: ignore[reportArgumentType]


# --- XML ------------------------------------------------------------------------------------------


def blob_xml(**more: Any) -> str:
    return object_xml(polygon_xml(BLOB), **more)


SPACED = object_xml(polygon_xml([("\n 2 ", "3.2"), *BLOB[1:]]))
CAR = object_xml(polygon_xml([(4, 4), (5, 4), (5, 5), (4, 5)]), name="car")
EDGE = object_xml(polygon_xml([(-3.5, -2), (16, -2), (16, 1.2), (-3.5, 1.2)]))


@pytest.mark.parametrize(
    ("text", "settings", "road", "void"),
    [
        (xml(blob_xml(name=" Street\n")), {}, 0, 0),
        (xml(blob_xml(name=" Street\n")), {"road": ("road", "street")}, 48, 0),
        (xml(blob_xml(deleted=1), object_xml(polygon_xml(SECOND_BLOB))), {}, 20, 0),
        (xml(blob_xml(), CAR), {}, 48 - 4, 0),  # a later object cuts a hole
        (xml(CAR, blob_xml()), {}, 48, 0),  # and an earlier one does not
        (xml(blob_xml(name="void")), {}, 0, 48),
        (xml(blob_xml(name="Ignore")), {}, 0, 48),
        (xml(EDGE), {}, 2 * 16, 0),  # slightly outside is clipped
        *(
            (xml(SPACED, size=size), {}, 48, 0)  # a missing size is the picture's
            for size in ("", "<imagesize/>", SIZE_XML.replace("12", "0").replace("16", "0"))
        ),
    ],
)
def test_what_objects_mean(picture, text, settings, road, void):
    truth = truth_of(picture, text, **settings)

    assert truth.road.shape == SIZE
    assert (int(truth.road.sum()), int((~truth.valid).sum())) == (road, void)


def test_the_size_of_a_picture_that_is_stored_lying(tmp_path):
    path, exif = tmp_path / "a.jpg", Image.Exif()
    exif[0x0112] = 6
    Image.fromarray(np.zeros((16, 12, 3), np.uint8)).save(path, exif=exif)

    assert truth_of(path, xml(object_xml(polygon_xml(BLOB)))).road.shape == SIZE


BOMB = (
    '<?xml version="1.0"?><!DOCTYPE lolz [<!ENTITY lol "lol">'
    + "".join(
        f'<!ENTITY lol{i} "{f"&lol{i - 1};" * 10}">'.replace("lol0", "lol") for i in range(1, 9)
    )
    + "]><annotation><filename>&lol8;</filename></annotation>"
)
OUTSIDE = '<!DOCTYPE a [<!ENTITY e SYSTEM "file:///etc/passwd">]><annotation>&e;</annotation>'


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("<annotation><object>", "is not XML: no element found"),
        ("", "is not XML"),
        ('<?xml version="1.0" encoding="klingon"?><annotation/>', "unknown encoding"),
        (BOMB, "declares entities, which can be a bomb"),
        (OUTSIDE, "declares entities"),
        ("<html></html>", "not a LabelMe annotation: .* 'html'"),
        *(
            (
                xml(object_xml(polygon_xml([(1, word), *BLOB]))),
                rf"shapes\.0\.points\.0\.1: .* '{word}' was given",
            )
            for word in ("nan", "inf", "", "1e300")
        ),
        (xml(object_xml(polygon_xml([(-17, 3), *BLOB]))), r"'road' from \(-17, 3\) .*far outside"),
        (xml(object_xml(polygon_xml([(1, 25), *BLOB]))), "far outside its picture of 16 by 12"),
        (
            xml(size=SIZE_XML.replace("12", "24")),
            "is for 16 by 24 pixels, its picture has 16 by 12",
        ),
        (xml(size=SIZE_XML.replace("12", "-1")), "imageHeight: .* equal to 1, '-1' was given"),
        (xml(size=SIZE_XML.replace("12", "many")), "imageHeight: .* 'many' was given"),
        (xml(object_xml("<segm><mask>m.png</mask></segm>")), r"is a mask file \(segm\)"),
    ],
)
def test_broken_xml(picture, text, message):
    with pytest.raises(DatasetError, match=rf"a\.xml: .*{message}") as caught:
        truth_of(picture, text)

    assert "\n" not in str(caught.value)


# --- JSON -----------------------------------------------------------------------------------------


def encoded(mask: list[list[bool]]) -> str:
    file = io.BytesIO()
    Image.fromarray(np.array(mask, np.bool_)).save(file, "png")
    return base64.b64encode(file.getvalue()).decode()


MASK = shape([[1, 2], [3, 3]], "mask", mask=encoded([[True, False, True], [True, True, True]]))


@pytest.mark.parametrize(
    ("shapes", "pixels"),
    [
        ([shape(BLOB), shape(SECOND_BLOB)], 68),
        ([shape(BLOB, None, " Road ")], 48),
        ([shape([(9, 8), (2, 3)], "rectangle")], 48),
        ([shape(BLOB, "rectangle")], 48),
        ([shape([(3, 0), (6, 3), (3, 6), (0, 3)], "oriented_rectangle")], 25),
        ([shape([(5, 4), (5, 6)], "circle")], 13),
        ([MASK], 5),
        ([shape(BLOB), shape([(4, 4), (5, 5)], "rectangle", "car")], 44),
        ([shape(BLOB), shape([(4, 4), (5, 5)], "rectangle", "void")], 44),
        ([shape([(0, 0), (9, 9)], "line"), shape(BLOB, "linestrip")], 0),
        ([shape([(0, 0)], "point"), shape([(0, 0)], "points")], 0),
        ([], 0),
    ],
)
def test_every_kind_of_shape(picture, shapes, pixels):
    assert road_pixels(picture, document(*shapes), ".json") == pixels
    unsized = document(*shapes, imageHeight=None, imageWidth=None)
    assert road_pixels(picture, unsized, ".json") == pixels


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "is not JSON"),
        ("[" * 100_000, "is not JSON"),
        ("[]", "it: input should be an object"),
        ('{"shapes": {}}', "shapes: input should be a valid array"),
        (document({"points": []}), r"shapes\.0\.label is missing"),
        (document(shape([(1, 2), (3, 4)])), "'road' of type 'polygon' with 2 points"),
        (document(shape(BLOB, "star")), "'road' of type 'star'"),
        (document(shape([1, 2, 3])), r"shapes\.0\.points\.0: .* array, 1 was given"),
        (
            document(shape([(0, 0), (1, 1), (1, float("nan"))])),
            r"shapes\.0\.points\.2\.1: .*, nan was given",
        ),
        (
            document(shape([(0, 0), (1, 1), (1, True)])),
            r"shapes\.0\.points\.2\.1: .*, True was given",
        ),
        (
            document(shape([(0, 0), (1, 1), (1e9, 1)])),
            r"shapes\.0\.points\.2\.0: .* 1000000000.0 was",
        ),
        (document(shape([(0, 0), (1, 1), (1e6, 1)])), "far outside"),
        (document(shape([(5, 5), (5, 40)], "circle")), r"from \(-30, -30\) to \(40, 40\), far"),
        (document(shape([(0, 0), (1e308, 1e308)], "circle")), "1e\\+308 was given"),
        (document(imageHeight=2**70), "imageHeight: .* was given"),
        (document(MASK | {"mask": "?"}), "mask 'road' that cannot be decoded"),
        (document(MASK | {"mask": None}), "mask 'road' that cannot be decoded"),
        (document(MASK | {"points": [[1, 2], [4, 3]]}), "is 3 by 2, its box 4 by 2"),
        (document(imageHeight=8), "is for 16 by 8 pixels"),
    ],
)
def test_broken_json(picture, text, message):
    with pytest.raises(DatasetError, match=rf"a\.json: .*{message}"):
        truth_of(picture, text, ".json")


# --- finding the files ----------------------------------------------------------------------------


def test_annotations_beside_the_pictures(tmp_path):
    write_picture(tmp_path / "a.png")
    write(tmp_path / "a.json", document(shape(BLOB)))

    dataset = open_dataset("labelme", tmp_path)

    assert dataset.groups() == []
    assert dataset.read(dataset.items[0])[1].road.sum() == 48


def test_labelmes_own_folders_are_groups(tmp_path):
    for name in ("north/a", "north/b", "south/a"):
        write_picture(tmp_path / f"Images/{name}.png")
        write(tmp_path / f"Annotations/{name}.xml", xml())
    write(tmp_path / "Annotations/ben/south/a.xml", xml(object_xml(polygon_xml(BENS))))
    write(tmp_path / "Annotations/south/removed.xml", xml())

    dataset = open_dataset("labelme", tmp_path)
    last = dataset.items[-1]

    assert [item.name for item in dataset.items] == ["north/a", "north/b", "south/a"]
    assert dataset.groups() == ["north", "south"]
    assert {last.label.parent.parent.name, *(p.parent.parent.name for p in last.extra)} == {
        "Annotations",
        "ben",
    }
    assert dataset.truth(last).road.sum() == 54


def test_a_picture_without_annotation(tmp_path, picture):
    write_picture(tmp_path / "images/b.png")
    write(tmp_path / "annotations/b.xml", xml())

    with pytest.raises(DatasetError, match=r"annotations/a\.xml: .*missing, .* 1 of 2 annotations"):
        open_dataset("labelme", tmp_path)


def test_two_pictures_of_one_name(tmp_path, picture):
    write_picture(tmp_path / "images/a.bmp")

    with pytest.raises(DatasetError, match=r"a\.png: has the name of a\.bmp"):
        open_dataset("labelme", tmp_path)


@pytest.mark.parametrize("kind", ["EPS", "GIF", "TIFF", "BMP"])
def test_a_mask_of_another_format_reaches_no_decoder(
    tmp_path: Path, kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = io.BytesIO()
    Image.new("RGB", (3, 2)).save(file, kind)
    text = base64.b64encode(file.getvalue()).decode()
    path = tmp_path / "a.json"
    path.write_text(document(MASK | {"mask": text}))
    Image.init()
    decode, accept = Image.OPEN[kind]
    reached: list[str] = []

    def reach(*given: Any) -> Any:
        reached.append(kind)
        return decode(*given)

    monkeypatch.setitem(Image.OPEN, kind, (reach, accept))

    with pytest.raises(DatasetError, match="mask 'road' that cannot be decoded"):
        read_annotation(path, SIZE)
    assert not reached
