"""LabelMe's XML and labelme's JSON as truth."""

import base64
import io
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from roadtorch.base.errors import DatasetError
from roadtorch.data.catalogue import open_dataset
from roadtorch.data.dataset import LabelledItem, Truth
from roadtorch.data.labelme import PolygonLabels, read_annotation
from tests.data.conftest import (
    BLOB,
    SIZE,
    SIZE_XML,
    document,
    object_xml,
    polygon_xml,
    shape,
    write,
    xml,
)

SECOND_BLOB = [(11, 6), (14, 6), (14, 10), (11, 10)]
BENS = object_xml(polygon_xml([(2, 3), (10, 3), (10, 8), (2, 8)], "ben"))
ANNAS = object_xml(polygon_xml(BLOB, "anna"), polygon_xml(SECOND_BLOB, "anna"))
TWO_PEOPLE = xml(ANNAS, BENS)
PICTURE = np.zeros((*SIZE, 3), np.uint8)


def truth_of(picture: Path, text: str, **settings: Any) -> Truth:
    label = write(picture.with_suffix(".xml" if text.startswith("<") else ".json"), text)
    return PolygonLabels(**settings).truth(LabelledItem(picture.stem, picture, label))


# --- what is drawn --------------------------------------------------------------------------------


def blob(**more: Any) -> str:
    return object_xml(polygon_xml(BLOB), **more)


def encoded(picture: Image.Image, kind: str) -> str:
    file = io.BytesIO()
    picture.save(file, kind)
    return base64.b64encode(file.getvalue()).decode()


STREET = blob(name=" Street\n")
SPACED = object_xml(polygon_xml([("\n 2 ", "3.2"), *BLOB[1:]]))
CAR = object_xml(polygon_xml([(4, 4), (5, 4), (5, 5), (4, 5)]), name="car")
EDGE = object_xml(polygon_xml([(-3.5, -2), (16, -2), (16, 1.2), (-3.5, 1.2)]))
STAMP = Image.fromarray(np.array([[True, False, True], [True, True, True]]))
MASK = shape([[1, 2], [3, 3]], "mask", mask=encoded(STAMP, "png"))
LOZENGE = shape([(3, 0), (6, 3), (3, 6), (0, 3)], "oriented_rectangle")


@pytest.mark.parametrize(
    ("text", "settings", "road", "void"),
    [
        (xml(STREET), {}, 0, 0),
        (xml(STREET), {"road": ("road", "street")}, 48, 0),
        (xml(blob(deleted=1), object_xml(polygon_xml(SECOND_BLOB))), {}, 20, 0),
        (xml(blob(), CAR), {}, 48 - 4, 0),  # a later object cuts a hole
        (xml(CAR, blob()), {}, 48, 0),  # and an earlier one does not
        (xml(blob(name="void")), {}, 0, 48),
        (xml(blob(name="Ignore")), {}, 0, 48),
        (xml(EDGE), {}, 2 * 16, 0),  # slightly outside is clipped
        *(
            (xml(SPACED, size=size), {}, 48, 0)  # a missing size is the picture's
            for size in ("", "<imagesize/>", SIZE_XML.replace("12", "0").replace("16", "0"))
        ),
        (TWO_PEOPLE, {"user": "anna"}, 68, 0),
        (TWO_PEOPLE, {"user": "ben"}, 54, 0),
        (TWO_PEOPLE, {"agreement": "intersection"}, 48, 0),
        (TWO_PEOPLE, {"agreement": "union"}, 74, 0),
        (TWO_PEOPLE, {}, 48, 0),  # one of two is no majority
        *(
            (document(*shapes, **size), {}, road, void)
            for size in ({}, {"imageHeight": None, "imageWidth": None})
            for shapes, road, void in [
                ([shape(BLOB), shape(SECOND_BLOB)], 68, 0),
                ([shape(BLOB, None, " Road ")], 48, 0),
                ([shape([(9, 8), (2, 3)], "rectangle")], 48, 0),
                ([shape(BLOB, "rectangle")], 48, 0),
                ([LOZENGE], 25, 0),
                ([shape([(5, 4), (5, 6)], "circle")], 13, 0),
                ([MASK], 5, 0),
                ([shape(BLOB), shape([(4, 4), (5, 5)], "rectangle", "car")], 44, 0),
                ([shape(BLOB), shape([(4, 4), (5, 5)], "rectangle", "void")], 44, 4),
                ([shape([(0, 0), (9, 9)], "line"), shape(BLOB, "linestrip")], 0, 0),
                ([shape([(0, 0)], "point"), shape([(0, 0)], "points")], 0, 0),
                ([], 0, 0),
            ]
        ),
    ],
)
def test_what_is_road_and_void(tmp_path, text, settings, road, void):
    truth = truth_of(write(tmp_path / "a.png", PICTURE), text, **settings)

    assert truth.road.shape == SIZE
    assert (int(truth.road.sum()), int((~truth.valid).sum())) == (road, void)


