"""Drawn annotations, LabelMe's XML and labelme's JSON, as truth by one or several people.

XML as LabelMe and the tool of Álvarez et al. (arXiv 1412.3506, §4) store it: objects that
consist of polygons, each with the name of who drew it. JSON as the program labelme stores
it: a list of shapes. The files of one picture are all those that bear its name::

    NAME.xml     NAME.json           beside the picture or in ROOT/annotations
    USER/NAME.xml                    one folder for each person
    NAME.USER.xml                    one suffix for each person
"""

import base64
import math
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path, PurePath
from typing import Annotated, Any, NamedTuple
from xml.etree.ElementTree import Element

import numpy as np
from defusedxml import ElementTree
from PIL.ExifTags import Base as ExifTag
from pydantic import BeforeValidator, StringConstraints

from roadtorch.base.bounded import read_regular, reason
from roadtorch.base.decoding import open_picture, without_warnings
from roadtorch.base.errors import ConfigError, DatasetError
from roadtorch.base.image import SUFFIXES
from roadtorch.data.dataset import Dataset, LabelledItem, Truth
from roadtorch.data.imported import Coordinate, Imported, Side, imported
from roadtorch.data.labels import is_picture
from roadtorch.data.polygons import (
    CORNERS,
    OTHER,
    ROAD,
    VOID,
    Agreement,
    Fill,
    agree,
    fill_disc,
    fill_polygon,
    fill_stamp,
    filled_shapes,
    outlines,
)

ENDINGS = (".xml", ".json")

AGREEMENTS = ("majority", "union", "intersection")

TURNED = (5, 6, 7, 8)  # EXIF orientations that swap width and height

NAMES = ("not road", "road")
"""Labels of outlines. A hole is drawn behind what it is in, and cuts it; readers need no more."""

# --- one file ---------------------------------------------------------------------------

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
    Side | None, BeforeValidator(lambda value: None if value in ("", "0", 0) else value)
]


class _LabelmeFile(Imported):
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
            document = _LabelmeFile.model_validate_json(data)
        else:
            document = _LabelmeFile.model_validate(_xml_values(data), strict=False)
        rows, columns = document.imageHeight or size[0], document.imageWidth or size[1]
        if (rows, columns) != size:
            picture = f"its picture has {size[1]} by {size[0]}"
            raise ValueError(f"it is for {columns} by {rows} pixels, {picture}")
        shapes = [shape for shape in document.shapes if shape.shape_type not in WITHOUT_AREA]
        return [_drawing(shape, size) for shape in shapes]


def _xml_values(data: bytes) -> dict[str, Any]:
    """LabelMe's XML as the values of a labelme file: the polygons of the objects not deleted."""
    root = ElementTree.fromstring(data)
    if root.tag != "annotation":
        raise ValueError(f"not a LabelMe annotation: its root element is {root.tag!r}")
    return {
        "shapes": [shape for element in root.findall("object") for shape in _xml_shapes(element)],
        "imageHeight": root.findtext("imagesize/nrows", "").strip(),
        "imageWidth": root.findtext("imagesize/ncols", "").strip(),
    }


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


def _drawing(shape: _Shape, size: tuple[int, int]) -> Drawing:
    """What a shape with an area draws; ValueError for one that is none, or far outside."""
    points = np.array(shape.points, np.float64).reshape(-1, 2)
    match shape.shape_type or "polygon", len(points):
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
            fill = _stamp(shape, points.astype(int))
        case kind, count:
            raise ValueError(f"a shape {shape.label!r} of type {kind!r} with {count} points")
    (left, top), (right, bottom) = points.min(0), points.max(0)
    beside = max(-left, right - size[1]) > MAX_OVERHANG * size[1]
    if beside or max(-top, bottom - size[0]) > MAX_OVERHANG * size[0]:
        raise ValueError(
            f"an object {shape.label!r} from ({left:g}, {top:g}) to ({right:g}, {bottom:g}), "
            f"far outside its picture of {size[1]} by {size[0]}"
        )
    return Drawing(shape.label, shape.username, fill)


