"""Import and export of corrections: label images, and COCO's JSON."""

import json
import re
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from pathlib import Path, PurePath, PurePosixPath
from typing import Annotated, NamedTuple
from unicodedata import normalize

import numpy as np
import torch
from pydantic import Discriminator, Field, Tag

from roadtorch.base.atomic import make_folder, write_text
from roadtorch.base.bounded import reason
from roadtorch.base.documents import Coordinate, ForeignDocument, Side, read_document
from roadtorch.base.errors import DatasetError
from roadtorch.base.image import write_labels
from roadtorch.data.corrections import Correction
from roadtorch.data.events import LABEL_NAMES, layout_layer, road_layer
from roadtorch.data.label_images import LabelPixels, read_labels
from roadtorch.data.polygons import coco_annotation, decode_counts, fill_area, unpack_counts

ImageSizes = Mapping[str, tuple[int, int]]  # (height, width) by relative name with extension


class CorrectionFormat(NamedTuple):
    """A file format in which other programs keep labels.

    read: returns labels uint8 (H, W) of the images that have any; raises DatasetError for files
    that cannot be read or do not fit the images.
    """

    write: Callable[[Sequence[Correction], Path], None]
    files: Callable[[Sequence[Correction]], list[str]]  # names of what ``write`` writes
    read: Callable[[Path, ImageSizes], dict[str, np.ndarray]]


def _require_unique_stems(names: Iterable[str]) -> None:
    """Raise DatasetError for two images whose names differ in the extension alone."""
    owners: dict[str, str] = {}
    for name in names:
        stem = PurePath(name).with_suffix("").as_posix()
        if (owner := owners.setdefault(stem, name)) != name:
            message = f"have one file, {stem}, in this format"
            raise DatasetError(f"{owner} and {name}", message, "rename one of the images")


# --- label images -----------------------------------------------------------------------


PNG_LAYERS = ("labels", "road", "layout")


def write_png(corrections: Sequence[Correction], folder: Path) -> None:
    """Write FOLDER/labels/NAME.png, and FOLDER/road and FOLDER/layout as data sets have them.

    Labels are indices in ``LABEL_NAMES``. In road 0 is not road, 1 road, 255 void or untouched; in
    layout 255 is unknown.
    """
    _require_unique_stems(correction.name for correction in corrections)
    for correction in corrections:
        road, layout = road_layer(correction.labels), layout_layer(correction.labels)
        layers = (correction.labels, np.where(road > 1, 255, road), layout)
        for layer, values in zip(PNG_LAYERS, layers, strict=True):
            path = (folder / layer / correction.name).with_suffix(".png")
            make_folder(path.parent)
            write_labels(path, torch.from_numpy(values))


def png_files(corrections: Sequence[Correction]) -> list[str]:
    """Return the names of the files of ``write_png``."""
    stems = [PurePath(correction.name).with_suffix(".png") for correction in corrections]
    return [(layer / stem).as_posix() for layer in map(PurePath, PNG_LAYERS) for stem in stems]


def read_png(path: Path, sizes: ImageSizes) -> dict[str, np.ndarray]:
    """Read labels uint8 (H, W) by image from PATH/labels/NAME.png.

    Raises DatasetError for other numbers or sizes, two images of one name, and an empty folder.
    """
    files = {name: (path / "labels" / name).with_suffix(".png") for name in sizes}
    present = {name: file for name, file in files.items() if file.is_file()}
    if not present:
        hint = "give the folder that holds the labels"
        raise DatasetError(path / "labels", "has no file for any of the images", hint)
    _require_unique_stems(present)
    labels = {name: read_labels(file, sizes[name]) for name, file in present.items()}
    for name, values in labels.items():
        if not np.isin(values, range(len(LABEL_NAMES))).all():
            message = f"has other values than 0 to {len(LABEL_NAMES) - 1}"
            hint = f"0 is {LABEL_NAMES[0]}, 1 {LABEL_NAMES[1]}, …"
            raise DatasetError(present[name], message, hint)
    return {name: values.astype(np.uint8) for name, values in labels.items()}


# --- COCO -------------------------------------------------------------------------------

