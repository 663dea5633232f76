"""Annotation files and what is drawn in them: LabelMe's XML and labelme's JSON."""

import base64
import math
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Annotated, Any, NamedTuple
from xml.etree.ElementTree import Element

import numpy as np
from defusedxml import ElementTree
from pydantic import BeforeValidator, StringConstraints

from roadtorch.data.imported import Coordinate, Imported, Side, imported
from roadtorch.data.polygons import Fill, fill_disc, fill_polygon, fill_stamp
from roadtorch.io.decoding import open_picture

CORNERS = 3  # a polygon needs as many to have an area

MAX_OVERHANG = 1.0  # picture sizes that a shape may reach beyond it; ours: more is a mistake

MASK_FORMATS = ("PNG", "JPEG")  # of masks inside JSON; labelme itself writes PNG

# What has no area covers no pixel of the truth; labelme draws it for other tasks.
WITHOUT_AREA = ("line", "linestrip", "point", "points")


class Drawing(NamedTuple):
    """A shape, the object it belongs to (stripped, lower case) and who drew it ("" unknown)."""

    name: str
    user: str
    fill: Fill


class _Shape(Imported):
    """A shape of a labelme file; older ones leave polygons unnamed."""

    label: Annotated[str, StringConstraints(strip_whitespace=True, to_lower=True)]
    username: str = ""
    shape_type: str | None = None
    points: tuple[tuple[Coordinate, Coordinate], ...]
    mask: str | None = None


_Length = Annotated[
    Side | None, BeforeValidator(lambda given: None if given in ("", "0", 0) else given)
]


class _Document(Imported):
    """A labelme file; a length that is left out, empty or zero is that of the picture."""

    shapes: tuple[_Shape, ...]
    imageHeight: _Length = None  # noqa: N815, as labelme has it
    imageWidth: _Length = None  # noqa: N815


def read_annotation(path: Path, size: tuple[int, int]) -> list[Drawing]:
    """What is drawn in an annotation file, XML or JSON by its ending, on a picture of (H,W).

    Shapes may stick out of the picture. Raises DatasetError, naming the file, when it cannot be
    read, is for a picture of another size, or has a shape far outside.
    """
    with imported(path, "give the annotation of this picture, in pixels of it") as data:
        if path.suffix.lower() == ".json":
            document = _Document.model_validate_json(data)
        else:
            document = _Document.model_validate(_xml_values(data), strict=False)
        rows, columns = document.imageHeight or size[0], document.imageWidth or size[1]
        if (rows, columns) != size:
            told = f"it is for {columns} by {rows} pixels"
            raise ValueError(f"{told}, its picture has {size[1]} by {size[0]}")
        return [
            _drawing(one, size) for one in document.shapes if one.shape_type not in WITHOUT_AREA
        ]


def _xml_values(data: bytes) -> dict[str, Any]:
    """LabelMe's XML as the values of a labelme file: the polygons of the objects not deleted."""
    root = ElementTree.fromstring(data)
    if root.tag != "annotation":
        raise ValueError(f"not a LabelMe annotation: its root element is {root.tag!r}")
    shapes = [shape for element in root.findall("object") for shape in _xml_shapes(element)]
    lengths = {
        key: root.findtext(f"imagesize/{name}", "").strip()
        for key, name in (("imageHeight", "nrows"), ("imageWidth", "ncols"))
    }
    return {"shapes": shapes, **lengths}


def _xml_shapes(element: Element) -> Iterator[dict[str, Any]]:
    if element.findtext("deleted", "").strip() == "1":
        return
    name, polygons = element.findtext("name", ""), element.findall("polygon")
    if not polygons and element.find("segm") is not None:
        raise ValueError(f"the object {name!r} is a mask file (segm): draw it as a polygon")
    for polygon in polygons:
        points = [(pt.findtext("x", ""), pt.findtext("y", "")) for pt in polygon.findall("pt")]
        if len(points) >= CORNERS:
            user = (polygon.findtext("username") or element.findtext("username", "")).strip()
            yield {"label": name, "username": user, "points": points}


def _drawing(one: _Shape, size: tuple[int, int]) -> Drawing:
    """What a shape with an area draws; ValueError for one that is none, or far outside."""
    points = np.array(one.points, np.float64).reshape(-1, 2)
    match one.shape_type or "polygon", len(points):
        case "polygon" | "oriented_rectangle", count if count >= CORNERS:
            fill = partial(fill_polygon, points)
        case "rectangle", 4:
            fill = partial(fill_polygon, points)
        case "rectangle", 2:
            (left, top), (right, bottom) = points
            corners = [(left, top), (right, top), (right, bottom), (left, bottom)]
            fill = partial(fill_polygon, np.array(corners))
        case "circle", 2:
            (x, y), radius = points[0].tolist(), math.dist(*points)
            fill = partial(fill_disc, x, y, radius)
            points = np.array([(x - radius, y - radius), (x + radius, y + radius)])
        case "mask", 2:
            fill = _stamp(one, points.astype(int))
        case kind, count:
            raise ValueError(f"a shape {one.label!r} of type {kind!r} with {count} points")
    (left, top), (right, bottom) = points.min(0), points.max(0)
    beside = max(-left, right - size[1]) > MAX_OVERHANG * size[1]
    if beside or max(-top, bottom - size[0]) > MAX_OVERHANG * size[0]:
        raise ValueError(
            f"an object {one.label!r} from ({left:g}, {top:g}) to ({right:g}, {bottom:g}), "
            f"far outside its picture of {size[1]} by {size[0]}"
        )
    return Drawing(one.label, one.username, fill)


def _stamp(one: _Shape, points: np.ndarray) -> Fill:
    """A mask shape: PNG or JPEG as base64, filling the box from its first to its last corner."""
    (left, top), (right, bottom) = points.min(0).tolist(), points.max(0).tolist()
    box = (right - left + 1, bottom - top + 1)
    try:
        data = base64.b64decode(one.mask or "", validate=True)
        with open_picture(data, MASK_FORMATS) as picture:
            if picture.size == box:
                return partial(fill_stamp, left, top, np.asarray(picture.convert("L")) > 0)
            told = f"is {picture.width} by {picture.height}, its box {box[0]} by {box[1]}"
    except Exception as problem:  # Pillow raises anything
        told = f"cannot be decoded: {problem}"
    raise ValueError(f"a mask {one.label!r} that {told}")