def _stamp(shape: _Shape, points: np.ndarray) -> Fill:
    """A mask shape: PNG or JPEG as base64, filling the box from its first to its last corner."""
    (left, top), (right, bottom) = points.min(0).tolist(), points.max(0).tolist()
    box = (right - left + 1, bottom - top + 1)
    try:
        data = base64.b64decode(shape.mask or "", validate=True)
        with open_picture(data, MASK_FORMATS) as picture:
            if picture.size == box:
                return partial(fill_stamp, left, top, np.asarray(picture.convert("L")) > 0)
            message = f"is {picture.width} by {picture.height}, its box {box[0]} by {box[1]}"
    except Exception as problem:  # Pillow raises anything
        message = f"cannot be decoded: {problem}"
    raise ValueError(f"a mask {shape.label!r} that {message}")


def labelme_document(
    labels: np.ndarray, picture: str, names: Sequence[str] = NAMES, ground: int = 0
) -> dict[str, Any]:
    """The outlines of labels (H,W) as the program labelme stores them; of a mask bool as well.

    picture: the file name of the picture, which belongs beside the annotation. names: of the
    labels. ground: as in ``outlines``.
    """
    height, width = labels.shape
    shapes = [
        {
            "label": names[outline.label],
            "points": outline.points.tolist(),
            "group_id": None,
            "description": "",
            "shape_type": "polygon",
            "flags": {},
            "mask": None,
        }
        for outline in outlines(labels, ground)
    ]
    return {
        "version": "5.5.0",
        "flags": {},
        "shapes": shapes,
        "imagePath": picture,
        "imageData": None,
        "imageHeight": height,
        "imageWidth": width,
    }


# --- a set ------------------------------------------------------------------------------


@dataclass(frozen=True)
class PolygonLabels:
    """The truth in annotations of polygons.

    road, void: names of objects, lower case; every other object is not road, and cuts a
    hole into what was drawn before it. agreement: when several people drew, a pixel is
    road if most of them say so, any or all. user: listen to this person alone. root: the
    folder below which people have folders of their own, if they do.
    Raises ConfigError for an unknown agreement.
    """

    road: tuple[str, ...] = ("road",)
    void: tuple[str, ...] = ("void", "ignore")
    agreement: Agreement = "majority"
    user: str | None = None
    root: Path | None = None

    def __post_init__(self) -> None:
        if self.agreement not in AGREEMENTS:
            known = f"known: {', '.join(AGREEMENTS)}"
            raise ConfigError(self.agreement, "unknown agreement", known)

    def truth(self, item: LabelledItem) -> Truth:
        """Read, draw and combine the item's annotations; DatasetError naming the file."""
        size = picture_size(item.image)
        by_user: dict[str, list[Drawing]] = {}
        for path in (item.label, *item.extra):
            owner = file_user(path, item.name, self.root)
            if owner:  # all of it is theirs, were it nothing
                by_user.setdefault(owner, [])
            for drawing in read_annotation(path, size):
                by_user.setdefault(owner or drawing.user, []).append(drawing)
        if self.user is not None and self.user not in by_user:
            remedy = f"it was annotated by {', '.join(sorted(by_user)) or 'nobody'}"
            raise DatasetError(item.label, f"has nothing from the user {self.user}", remedy)
        meanings = {**dict.fromkeys(self.void, VOID), **dict.fromkeys(self.road, ROAD)}
        people = [
            filled_shapes([(part.fill, meanings.get(part.name, OTHER)) for part in drawings], size)
            for user, drawings in by_user.items()
            if self.user in (None, user)
        ]
        return agree(people, size, self.agreement)


# --- sizes ------------------------------------------------------------------------------