# Labels are regions of seven categories, which CVAT and Label Studio read and write. A region is a
# list of polygons, of pixel edges: column x reaches from x to x + 1. Or it is a list of counts,
# pixels outside and inside in turn, column by column. Pixels without a region are untouched.

_COCO_FILE, NO_REGION, HINT = "coco.json", "no region", "export it again as COCO"

_UPLOAD = re.compile(r"[0-9a-f]{8}-(.+)")
"""File name of an image uploaded to Label Studio, which drops sub-folders."""


def write_coco_labels(corrections: Sequence[Correction], folder: Path) -> None:
    """Write FOLDER/coco.json with one region for each label of each image."""
    images, regions = [], []
    for image, correction in enumerate(corrections, 1):
        height, width = correction.labels.shape
        images.append({"id": image, "file_name": correction.name, "width": width, "height": height})
        for category in filter(None, np.unique(correction.labels).tolist()):
            mask = correction.labels == category
            regions.append(coco_annotation(mask, len(regions) + 1, image, category))
    categories = [
        {"id": number, "name": LABEL_NAMES[number], "supercategory": ""}
        for number in range(1, len(LABEL_NAMES))
    ]
    document = {
        "info": {"description": "corrections made with roadtorch"},
        "licenses": [],
        "categories": categories,
        "images": images,
        "annotations": regions,
    }
    make_folder(folder)
    write_text(folder / _COCO_FILE, json.dumps(document) + "\n")


class _CocoImage(ForeignDocument):
    id: int
    file_name: str
    height: Side
    width: Side


class _CocoCategory(ForeignDocument):
    id: int
    name: str


class _Counts(ForeignDocument):
    size: tuple[Side, Side] | None = None  # height, width
    counts: tuple[Annotated[int, Field(ge=0, lt=2**31)], ...] | str


_Polygons = tuple[Annotated[tuple[Coordinate, ...], Field(min_length=6)], ...]


class _CocoRegion(ForeignDocument):  # without its id: datumaro gives one to several
    image_id: int
    category_id: int
    segmentation: Annotated[
        Annotated[_Counts, Tag("counts")] | Annotated[_Polygons, Tag("polygons")],
        Discriminator(lambda value: "counts" if isinstance(value, dict) else "polygons"),
    ]


class _CocoFile(ForeignDocument):
    images: tuple[_CocoImage, ...]
    categories: tuple[_CocoCategory, ...]
    annotations: tuple[_CocoRegion, ...]


CocoRegions = list[tuple[_Counts | _Polygons, int]]
"""Regions of an image in a COCO file, each with its value; later ones cover earlier ones."""


def fill_regions(path: Path, name: str, size: tuple[int, int], regions: CocoRegions) -> LabelPixels:
    """Return values uint16 (H, W), 0 outside of all regions; DatasetError for a wrong region."""
    values = np.zeros(size, np.uint16)
    for segmentation, value in regions:
        try:
            mask = _region_mask(segmentation, size)
        except (ValueError, MemoryError) as error:
            raise DatasetError(path, f"cannot be read: {reason(error)}", HINT) from None
        if not mask.any():
            message = f"cannot be read: a region on {name} has no area"
            raise DatasetError(path, message, "draw it as a polygon, or delete it")
        values[mask] = value
    return LabelPixels(values)


def _region_mask(segmentation: _Counts | _Polygons, size: tuple[int, int]) -> np.ndarray:
    if isinstance(segmentation, _Counts):
        if segmentation.size not in (None, size):
            rows, columns = segmentation.size or (0, 0)
            raise ValueError(f"a region has {columns} by {rows} pixels, not {size[1]} by {size[0]}")
        counts = segmentation.counts
        return decode_counts(unpack_counts(counts) if isinstance(counts, str) else counts, size)
    mask = np.zeros(size, np.bool_)
    for polygon in segmentation:
        if len(polygon) % 2:
            raise ValueError(f"a polygon has {len(polygon)} coordinates, an odd number")
        mask |= fill_area(np.array(polygon).reshape(-1, 2), size)
    return mask


