"""Annotation files and what is drawn in them: LabelMe's XML and labelme's JSON."""

import base64
import json
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, ParseError

import numpy as np
from defusedxml import DefusedXmlException, ElementTree

from roadtorch.data.polygons import Disc, Polygon, Shape, Stamp
from roadtorch.errors import DatasetError
from roadtorch.io.bounded import read_regular, reason
from roadtorch.io.decoding import open_picture

CORNERS = 3  # a polygon needs as many to have an area

MASK_FORMATS = ("PNG", "JPEG")  # of masks inside JSON; labelme itself writes PNG

# What has no area covers no pixel of the truth; labelme draws it for other tasks.
WITHOUT_AREA = ("line", "linestrip", "point", "points")


@dataclass(frozen=True)
class Drawing:
    """A shape, the object it belongs to (stripped, lower case) and who drew it ("" unknown)."""

    name: str
    user: str
    shape: Shape


@dataclass(frozen=True)
class Annotation:
    """An annotation file: what was drawn, in the order of the file.

    size: (height, width) of the picture, if the file says.
    """

    size: tuple[int, int] | None
    drawings: tuple[Drawing, ...]


def read_annotation(path: Path) -> Annotation:
    """Read an annotation file, XML or JSON by its ending.

    Raises DatasetError, naming the file, when it cannot be read or is not what it seems.
    """
    try:
        data = read_regular(path)
    except OSError as problem:
        what = f"cannot be read: {problem.strerror}"
        raise DatasetError(path, what, "every picture needs its annotation") from None
    return _read_json(data, path) if path.suffix.lower() == ".json" else _read_xml(data, path)


def _broken(path: Path, what: str, remedy: str = "mend the file") -> DatasetError:
    return DatasetError(path, what, remedy)


# --- LabelMe XML ------------------------------------------------------------------------


def _read_xml(data: bytes, path: Path) -> Annotation:
    try:
        root = ElementTree.fromstring(data)
    except DefusedXmlException as problem:
        what = f"declares entities, which can be a bomb: {type(problem).__name__}"
        raise _broken(path, what, "remove the declarations") from None
    except (ParseError, ValueError, LookupError) as problem:
        raise _broken(path, f"is not XML: {problem}") from None
    if root.tag != "annotation":
        what = f"is not a LabelMe annotation but has the root element {root.tag!r}"
        raise _broken(path, what, "give LabelMe's XML")
    drawings = tuple(part for element in root.findall("object") for part in _object(element, path))
    height, width = _text(root, "imagesize/nrows"), _text(root, "imagesize/ncols")
    return Annotation(_size(height, width, ("nrows", "ncols"), path), drawings)


def _object(element: Element, path: Path) -> Iterator[Drawing]:
    """The polygons of one object, its blobs; none of a deleted one."""
    if _text(element, "deleted") == "1":
        return
    name = _text(element, "name").lower()
    polygons = element.findall("polygon")
    if not polygons and element.find("segm") is not None:
        what = f"has the object {name!r} as a mask file (segm), which is not read"
        raise _broken(path, what, "draw it as a polygon, or delete it")
    for polygon in polygons:
        points = [
            (_coordinate(_text(pt, "x"), name, path), _coordinate(_text(pt, "y"), name, path))
            for pt in polygon.findall("pt")
        ]
        if len(points) >= CORNERS:
            user = _text(polygon, "username") or _text(element, "username")
            yield Drawing(name, user, Polygon(np.array(points)))


def _text(element: Element, name: str) -> str:
    return (element.findtext(name) or "").strip()


# --- labelme JSON -----------------------------------------------------------------------


def _read_json(data: bytes, path: Path) -> Annotation:
    try:
        document = json.loads(data)
    except (ValueError, RecursionError) as problem:
        raise _broken(path, f"is not JSON: {problem}") from None
    shapes = document.get("shapes") if isinstance(document, dict) else None
    if not isinstance(shapes, list):
        raise _broken(path, "is not a labelme annotation: it has no list of shapes")
    parts = (_shape(shape, path) for shape in shapes)
    drawings = tuple(part for part in parts if part is not None)
    keys = "imageHeight", "imageWidth"
    return Annotation(_size(document.get(keys[0]), document.get(keys[1]), keys, path), drawings)


