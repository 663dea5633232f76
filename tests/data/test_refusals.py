"""Errors of labelled sets that users meet: a row for each mistake.

tests/fuzz/test_refusals.py checks that every other file is refused in one line.
"""

import json
import re
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from roadtorch.base.errors import ConfigError, DatasetError, InputError, RoadtorchError
from roadtorch.data.catalogue import open_dataset
from roadtorch.data.correction_formats import CORRECTION_FORMATS
from roadtorch.data.corrections import read_corrections
from roadtorch.data.dataset import LabelledItem, leave_out
from roadtorch.data.kitti_road import use_birds_eye_view
from roadtorch.data.label_images import ColourLabels, NumberLabels, pair_files
from tests.data.conftest import Content, read_likelihood_map, write

Files = Mapping[str, Content]
Read = Callable[[Path], object]
Rows = Sequence[tuple[Read, Files, str, str]]
"""Reader, files of its folder, end of the error's ``where``, and pattern of its message."""

# --- label images ---------------------------------------------------------------------

NUMBERS = NumberLabels(road=(1, 5), void=(9,), values=(0, 1, 5, 7, 9))
COLOURS = ColourLabels(
    colours=((0, 0, 0), (255, 0, 255), (1, 2, 3)),
    numbers=NumberLabels(road=(1,), void=(2,), values=(0, 1, 2)),
)


def truth(reader: NumberLabels | ColourLabels, folder: Path) -> object:
    return reader.truth(LabelledItem("a", folder / "a.png", folder / "a.png"))


def grey(*values: int, kind: type = np.uint8) -> np.ndarray:
    return np.array([values], kind)


BLACK = np.zeros((1, 1, 3), np.uint8)
GREEN = np.array([3, 9, 1], np.uint8)


def pairs(root: Path) -> object:
    return [*pair_files(root / "images", root / "labels", "_L.png")]


LABEL_IMAGES: Rows = [
    (partial(truth, NUMBERS), {"a.png": grey(0, 3, 77, 77, 255)}, "a.png", r"77 \(2 .*known: 0,"),
    (partial(truth, NUMBERS), {"a.png": BLACK + GREEN}, "a.png", "a colour image"),
    (partial(truth, COLOURS), {"a.png": BLACK + GREEN}, "a.png", r"values #030901 \(1 pixels\)"),
    (pairs, {"images/a.png": BLACK, "images/b.jpg": BLACK, "labels/x": ""}, "a_L.png", "2 of 2"),
    (
        pairs,
        {"images/a.png": BLACK, "images/a.bmp": BLACK, "labels/a_L.png": BLACK},
        "a.png",
        "bmp",
    ),
]

# --- sets -------------------------------------------------------------------------------


def first_truth(name: str, folder: Path) -> object:
    dataset = open_dataset(name, folder)
    return dataset.read(dataset.items[0])


FRAME = {"images/0016E5_00390.png": BLACK, "labels/0016E5_00390_L.png": BLACK}
STREET = {"images/street_1.png": BLACK, "labels/street_1_L.png": BLACK}
KITTI = {"image_2/um_000000.png": BLACK, "gt_image_2/um_road_000000.png": BLACK}
WIDE = np.zeros((2, 3), np.uint8)

SETS: Rows = [
    (partial(open_dataset, "camvid32"), {}, "", "no CamVid in 32 colours .*LabeledApproved_full"),
    (partial(open_dataset, "camvid", split="test"), {"train/a.png": BLACK}, "testannot", "exist"),
    (partial(open_dataset, "camvid32", split="test"), FRAME, "", "no images of the split test"),
    (partial(open_dataset, "camvid32"), FRAME | STREET, "street_1", "of a CamVid frame"),
    (partial(first_truth, "idd-lite"), {"images/a.png": WIDE, "labels/a.png": BLACK[..., 0]},
     "a.png", "is 1 by 1 .* 3 by 2"),
    (partial(first_truth, "folder"),
     {"images/a.png": WIDE[:1, :2], "road/a.png": grey(0, 1), "layout/a.png": grey(0, 1, 2)},
     "layout/a.png", "has 3 by 1 .*2 by 1"),
    (partial(open_dataset, "cityscapes"), {"leftImg8bit/val/x": "", "gtFine/val/x": ""},
     "leftImg8bit/val", r"holds no images CITY/\*_leftImg8bit\.png"),
    (partial(open_dataset, "kitti-road"), {**KITTI, "image_2/thumb.png": BLACK}, "thumb", "KITTI"),
    (lambda folder: use_birds_eye_view(open_dataset("kitti-road", folder)), KITTI, "calib", ""),
]  # fmt: skip