def test_the_size_of_a_picture_that_is_stored_lying(tmp_path):
    path, exif = tmp_path / "a.jpg", Image.Exif()
    exif[0x0112] = 6
    Image.fromarray(np.zeros((16, 12, 3), np.uint8)).save(path, exif=exif)

    assert truth_of(path, xml(blob())).road.shape == SIZE


@pytest.mark.parametrize("kind", ["EPS", "TIFF"])
def test_a_mask_of_another_format_reaches_no_decoder(tmp_path, kind, monkeypatch):
    Image.init()
    text = encoded(Image.new("RGB", (3, 2)), kind)
    path = write(tmp_path / "a.json", document(MASK | {"mask": text}))
    reached: list[str] = []
    monkeypatch.setitem(Image.OPEN, kind, (lambda *_: reached.append(kind), Image.OPEN[kind][1]))

    with pytest.raises(DatasetError, match="mask 'road' that cannot be decoded"):
        read_annotation(path, SIZE)
    assert not reached


# --- finding the files ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    "files", [("anna/a.xml", "ben/a.xml"), ("a.anna.xml", "a.ben.xml"), ("a.anna.xml", "ben/a.xml")]
)
def test_a_file_for_each_person(tmp_path, files):
    write(tmp_path / "images/a.png", PICTURE)
    hers = xml(object_xml(polygon_xml(BLOB), polygon_xml(SECOND_BLOB, "anonymous")))
    for name, text in zip(files, (hers, xml(BENS)), strict=True):
        write(tmp_path / "annotations" / name, text)

    counts = {}
    for name in ("labelme", "labelme:union", "labelme:intersection"):
        dataset = open_dataset(name, tmp_path)
        assert dataset.name == name
        counts[name] = int(dataset.read(dataset.items[0])[1].road.sum())

    assert counts == {"labelme": 48, "labelme:union": 74, "labelme:intersection": 48}


def test_who_drew_nothing_in_a_file_of_their_own_saw_no_road(tmp_path):
    write(tmp_path / "images/a.png", PICTURE)
    write(tmp_path / "annotations/anna/a.xml", TWO_PEOPLE)
    write(tmp_path / "annotations/ben/a.json", document())
    dataset = open_dataset("labelme:intersection", tmp_path)

    assert not dataset.truth(dataset.items[0]).road.any()
    assert pickle.loads(pickle.dumps(dataset.reader)) == dataset.reader  # it goes to processes


def test_annotations_beside_the_pictures(tmp_path):
    write(tmp_path / "a.png", PICTURE)
    write(tmp_path / "a.json", document(shape(BLOB)))

    dataset = open_dataset("labelme", tmp_path)

    assert dataset.groups() == []
    assert dataset.read(dataset.items[0])[1].road.sum() == 48


def test_labelmes_own_folders_are_groups(tmp_path):
    for name in ("north/a", "north/b", "south/a"):
        write(tmp_path / f"Images/{name}.png", PICTURE)
        write(tmp_path / f"Annotations/{name}.xml", xml())
    write(tmp_path / "Annotations/ben/south/a.xml", xml(BENS))
    write(tmp_path / "Annotations/south/removed.xml", xml())

    dataset = open_dataset("labelme", tmp_path)
    last = dataset.items[-1]

    assert [item.name for item in dataset.items] == ["north/a", "north/b", "south/a"]
    assert dataset.groups() == ["north", "south"]
    folders = {path.parent.parent.name for path in (last.label, *last.extra)}
    assert folders == {"Annotations", "ben"}
    assert dataset.truth(last).road.sum() == 54