def _shape(shape: Any, path: Path) -> Drawing | None:
    """One shape; None for those without area."""
    if not isinstance(shape, dict) or not isinstance(shape.get("label"), str):
        raise _broken(path, "has a shape without label")
    name = shape["label"].strip().lower()
    kind = shape.get("shape_type") or "polygon"  # older files leave polygons unnamed
    if kind in WITHOUT_AREA:
        return None
    points = _points(shape, name, path)
    match kind, len(points):
        case "polygon" | "oriented_rectangle", n if n >= CORNERS:
            return Drawing(name, "", Polygon(points))
        case "rectangle", 4:
            return Drawing(name, "", Polygon(points))
        case "rectangle", 2:
            (left, top), (right, bottom) = points
            corners = np.array([(left, top), (right, top), (right, bottom), (left, bottom)])
            return Drawing(name, "", Polygon(corners))
        case "circle", 2:
            x, y = points[0].tolist()
            return Drawing(name, "", Disc(x, y, math.dist(*points)))
        case "mask", 2:
            return Drawing(name, "", _stamp(shape.get("mask"), points, name, path))
        case _:
            raise _broken(path, f"has a shape {name!r} of type {kind!r} with {len(points)} points")


def _points(shape: dict[str, Any], name: str, path: Path) -> np.ndarray:
    """The points float64 (N,2) of a shape."""
    points = shape.get("points")
    is_list = isinstance(points, list)
    if not is_list or not all(isinstance(pair, list) and len(pair) == 2 for pair in points):
        raise _broken(path, f"has a shape {name!r} whose points are not pairs")
    numbers = [[_coordinate(value, name, path) for value in pair] for pair in points]
    return np.array(numbers, np.float64).reshape(-1, 2)


def _stamp(encoded: Any, points: np.ndarray, name: str, path: Path) -> Stamp:
    """A mask shape: PNG or JPEG as base64, filling the box from its first to its last corner."""
    left, top = (int(value) for value in points.min(0))
    right, bottom = (int(value) for value in points.max(0))
    box = (bottom - top + 1, right - left + 1)
    try:
        with open_picture(base64.b64decode(encoded, validate=True), MASK_FORMATS) as picture:
            if (picture.height, picture.width) != box:
                what = f"is {picture.width} by {picture.height}, its box {box[1]} by {box[0]}"
                raise _broken(path, f"has a mask {name!r} that {what}")
            return Stamp(left, top, np.asarray(picture.convert("L")) > 0)
    except DatasetError:
        raise
    except Exception as problem:
        what = f"has a mask {name!r} that cannot be decoded: {reason(problem)}"
        raise _broken(path, what, "give it as PNG or JPEG") from None


# --- numbers ----------------------------------------------------------------------------


def _coordinate(value: Any, name: str, path: Path) -> float:
    """A number that was given for ``name``, white space around it allowed."""
    try:
        number = math.nan if isinstance(value, bool) else float(value)
    except (TypeError, ValueError, OverflowError):
        number = math.nan
    if not math.isfinite(number):
        raise _broken(path, f"has {value!r} where {name!r} needs a number")
    return number


def _size(height: Any, width: Any, names: tuple[str, str], path: Path) -> tuple[int, int] | None:
    """(height, width) if both are positive; None where a file leaves them out, empty or zero."""
    if height in (None, "") or width in (None, ""):
        return None
    rows, columns = _coordinate(height, names[0], path), _coordinate(width, names[1], path)
    if rows == 0 or columns == 0:
        return None
    if rows < 0 or columns < 0 or rows % 1 or columns % 1:
        raise _broken(path, f"says its picture has {columns:g} by {rows:g} pixels")
    return int(rows), int(columns)