# --- tables of conditions ---------------------------------------------------------------

CAMERAS = {f"{name}/{part}/{file}.png": BLACK for name, file in ("na", "fa", "fb")
           for part in ("images", "masks")}  # fmt: skip
TABLE = "name,file,condition\nn,a.png,day\nf,b.png,night\n"

CONDITIONS: Rows = [
    (partial(open_dataset, "folder"), {**CAMERAS, "pictures.csv": text}, where, problem)
    for text, where, problem in [
        ("name,file\nn,a.png\n", "csv", r"has no column condition \(its first line must name"),
        (TABLE + "f,a.jpg,day\n", "line 4", r"there is no image f/a.jpg \(did.*f/a.png"),
        (TABLE + "f,b.png,day\n", "line 4", r"names f/b.png a second time \(keep one"),
        (TABLE + "f,a.png,day,rain\n", "line 4", r"has more cells than the header \(quote"),
        (TABLE + 'f,a.png,"day\n', "csv", r"cannot be read: unexpected end of data"),
    ]
]

# --- corrections ------------------------------------------------------------------------


def read_format(name: str, folder: Path) -> object:
    return CORRECTION_FORMATS[name].read(folder, {"a.jpg": (1, 2)})


def coco(changes: Mapping[str, object] | None = None, **more: object) -> str:
    """Return a COCO file for the image a.jpg of two pixels, with or without a region."""
    image = {"id": 1, "file_name": "a.jpg", "height": 1, "width": 2}
    region = {"image_id": 1, "category_id": 1, "segmentation": [[0, 0, 1, 0, 1, 1]]}
    parts = {
        "images": [image],
        "categories": [{"id": 1, "name": "road"}, {"id": 2, "name": "cat"}],
        "annotations": [] if changes is None else [region | {**changes}],
    }
    return json.dumps(parts | more)


def image(file: str, **more: object) -> dict[str, object]:
    return {"id": 7, "file_name": file, "height": 1, "width": 2} | more


COCO: Rows = [
    (partial(read_format, "coco"), {"coco.json": text}, "coco.json", problem)
    for text, problem in [
        (coco(images=[image("other.jpg")]), "lists none of the images"),
        (coco(images=[image("1/a.jpg"), image("2/a.jpg", id=8)]), r"two entries are for a\.jpg"),
        (coco(images=[image("a.jpg", width=3)]), r"a\.jpg is for 3 by 1 pixels, .* has 2 by 1"),
        (coco({"category_id": 2}), r"category 'cat' on a\.jpg is not a label \(use road"),
        (coco({"category_id": 3}), "a region on a.jpg has category 3, which is not listed"),
        (coco({"segmentation": [[0, 0, 0, 0, 0, 0]]}), r"a region on a\.jpg has no area"),
        (coco({"segmentation": []}), r"a region on a\.jpg has no area"),  # a box
        (coco({"segmentation": [[0, 0, 1, 0, 1, 1, 1]]}), "7 coordinates, an odd number"),
        (coco(images=[image("a.jpg"), image("b.jpg")]), "images have the id 7 2 times"),
        (coco(categories=[{"id": 1, "name": name} for name in ("road", "sky")]),
         "categories have the id 1 2 times"),
        (coco({"image_id": 2}), "a region is on image 2, which is not listed"),
        (coco({"segmentation": {"counts": [0, 2], "size": [2, 1]}}),
         "a region has 1 by 2 pixels, not 2 by 1"),
        (coco({"segmentation": {"counts": "1"}}), "1 pixels are counted, not 2 by 1"),
        (coco({"segmentation": {"counts": "é"}}), "counts have 'é', which pycocotools does not"),
        (coco({"segmentation": {"counts": "0P"}}), "compressed counts are cut short"),
        (coco({"segmentation": {"counts": "O"}}), "compressed counts have a negative one"),
    ]
]  # fmt: skip

LOG, HEAD = "a.jpg.strokes.jsonl", {"image": "a", "height": 1, "width": 1}
IMPORT = {"kind": "import", "id": "a", "labels": {"road": [0, 1]}}


def log(*lines: Mapping[str, object]) -> str:
    return "".join(json.dumps(line) + "\n" for line in lines)


