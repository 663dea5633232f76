"""Label Studio's tasks: labels as predictions with brush masks, and back from annotations.

tasks.json          a list of tasks, for the import button
label_config.xml    the labelling interface that they are for
"""

import io
import json
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path, PurePosixPath
from typing import Annotated, Any
from urllib.parse import unquote

import numpy as np
from pydantic import Field, TypeAdapter

from roadtorch.data.correction_labels import LABELS
from roadtorch.data.corrections import Correction
from roadtorch.data.cvat import COLOURS
from roadtorch.data.imported import Byte, Imported, Side, imported
from roadtorch.data.polygons import fill_polygon
from roadtorch.errors import shortened
from roadtorch.io.atomic import make_folder, write_text

TASKS, CONFIG = "tasks.json", "label_config.xml"

REGIONS = ("brushlabels", "polygonlabels")

SIZES = (3, 4, 8, 16)  # bits of a count in packed masks
WORD, CHANNELS = 8, 4


def write_label_studio(corrections: Sequence[Correction], folder: Path) -> None:
    """Write the tasks and the interface; the picture of a task is its name in the folder."""
    make_folder(folder)
    tasks = [
        {
            "data": {"image": one.name},
            "predictions": [{"model_version": "roadtorch", "result": list(_results(one.labels))}],
        }
        for one in corrections
    ]
    write_text(folder / TASKS, json.dumps(tasks) + "\n")
    lines = [
        f'    <Label value="{name}" background="#{"".join(f"{c:02x}" for c in COLOURS[name])}"/>'
        for name in LABELS[1:]
    ]
    head, tail = '  <BrushLabels name="label" toName="image">', "  </BrushLabels>"
    picture = '  <Image name="image" value="$image" zoom="true"/>'
    write_text(folder / CONFIG, "\n".join(["<View>", picture, head, *lines, tail, "</View>", ""]))


def _results(labels: np.ndarray) -> Iterator[dict[str, Any]]:
    """One brush region for each label that occurs; holes and several parts are in its mask."""
    height, width = labels.shape
    for number, name in enumerate(LABELS):
        if number and (mask := labels == number).any():
            yield {
                "id": f"roadtorch-{name}",
                "type": "brushlabels",
                "from_name": "label",
                "to_name": "image",
                "original_width": width,
                "original_height": height,
                "image_rotation": 0,
                "value": {"format": "rle", "rle": packed_mask(mask), "brushlabels": [name]},
            }


# --- back ---------------------------------------------------------------------------------

Percent = Annotated[float, Field(ge=-100, le=200)]  # of a side; what sticks out is cut off
Names = Annotated[tuple[str, ...], Field(max_length=1)]


class _Value(Imported):
    rle: tuple[Byte, ...] | None = None
    points: tuple[tuple[Percent, Percent], ...] | None = Field(default=None, min_length=1)
    brushlabels: Names = ()
    polygonlabels: Names = ()


class _Region(Imported):
    type: str = ""
    original_height: Side | None = None
    original_width: Side | None = None
    value: _Value = _Value()


class _Annotation(Imported):
    result: tuple[_Region, ...] = ()
    was_cancelled: bool = False


class _Picture(Imported):
    image: str = ""


class _Task(Imported):
    data: _Picture = _Picture()
    annotations: tuple[_Annotation, ...] = ()
    predictions: tuple[_Annotation, ...] = ()


_TASKS: TypeAdapter[tuple[_Task, ...]] = TypeAdapter(tuple[_Task, ...])

_UPLOAD = re.compile(r".*/upload/\d+/[0-9a-f]{8}-([^/]+)")
"""Where the program keeps what was uploaded; sub-folders are lost there."""


def read_label_studio(path: Path, sizes: Mapping[str, tuple[int, int]]) -> dict[str, np.ndarray]:
    """Labels uint8 (H,W) by the name of the picture, for those that are in ``sizes``.

    path: of a folder with tasks.json, or of a file of any name. What people annotated last
    counts, else the prediction. Raises DatasetError for what is no list of tasks, without one for
    any of the pictures, for two tasks of one picture, for a region that does not fit its picture,
    and for a label that is none of ours.
    """
    path = path / TASKS if path.is_dir() else path
    found, images = {}, {}
    with imported(path, "export it anew from Label Studio, as JSON") as data:
        for task in _TASKS.validate_json(data, strict=True):
            image = task.data.image
            if (name := _picture_of(image, sizes)) is None:
                continue
            if images.setdefault(name, image) != image:
                raise ValueError(
                    f"{shortened(images[name])} and {shortened(image)} are both {name}"
                )
            said = [one for one in task.annotations if not one.was_cancelled] or task.predictions
            labels = found[name] = np.zeros(sizes[name], np.uint8)
            for region in said[-1].result if said else ():
                if region.type in REGIONS:
                    _paint(labels, region, name)
        if not found:
            raise ValueError("no task is for any of the pictures")
    return found


