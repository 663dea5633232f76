"""Label Studio's tasks: labels as predictions with brush masks, and back from annotations.

tasks.json          a list of tasks, for the import button
label_config.xml    the labelling interface that they are for
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np

from roadtorch.data.correction_labels import LABELS
from roadtorch.data.corrections import Correction
from roadtorch.data.cvat import COLOURS
from roadtorch.data.polygons import Polygon
from roadtorch.errors import DatasetError
from roadtorch.io.atomic import make_folder, write_text
from roadtorch.io.bounded import read_regular

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


def read_label_studio(path: Path, sizes: Mapping[str, tuple[int, int]]) -> dict[str, np.ndarray]:
    """Labels uint8 (H,W) by the name of the picture, for those that are in ``sizes``.

    path: of a folder with tasks.json, or of a file of any name. A task is for the picture whose
    name its image ends with. What people annotated last counts, else the prediction. Raises
    DatasetError for what is no list of tasks, for a region that does not fit its picture, and for
    a label that is none of ours.
    """
    path = path / TASKS if path.is_dir() else path
    try:
        tasks = json.loads(read_regular(path))
    except OSError as problem:
        raise DatasetError(path, f"cannot be read: {problem.strerror}", "export it anew") from None
    except (ValueError, RecursionError) as problem:
        raise DatasetError(path, f"is not JSON: {problem}", "export it anew") from None
    if not isinstance(tasks, list) or not all(isinstance(task, dict) for task in tasks):
        raise DatasetError(path, "is no list of tasks", "export as JSON from Label Studio")
    found = {}
    for task in tasks:
        # Uploads carry a prefix: /data/upload/3/1f2e3d4c-NAME.
        image = unquote(str((task.get("data") or {}).get("image", "")))
        fitting = [name for name in sizes if image.endswith(name)]
        if fitting:
            name = max(fitting, key=len)
            found[name] = _task_labels(task, sizes[name], path, name)
    return found


def _task_labels(
    task: Mapping[str, Any], size: tuple[int, int], path: Path, name: str
) -> np.ndarray:
    labels = np.zeros(size, np.uint8)
    said = task.get("annotations") or task.get("predictions") or [{}]
    for region in said[-1].get("result") or []:
        kind = region.get("type")
        if kind not in REGIONS:
            continue
        value = region.get("value") or {}
        label = ([*(value.get(kind) or []), ""])[0]
        if label not in LABELS[1:]:
            what = f"has the label {label!r} on {name}, which says nothing about the road"
            raise DatasetError(path, what, f"name it one of {', '.join(LABELS[1:])}")
        shape = (region.get("original_height"), region.get("original_width"))
        if shape != size:
            what = f"is for {shape[1]} by {shape[0]} pixels on {name}"
            raise DatasetError(path, what, f"the picture has {size[1]} by {size[0]}")
        _paint(labels, LABELS.index(label), kind, value, (path, name))
    return labels


def _paint(
    labels: np.ndarray, number: int, kind: str, value: Mapping[str, Any], where: tuple[Path, str]
) -> None:
    """Paint one region; polygons are in percent of the picture's sides."""
    height, width = labels.shape
    try:
        if kind == "brushlabels":
            labels[unpacked_mask(value["rle"], (height, width))] = number
            return
        percent = np.array(value["points"], np.float64).reshape(-1, 2)
        Polygon(percent.clip(-100, 200) * [width / 100, height / 100]).fill(labels, number)
    except (KeyError, ValueError, TypeError, OverflowError) as problem:
        what = f"has a region on {where[1]} that cannot be read: {problem}"
        raise DatasetError(where[0], what, "export it anew") from None


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
    bits = _Bits(data)
    count, word = bits.read(32), bits.read(5) + 1
    sizes = [bits.read(4) + 1 for _ in SIZES]
    if count != size[0] * size[1] * CHANNELS:
        raise ValueError(f"{count} values, not those of {size[1]} by {size[0]} pixels")
    values = np.zeros(count, np.uint32)
    place = 0
    while place < count:
        is_run = bits.read(1)
        length = bits.read(sizes[bits.read(2)]) + 1
        end = min(place + length, count)
        if is_run:
            values[place:end] = bits.read(word)
        else:
            values[place:end] = [bits.read(word) for _ in range(end - place)]
        place = end
    return values.reshape(*size, CHANNELS)[..., -1] > 0


class _Bits:
    """A reader of bits, high ones first."""

    def __init__(self, data: Sequence[int]) -> None:
        self._text = (np.unpackbits(np.array(data, np.uint8)) + ord("0")).tobytes().decode()
        self._place = 0

    def read(self, count: int) -> int:
        """The next bits as a number; ValueError at the end."""
        end = self._place + count
        if end > len(self._text):
            raise ValueError("the data ends too early")
        value = int(self._text[self._place : end], 2)
        self._place = end
        return value