def picture_size(path: Path) -> tuple[int, int]:
    """(height, width) of a picture as it is shown, from its header.

    Raises DatasetError when it cannot be opened.
    """
    try:
        with open_picture(read_regular(path)) as picture, without_warnings():
            turned = picture.getexif().get(ExifTag.Orientation) in TURNED
            return (picture.width, picture.height) if turned else (picture.height, picture.width)
    except Exception as problem:
        message = f"cannot be opened: {reason(problem)}"
        raise DatasetError(path, message, "replace the file") from None


# --- finding the files ------------------------------------------------------------------


def file_user(path: Path, name: str, root: Path | None) -> str:
    """Whose file an annotation of the picture ``name`` is; "" if the file does not say."""
    stem = PurePath(name).name
    if path.stem != stem:
        return path.stem.removeprefix(f"{stem}.")
    if root is None or not path.is_relative_to(root):
        return ""
    folders = path.relative_to(root).parts
    return folders[0] if len(folders) > len(PurePath(name).parts) else ""


def open_labelme(root: Path, split: str, agreement: Agreement = "majority") -> Dataset:
    """Pictures in ROOT/images or ROOT, annotations in ROOT/annotations or beside them.

    Folders may be nested, and LabelMe's capital letters (Images, Annotations) do as well. A
    picture's group is its uppermost folder. Raises DatasetError for a folder without
    pictures, a picture without annotation, and two files of one person for one picture.
    """
    images = _first_folder(root, "images", "Images") or root
    annotations = _first_folder(root, "annotations", "Annotations") or images
    pictures = _pictures(images)
    files = _files(annotations, set(pictures))
    missing = [name for name in pictures if name not in files]
    if missing:
        first = (annotations / missing[0]).with_name(f"{PurePath(missing[0]).name}.xml")
        counts = f"{len(missing)} of {len(pictures)} annotations in all"
        remedy = "every picture needs its annotation, be it empty"
        raise DatasetError(first, f"is missing, and so is .json, {counts}", remedy)
    items = []
    for name, picture in pictures.items():
        label, *extra = files[name]
        group = name.partition("/")[0] if "/" in name else None
        items.append(LabelledItem(name, picture, label, group, tuple(extra)))
    reader = PolygonLabels(agreement=agreement, root=annotations)
    name = "labelme" if agreement == "majority" else f"labelme:{agreement}"
    return Dataset(name, root, split, tuple(items), reader)


def _first_folder(root: Path, *names: str) -> Path | None:
    return next((root / name for name in names if (root / name).is_dir()), None)


def _pictures(folder: Path) -> dict[str, Path]:
    """Every picture below a folder by its relative name without ending, sorted."""
    pictures: dict[str, Path] = {}
    for path in filter(is_picture, sorted(folder.rglob("*"))):
        first = pictures.setdefault(path.relative_to(folder).with_suffix("").as_posix(), path)
        if first != path:
            remedy = "a name may have one picture"
            raise DatasetError(path, f"has the name of {first.name}", remedy)
    if not pictures:
        raise DatasetError(folder, "holds no pictures", f"known endings: {' '.join(SUFFIXES)}")
    return pictures


def _files(folder: Path, pictures: set[str]) -> dict[str, list[Path]]:
    """The annotation files of each picture; files that belong to none are passed over."""
    files: dict[str, dict[str, Path]] = defaultdict(dict)
    for path in sorted(folder.rglob("*")):
        if path.suffix.lower() not in ENDINGS or path.name.startswith("."):
            continue
        stem = path.relative_to(folder).with_suffix("").as_posix()
        before_user = stem.rpartition(".")[0] if "." in PurePath(stem).name else stem
        possible = (stem, stem.partition("/")[2], before_user)
        name = next((name for name in possible if name in pictures), None)
        if name is not None:
            first = files[name].setdefault(file_user(path, name, folder), path)
            if first != path:
                message = f"and {first.name} are both for the picture {name}"
                raise DatasetError(path, message, "give people folders of their own, or drop one")
    return {name: list(by_user.values()) for name, by_user in files.items()}