def read_coco_labels(path: Path, sizes: ImageSizes) -> dict[str, np.ndarray]:
    """Read labels uint8 (H, W) by the name of the image, as ``read_coco`` does.

    path: a folder with coco.json, or a file of any name. Raises DatasetError for a category that
    is not one of ``LABEL_NAMES``.
    """
    path = path / _COCO_FILE if path.is_dir() else path
    regions, (_, *categories) = read_coco(path, sizes)
    for category, image in categories:
        if category not in LABEL_NAMES[1:]:
            message = f"cannot be read: the category {category!r} on {image} is not a label"
            raise DatasetError(path, message, f"use {', '.join(LABEL_NAMES[1:])}")
    labels = np.array([0, *(LABEL_NAMES.index(category) for category, _ in categories)], np.uint8)
    return {
        name: labels[fill_regions(path, name, sizes[name], part).values]
        for name, part in regions.items()
    }


def read_coco(
    path: Path, sizes: ImageSizes
) -> tuple[dict[str, CocoRegions], list[tuple[str, str]]]:
    """Read the regions of the images of ``sizes`` that a COCO file lists, by their name.

    Returns also the category of each value, and the first image with it. Raises DatasetError for a
    file that is no COCO, one without an image of ``sizes``, two entries for one image or id of an
    image or category, an image of another size, and a region on an image or of a category that is
    not listed.
    """
    with read_document(path, HINT) as data:
        document = _CocoFile.model_validate_json(data)
        _require_unique_ids("images", [image.id for image in document.images])
        _require_unique_ids("categories", [category.id for category in document.categories])
        listed, names = {image.id for image in document.images}, dict[int, str]()
        for image in document.images:
            if (name := match_image_name(image.file_name, sizes)) is None:
                continue
            if name in names.values():
                raise ValueError(f"two entries are for {name}")
            if (image.height, image.width) != sizes[name]:
                raise ValueError(
                    f"{name} is for {image.width} by {image.height} pixels, "
                    f"its image has {sizes[name][1]} by {sizes[name][0]}"
                )
            names[image.id] = name
        if not names:
            raise ValueError("it lists none of the images")
        regions: dict[str, CocoRegions] = {name: [] for name in names.values()}
        used = {NO_REGION: ""}
        categories = {category.id: category.name for category in document.categories}
        for region in document.annotations:
            if region.image_id not in listed:
                raise ValueError(f"a region is on image {region.image_id}, which is not listed")
            if (name := names.get(region.image_id)) is not None:
                if (category := categories.get(region.category_id)) is None:
                    number = region.category_id
                    raise ValueError(
                        f"a region on {name} has category {number}, which is not listed"
                    )
                used.setdefault(category, name)
                regions[name].append((region.segmentation, list(used).index(category)))
    return regions, list(used.items())


def _require_unique_ids(part: str, ids: Iterable[int]) -> None:
    counts = Counter(ids)
    if twice := [number for number, count in counts.items() if count > 1]:
        raise ValueError(f"{part} have the id {twice[0]} {counts[twice[0]]} times")


def match_image_name(file: str, names: Collection[str]) -> str | None:
    """Return the image whose name is the end of a file's path, in whole parts; None without one.

    Raises ValueError for an upload to Label Studio that could be either of two images.
    """
    parts = re.split(r"[/\\]", file)
    endings = ["/".join(parts[start:]) for start in range(len(parts))]
    if (name := next((ending for ending in endings if ending in names), None)) is not None:
        return name
    spellings = {} if file.isascii() else {normalize("NFC", name): name for name in names}
    composed = (spellings.get(normalize("NFC", ending)) for ending in endings)
    if (name := next(filter(None, composed), None)) is not None:
        return name
    if (upload := _UPLOAD.fullmatch(parts[-1])) is None:
        return None
    candidates = sorted(name for name in names if PurePosixPath(name).name == upload[1])
    if len(candidates) > 1:
        raise ValueError(f"the upload {upload[1]} could be {' or '.join(candidates[:2])}")
    return candidates[0] if candidates else None


CORRECTION_FORMATS: Mapping[str, CorrectionFormat] = {
    "png": CorrectionFormat(write_png, png_files, read_png),
    "coco": CorrectionFormat(write_coco_labels, lambda _: [_COCO_FILE], read_coco_labels),
}