def _picture_of(image: str, names: Collection[str]) -> str | None:
    """The picture that a task's address ends with, whole parts of its path; None without one.

    ValueError for an upload that could be either of two pictures.
    """
    path = unquote(image)
    parts = re.split(r"[/=]", path)  # /data/local-files/?d=folder/NAME
    ends = ("/".join(parts[at:]) for at in range(len(parts)))
    if (name := next((end for end in ends if end in names), None)) is not None:
        return name
    if (upload := _UPLOAD.fullmatch(path)) is None:
        return None
    fitting = [name for name in names if PurePosixPath(name).name == upload[1]]
    if len(fitting) > 1:
        raise ValueError(f"the upload {upload[1]} could be {' or '.join(sorted(fitting)[:2])}")
    return fitting[0] if fitting else None


def _paint(labels: np.ndarray, region: _Region, name: str) -> None:
    """Paint one region into labels (H,W); polygons are in percent of the picture's sides."""
    height, width = labels.shape
    value = region.value
    label = next(iter(getattr(value, region.type)), "")
    if label not in LABELS[1:]:
        known = ", ".join(LABELS[1:])
        raise ValueError(f"the label {label!r} on {name} says nothing about the road: use {known}")
    if (region.original_height, region.original_width) != (height, width):
        told = f"a region is for {region.original_width} by {region.original_height} pixels"
        raise ValueError(f"{told}, {name} has {width} by {height}")
    if region.type == "polygonlabels" and value.points:
        corners = np.array(value.points) * [width / 100, height / 100]
        fill_polygon(corners, labels, LABELS.index(label))
    elif region.type == "brushlabels" and value.rle is not None:
        labels[unpacked_mask(value.rle, (height, width))] = LABELS.index(label)
    else:
        raise ValueError(f"a region on {name} is empty")


# --- brush masks ------------------------------------------------------------------------

# thi.ng/rle-pack over the bytes of an RGBA picture. Bits, high ones first: 32 how many values; 5
# bits of a value, less 1; four times 4: bits of a count, less 1; then packets: 1 whether a run, 2
# which of the four sizes, the count less 1, and the value (of a run) or the values. The mask is in
# the alpha channel; what we write has it in all four.


def packed_mask(mask: np.ndarray) -> list[int]:
    """The bytes of a mask bool (H,W) in this coding."""
    flat = np.repeat(mask.reshape(-1), CHANNELS)
    edges = np.flatnonzero(np.concatenate([[True], flat[1:] != flat[:-1], [True]]))
    bits = [f"{len(flat):032b}", f"{WORD - 1:05b}", *(f"{size - 1:04b}" for size in SIZES)]
    for start, length in zip(edges[:-1].tolist(), np.diff(edges).tolist(), strict=True):
        value = "1" * WORD if flat[start] else "0" * WORD
        while length:
            part = min(length, 2 ** SIZES[-1])
            place = next(i for i, size in enumerate(SIZES) if part <= 2**size)
            bits.append(f"1{place:02b}{part - 1:0{SIZES[place]}b}{value}")
            length -= part
    text = "".join(bits)
    text += "0" * (-len(text) % 8)
    return list(int(text, 2).to_bytes(len(text) // 8, "big"))


def unpacked_mask(data: Sequence[int], size: tuple[int, int]) -> np.ndarray:
    """The mask bool (H,W) of such bytes; ValueError where they are not, or of another size."""
    bits = io.BytesIO((np.unpackbits(np.array(data, np.uint8)) + ord("0")).tobytes())

    def read(count: int) -> int:
        if len(digits := bits.read(count)) < count:
            raise ValueError("the data ends too early")
        return int(digits, 2)

    count, word = read(32), read(5) + 1
    sizes = [read(4) + 1 for _ in SIZES]
    if count != size[0] * size[1] * CHANNELS:
        raise ValueError(f"{count} values, not those of {size[1]} by {size[0]} pixels")
    values = np.zeros(count, np.bool_)
    place = 0
    while place < count:
        is_run = read(1)
        length = read(sizes[read(2)]) + 1
        end = min(place + length, count)
        if is_run:
            values[place:end] = read(word) > 0
        else:
            values[place:end] = [read(word) > 0 for _ in range(end - place)]
        place = end
    return values.reshape(*size, CHANNELS)[..., -1]
