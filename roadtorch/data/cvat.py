"""CVAT's "Segmentation mask 1.1": one colour a class, and one colour an object.

    labelmap.txt                      name:red,green,blue:parts:actions
    ImageSets/Segmentation/default.txt   names of pictures, without ending
    SegmentationClass/NAME.png        RGB
    SegmentationObject/NAME.png       RGB, objects counted in Pascal VOC's colours

What CVAT stumbles over is not written: colours of objects are those that it counts itself (issues
5137, 6830), every connected part is an object of its own (7458), masks are RGB, so that no index is
taken for a class (7847), and ``background`` is black, and stands for what nobody touched (8995).
"""

from collections.abc import Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np
import torch
from pydantic import TypeAdapter, ValidationError

from roadtorch.data.correction_labels import LABELS, check_stems
from roadtorch.data.corrections import Correction
from roadtorch.data.imported import Byte, imported
from roadtorch.data.labels import colour_indices, read_colours
from roadtorch.errors import DatasetError
from roadtorch.io.atomic import make_folder, write_text
from roadtorch.io.image import write_colours

Colour = tuple[int, int, int]

BACKGROUND = "background"

COLOURS: Mapping[str, Colour] = {
    BACKGROUND: (0, 0, 0),
    "road": (128, 64, 128),
    "not_road": (220, 20, 60),
    "void": (96, 96, 96),
    "sky": (70, 130, 180),
    "vertical": (190, 153, 153),
    "horizontal": (152, 251, 152),
    "not_road_horizontal": (244, 35, 232),
}

LIST = Path("ImageSets/Segmentation/default.txt")


def voc_colour(number: int) -> Colour:
    """The colour of Pascal VOC's palette at a number: its bits, dealt to red, green and blue."""
    channels = [0, 0, 0]
    for place in range(8):
        for channel in range(3):
            channels[channel] |= (number >> (3 * place + channel) & 1) << (7 - place)
    return channels[0], channels[1], channels[2]


def write_cvat(corrections: Sequence[Correction], folder: Path) -> None:
    """Write corrections as a folder that, zipped, CVAT takes as "Segmentation mask 1.1"."""
    check_stems(one.name for one in corrections)
    make_folder(folder / LIST.parent)
    lines = ["# label:color_rgb:parts:actions"]
    lines += [f"{name}:{','.join(map(str, colour))}::" for name, colour in COLOURS.items()]
    write_text(folder / "labelmap.txt", "\n".join(lines) + "\n")
    table = np.array(list(COLOURS.values()), np.uint8)
    names = []
    for one in corrections:
        name = Path(one.name).with_suffix("").as_posix()
        names.append(name)
        _write_colours(folder / "SegmentationClass" / f"{name}.png", table[one.labels])
        _write_colours(folder / "SegmentationObject" / f"{name}.png", object_colours(one.labels))
    write_text(folder / LIST, "".join(f"{name}\n" for name in names))


def object_colours(labels: np.ndarray) -> np.ndarray:
    """Colours uint8 (H,W,3): every connected part in one of its own, counted from 1."""
    objects = np.zeros(labels.shape, np.int64)
    for number in range(1, len(LABELS)):
        _, parts = cv2.connectedComponents((labels == number).astype(np.uint8), connectivity=4)
        objects[parts > 0] = parts[parts > 0] + objects.max()
    return np.array([voc_colour(number) for number in range(objects.max() + 1)], np.uint8)[objects]


def _write_colours(path: Path, colours: np.ndarray) -> None:
    make_folder(path.parent)
    write_colours(path, torch.from_numpy(colours).permute(2, 0, 1) / 255)


_COLOUR: TypeAdapter[Colour] = TypeAdapter(tuple[Byte, Byte, Byte])


def read_labelmap(path: Path) -> dict[Colour, str]:
    """The classes of a labelmap.txt by colour; DatasetError naming the line that is wrong."""
    found: dict[Colour, str] = {}
    with imported(path, "export from CVAT anew, or mend that line") as data:
        for number, line in enumerate(data.decode().splitlines(), start=1):
            if not line.strip() or line.startswith("#"):
                continue
            name, _, rest = line.partition(":")
            try:
                colour = _COLOUR.validate_python(tuple(rest.split(":")[0].split(",")))
            except ValidationError:
                raise ValueError(f"line {number} has no colour as red,green,blue") from None
            if colour in found:
                raise ValueError(f"line {number} has the colour of {found[colour]}")
            found[colour] = name.strip()
    return found


def read_cvat_mask(path: Path, classes: Mapping[Colour, str], size: tuple[int, int]) -> np.ndarray:
    """The labels uint8 (H,W) of SegmentationClass/NAME.png, for a picture of this size.

    Raises DatasetError for another size, for unknown colours, which are named and their pixels
    counted, and for a class that is used and has none of our names.
    """
    known = tuple(classes) if (0, 0, 0) in classes else (*classes, (0, 0, 0))
    indices = colour_indices(read_colours(path, size), known, path)
    numbers = np.zeros(len(known), np.uint8)
    for place in np.unique(indices).tolist():
        name = classes.get(known[place], BACKGROUND)
        if name != BACKGROUND and name not in LABELS:
            what = f"has the class {name!r}, which says nothing about the road"
            raise DatasetError(path, what, f"name it one of {', '.join(LABELS[1:])}")
        numbers[place] = 0 if name == BACKGROUND else LABELS.index(name)
    return numbers[indices]