LOGS: Rows = [
    (read_corrections, {LOG: text}, where, problem)
    for text, where, problem in [
        (log(HEAD | {"height": 10**6, "width": 10**6}), LOG, "more than 100 megapixels"),
        (log({"roadtorch": 1, **HEAD}) + "nonsense\n", f"{LOG}:2", "is not a correction event"),
        *((log(HEAD) + text + "\n", f"{LOG}:2", "is not a correction event")
          for text in (
              '{"kind":"brush","id":"a","label":"rode","points":[[1,2]],"radius":1}',
              '{"kind":"brush","id":"a/../b","label":"road","points":[[1,2]],"radius":1}',
              '{"kind":"polygon","id":"a","label":"road","points":[[1,2],[NaN,3],[4,5]]}',
              '{"kind":"undo","id":"a","of":"b","extra":1}',
              f'{{"kind":"confirm","id":"a","counts":[{2**70},1]}}',
              '{"kind":"import","id":"a","labels":{"cat":[0,1]}}',
          )),
        (log(HEAD, IMPORT | {"labels": {"road": [0, 9]}}), LOG, "an event that does not fit"),
        ("", "", "holds no corrections"),
    ]
] + [
    (lambda folder: read_corrections(folder / "missing"), {}, "missing", "is not a folder"),
    (partial(read_format, "png"), {"labels/a.png": grey(8, 7)}, "a.png", "values than 0 to 7"),
    (partial(read_format, "png"), {"labels/a.png": grey(0, 0, 0)}, "a.png", "3 by 1 .*2 by 1"),
    (partial(read_format, "png"), {}, "", "has no file for any of the images"),
]  # fmt: skip

# --- maps -------------------------------------------------------------------------------

RAMP = np.linspace(0, 1, 24).reshape(4, 6)
BYTES = (RAMP * 255).astype(np.uint8)


def read_map(folder: Path) -> object:
    return read_likelihood_map(folder, ["m"], [(4, 6)])


MAPS: Rows = [
    (read_map, {"m.npy": content}, "m.npy", problem)
    for content, problem in [
        (np.where(RAMP > 0.9, np.nan, RAMP), "holds NaN"),
        (RAMP * 1.5, r"has values from 0 to 1\.5"),
        (RAMP[:3], r"is 6 by 3 pixels \(it should be 6 by 4\)"),
        (RAMP * 1j, r"holds complex128 of shape \(4, 6\)"),
        (np.where(RAMP > 0.9, -1, 5), "has values from -1 to 5"),
        (np.where(RAMP > 0.9, 70_000, 0), "has values from 0 to 70000"),
    ]
] + [
    (read_map, {}, "m.png", "is missing"),
    (read_map, {"m.png": BYTES, "m.npy": 1 - RAMP}, "m.npy", r"differs from m\.png"),
]


OPTIONS: Rows = [
    (partial(open_dataset, "camvid", split="trian"), {}, "trian", "split of camvid .*train"),
    (partial(open_dataset, "camvid32", road=["1"]), FRAME, "--road", "is not for the set"),
    (lambda folder: use_birds_eye_view(open_dataset("camvid32", folder)), FRAME, "camvid32", ""),
    *((lambda folder, part=part, groups=groups: leave_out(open_dataset("folder", folder / part),
       groups), CAMERAS, where, problem)
      for part, groups, where, problem in [
          (".", ["nn"], "nn", r"unknown group of folder \(did you mean n"),
          (".", ["n", "f"], "--leave-out", "leaves out every group"),
          ("f", ["f"], "--leave-out", "which has no groups"),
      ]),
    (lambda _: NumberLabels((2,), (), (0, 1)), {}, "NumberLabels", "not among its values"),
    (lambda _: NumberLabels((1,), (1,), (0, 1)), {}, "NumberLabels", "is road and void"),
]  # fmt: skip

REFUSALS = [
    *((DatasetError, row) for row in (*LABEL_IMAGES, *SETS, *CONDITIONS, *COCO, *LOGS)),
    *((InputError, row) for row in MAPS),
    *((ConfigError, row) for row in OPTIONS),
]


@pytest.mark.parametrize(
    ("kind", "row"), REFUSALS, ids=[f"{row[2]}: {row[3]}"[:60] for _, row in REFUSALS]
)
def test_a_mistake_is_refused_with_its_name(
    kind: type[RoadtorchError], row: tuple[Read, Files, str, str], tmp_path: Path
) -> None:
    read, files, where, problem = row
    for name, content in files.items():
        write(tmp_path / name, content)

    with pytest.raises(kind) as caught:
        read(tmp_path)

    error = caught.value
    assert type(error) is kind
    assert error.where.endswith(where)
    assert re.search(problem, f"{error.problem} ({error.hint})")
