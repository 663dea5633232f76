"""What cannot be read is refused in one line that names the file: a table for all readers."""

import io
import json
import re
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from roadtorch.base.errors import ConfigError, DatasetError, InputError, RoadtorchError
from roadtorch.data.catalogue import open_dataset
from roadtorch.data.correction_formats import FORMATS
from roadtorch.data.corrections import read_corrections
from roadtorch.data.dataset import LabelledItem
from roadtorch.data.kitti import birds_eye
from roadtorch.data.labels import ColourLabels, NumberLabels, pairs
from roadtorch.data.maps import map_likelihood, parse_maps
from tests.data.conftest import Content, write

Files = Mapping[str, Content]
Read = Callable[[Path], object]
Rows = Sequence[tuple[Read, Files, str, str]]
"""The reader, the files of its folder, where something is wrong (the end of it), and what."""

# --- label pictures ---------------------------------------------------------------------

NUMBERS = NumberLabels(road=(1, 5), void=(9,), values=(0, 1, 5, 7, 9))
COLOURS = ColourLabels(
    colours=((0, 0, 0), (255, 0, 255), (1, 2, 3)),
    numbers=NumberLabels(road=(1,), void=(2,), values=(0, 1, 2)),
)


def truth(reader: NumberLabels | ColourLabels, folder: Path) -> object:
    return reader.truth(LabelledItem("a", folder / "a.png", folder / "a.png"))


def grey(*values: int, kind: type = np.uint8) -> np.ndarray:
    return np.array([values], kind)


STRANGE = np.zeros((4, 4, 3), np.uint8)
STRANGE[0, :2], STRANGE[1] = (255, 0, 254), (3, 2, 1)
WHOLE = io.BytesIO()
Image.fromarray(np.arange(1600, dtype=np.uint8).reshape(40, 40)).save(WHOLE, "png")
BLACK = np.zeros((1, 1, 3), np.uint8)

LABEL_PICTURES: Rows = [
    (partial(truth, NUMBERS), {"a.png": picture}, "a.png", what)
    for picture, what in [
        (grey(0, 3, 77, 77, 255), r"values 77 \(2 pixels\), 3 \(1 pixels\), 255 "),
        (grey(*range(20, 30)), r"24 \(1 pixels\) and 5 others \(known: 0, 1, 5, 7, 9"),
        (grey(0, 257, 5, kind=np.uint16), r"unknown values 257 \(1 pixels\)"),
        (np.array([[(255, 0, 255)]], np.uint8), "is a colour picture"),
        (np.array([[(255, 255, 255, 0)]], np.uint8), "is a colour picture"),
        (WHOLE.getvalue()[:60], "cannot be decoded"),
    ]
] + [
    (partial(truth, NUMBERS), {}, "a.png", "is missing"),
    (partial(truth, COLOURS), {}, "a.png", "is missing"),
    (partial(truth, COLOURS), {"a.png": STRANGE}, "a.png",
     r"colours 3 2 1 \(4 pixels\), 255 0 254 \(2 pixels\)"),
    *(
        (lambda root: [*pairs(root / "images", root / "labels", "_L.png")], files, where, what)
        for files, where, what in [
            ({"images/a.png": BLACK, "images/b.jpg": BLACK, "labels/x": ""}, "labels/a_L.png",
             "is missing, 2 of 2"),
            ({"images/a.png": BLACK}, "labels", "does not exist"),
            ({"images/a.txt": "", "labels/a_L.png": BLACK}, "images", "holds no pictures"),
            ({"images/a.png": BLACK, "images/a.bmp": BLACK, "labels/a_L.png": BLACK}, "a.png",
             r"has the name of a\.bmp"),
        ]
    ),
]  # fmt: skip

# --- sets -------------------------------------------------------------------------------


def first_truth(name: str, folder: Path) -> object:
    found = open_dataset(name, folder)
    return found.read(found.items[0])


FRAME = {"images/0016E5_00390.png": BLACK, "labels/0016E5_00390_L.png": BLACK}
CITY = "leftImg8bit/val/ulm/ulm_000001_000019_leftImg8bit.png"
KITTI = {f"image_2/{name}.png": BLACK for name in ("um_000000", "uu_000000")}
KITTI |= {f"gt_image_2/{name}.png": BLACK for name in ("um_road_000000", "uu_road_000000")}

SETS: Rows = [
    (partial(open_dataset, "camvid32"), {}, "", "no CamVid in 32 colours .*LabeledApproved_full"),
    (lambda folder: open_dataset("camvid32", folder, "test"), FRAME, "",
     "holds no pictures of the split test"),
    (partial(open_dataset, "camvid32"), {"images/0016E5_00390.png": BLACK, "labels/x": ""},
     "labels/0016E5_00390_L.png", "is missing, 1 of 1"),
    (partial(open_dataset, "camvid32"),
     {**FRAME, "images/street_1.png": BLACK, "labels/street_1_L.png": BLACK},
     "street_1", "is not the name of a CamVid frame"),
    (partial(first_truth, "idd-lite"),
     {"images/a.png": np.zeros((2, 3), np.uint8), "labels/a.png": grey(0)},
     "a.png", "is 1 by 1 .* 3 by 2"),
    (partial(open_dataset, "folder"), {"notes/a.txt": ""}, "", "has no folder images, nor folders"),
    (partial(first_truth, "folder"), {"images/a.png": BLACK, "masks/a.png": grey(0, 1, 255)},
     "a.png", "both 1 and 255"),
    (partial(first_truth, "folder"),
     {"images/a.png": BLACK, "road/a.png": grey(0, 1), "layout/a.png": grey(0, 1, 2)},
     "layout/a.png", r"is 3 by 1 pixels, unlike a\.png"),
    (partial(open_dataset, "cityscapes"), {}, "leftImg8bit/val", "does not exist"),
    (partial(open_dataset, "cityscapes"), {CITY: BLACK, "gtFine/val/x": ""},
     "_gtFine_labelIds.png", "is missing, 1 of 1"),
    (partial(open_dataset, "cityscapes"), {"leftImg8bit/val/x": "", "gtFine/val/x": ""},
     "leftImg8bit/val", r"holds no pictures CITY/\*_leftImg8bit\.png"),
    (partial(open_dataset, "kitti-road"), {}, "image_2", "does not exist"),
    (partial(open_dataset, "kitti-road"), {"image_2/uu_000000.png": BLACK},
     "uu_road_000000.png", "is missing"),
    (partial(open_dataset, "kitti-road"), {**KITTI, "image_2/thumb.png": BLACK},
     "thumb", "is not the name of a KITTI road picture"),
    (lambda folder: birds_eye(open_dataset("kitti-road", folder)), KITTI, "calib",
     "does not exist"),
    (lambda folder: open_dataset("camvid", folder / "nowhere"), {}, "nowhere", "is not a folder"),
]  # fmt: skip

# --- tables of conditions ---------------------------------------------------------------

CAMERAS = {f"{name}.png": BLACK for name in (
    *("near/images/a", "near/masks/a", "far/images/a", "far/masks/a"),
    *("far/images/b", "far/masks/b"),
)}  # fmt: skip
TABLE = "name,file,condition\nnear,a.png,day\nfar,b.png,night\n"

CONDITIONS: Rows = [
    (partial(open_dataset, "folder"), {**CAMERAS, "pictures.csv": text}, where, what)
    for text, where, what in [
        ("name,file\nnear,a.png\n", "csv", r"has no column condition \(its first line has to name"),
        ("", "csv", "has no column name and none file and none condition"),
        ("file,condition\na.png,day\n", "csv", "has no column name"),
        (TABLE + "far,a.jpg,day\n", "line 4", r"there is no picture far/a.jpg \(did.*far/a.png"),
        (TABLE + "zzzzzz,q.tiff,day\n", "line 4", r"there is no picture zzzzzz/q.tiff \(mend"),
        (TABLE + "far,b.png,day\n", "line 4", r"names far/b.png a second time \(keep one"),
        ("name,file,condition\nfar\n", "line 2", "there is no picture far"),
        ("name,file,condition\nfar,\0,\n", "", "cannot be read|there is no picture"),
        (b"name,file,condition\n\xff\xfe,a,b\n", "csv", "cannot be read: 'utf-8' codec"),
    ]
]

# --- corrections ------------------------------------------------------------------------


def read_format(name: str, folder: Path) -> object:
    return FORMATS[name].read(folder, {"a.jpg": (1, 2)})


def coco(region: Mapping[str, object] | None = None, **more: object) -> str:
    """A file for the picture a.jpg of two pixels, with a region or without."""
    image = {"id": 1, "file_name": "a.jpg", "height": 1, "width": 2}
    known = {"image_id": 1, "category_id": 1, "segmentation": [[0, 0, 1, 0, 1, 1]]}
    parts = {
        "images": [image],
        "categories": [{"id": 1, "name": "road"}, {"id": 2, "name": "cat"}],
        "annotations": [] if region is None else [known | dict(region)],
    }
    return json.dumps(parts | more)


def image(file: str, **more: object) -> dict[str, object]:
    return {"id": 7, "file_name": file, "height": 1, "width": 2} | more


COCO: Rows = [
    (partial(read_format, "coco"), {"coco.json": text}, "coco.json", what)
    for text, what in [
        ("", "is not JSON"),
        ("[" * 100_000, "is not JSON"),
        ("[]", "it: input should be an object"),
        ("{}", "images is missing"),
        (coco(annotations={}), "annotations: input should be a valid array"),
        (coco(images=[]), "no image for any of the pictures"),
        (coco(images=[image("other.jpg")]), "no image for any of the pictures"),
        (coco(images=[image("one/a.jpg"), image("two/a.jpg")]), r"two images are a\.jpg"),
        (coco(images=[image("a.jpg", width=3)]), r"a\.jpg is for 3 by 1 pixels, .* has 2 by 1"),
        (coco(images=[image("a.jpg", width=2**70)]), r"images\.0\.width: .* was given"),
        (coco({"category_id": 2}), "category 'cat' on a.jpg says nothing .* use road"),
        (coco({"category_id": 3}), "category ''"),
        (coco({"segmentation": None}), r"segmentation.*None was given"),
        (coco({"segmentation": []}), r"a region on a\.jpg has no area"),  # a box
        (coco({"segmentation": [[0, 0, 1, 0]]}), "at least 6 items"),
        (coco({"segmentation": [[0, 0, 1, 0, 1, 1, 1]]}), "7 coordinates, an odd number"),
        (coco({"segmentation": [[0, 0, 1, 0, 1, float("nan")]]}), "nan was given"),
        (coco({"segmentation": [[0, 0, 1, 0, 1, 1e9]]}), "1000000000.0 was given"),
        (coco({"segmentation": {"counts": [1]}}), "1 pixels are counted, not 2 by 1"),
        (coco({"segmentation": {"counts": [0, 2**30, 2**30]}}), "are counted, not 2 by 1"),
        (coco({"segmentation": {"counts": [-1, 3]}}), "-1 was given"),
        (coco({"segmentation": {"counts": "02"}}), "'02' was given"),
    ]
]  # fmt: skip

LOG, HEAD = "a.jpg.strokes.jsonl", {"picture": "a", "height": 1, "width": 1}
BROUGHT = {"kind": "brought", "id": "a", "labels": {"road": [0, 1]}}


def log(*lines: Mapping[str, object]) -> str:
    return "".join(json.dumps(line) + "\n" for line in lines)


LOGS: Rows = [
    (read_corrections, {LOG: text}, where, what)
    for text, where, what in [
        ("{}\n", LOG, "cannot be read: picture is missing"),
        ("\n{}\n", LOG, "cannot be read: it is not JSON"),
        (log(HEAD | {"height": 10**6, "width": 10**6}), LOG, "more than 100 megapixels"),
        (log(HEAD | {"width": 0}), LOG, "width: "),
        ('{"picture": "a", "height": 1, "width": 1e400}\n', LOG, "width: "),
        (log(HEAD | {"user": "bob"}), LOG, "user: "),
        (log({"roadtorch": 1, **HEAD}) + "nonsense\n", f"{LOG}:2", "is no event"),
        (log(HEAD, BROUGHT | {"labels": {"road": [0, 9]}}), LOG, "an event that does not fit"),
        ("", "", "holds no corrections"),
    ]
] + [
    (lambda folder: read_corrections(folder / "missing"), {}, "missing", "is no folder"),
    (partial(read_format, "png"), {"labels/a.png": grey(8, 7)}, "labels/a.png",
     r"has other values than 0 to 7 \(0 is untouched, 1 road"),
    (partial(read_format, "png"), {"labels/a.png": grey(0, 0, 0)}, "labels/a.png",
     r"has 3 by 1 pixels \(its picture has 2 by 1"),
    (partial(read_format, "png"), {}, "", "has no file for any of the pictures"),
]  # fmt: skip

# --- maps -------------------------------------------------------------------------------

RAMP = np.linspace(0, 1, 24).reshape(4, 6)
ARCHIVE = io.BytesIO()
np.savez(ARCHIVE, a=RAMP)


def read_map(folder: Path) -> object:
    return map_likelihood(folder, ["m"], [(4, 6)])


MAPS: Rows = [
    (read_map, {"m.npy": content}, "m.npy", what)
    for content, what in [
        (np.where(RAMP > 0.9, np.nan, RAMP), "has values from nan to nan"),
        (RAMP * 1.5, r"has values from 0 to 1\.5"),
        (RAMP - 0.1, r"has values from -0\.1"),
        (RAMP * 1e300, "has values from 0 to inf"),
        (RAMP[:3], r"is 6 by 3 pixels \(it should be 6 by 4\)"),
        ((RAMP * 255).astype(np.uint8), r"holds uint8 of shape \(4, 6\)"),
        (RAMP[None], r"holds float64 of shape \(1, 4, 6\)"),
        (np.array(["x"], dtype=object), "cannot be read"),
        (b"", "cannot be read"),
        (ARCHIVE.getvalue(), "is an archive of arrays"),
    ]
] + [
    (read_map, {"m.png": np.full((4, 6, 3), (1, 2, 3), np.uint8)}, "m.png", "is a colour picture"),
    (read_map, {}, "m.png", "is missing"),
    (
        read_map,
        {"m.png": (RAMP * 255).astype(np.uint8), "m.npy": 1 - RAMP},
        "m.npy",
        r"says otherwise than m\.png",
    ),
]


def named_maps(name: str, folder: Path) -> object:
    return parse_maps([f"{name}={folder}"])


def numbers(wrong: dict[str, tuple[int, ...]], _: Path) -> object:
    return NumberLabels(**({"road": (1,), "void": (), "values": (0, 1)} | wrong))


OPTIONS: Rows = [
    (lambda folder: open_dataset("camvit", folder), {}, "camvit", "unknown data set .*camvid"),
    (lambda folder: open_dataset("camvid", folder, "trian"), {}, "trian",
     "unknown split of camvid .*train"),
    (lambda folder: birds_eye(open_dataset("camvid32", folder)), FRAME, "camvid32",
     "has no bird's-eye view"),
    (lambda _: parse_maps(["net=nothing"]), {}, "nothing", "is not a folder"),
    (lambda folder: parse_maps([str(folder / "a/x"), str(folder / "b/x")]),
     {"a/x/m": "", "b/x/m": ""}, "--maps", "gives two folders one name"),
    *(
        (partial(named_maps, name), {}, "--maps", "cannot be that of a file")
        for name in ("x/y", "a/../../ESC", "..", ".", "", "a\\b", "a\nb")
    ),
    *(
        (partial(numbers, wrong), {}, "NumberLabels", what)
        for wrong, what in [
            ({"road": (2,)}, "not among its values"),
            ({"void": (2,)}, "not among its values"),
            ({"values": (0, 1, 300)}, "not among its values"),
            ({"void": (1,)}, "is road and void"),
            ({"layout": (0, 1, 2)}, "has 3 layout classes for 2 values"),
        ]
    ),
]  # fmt: skip

REFUSALS = [
    *((DatasetError, row) for row in (*LABEL_PICTURES, *SETS, *CONDITIONS)),
    *((DatasetError, row) for row in (*COCO, *LOGS)),
    *((InputError, row) for row in MAPS),
    *((ConfigError, row) for row in OPTIONS),
]


@pytest.mark.parametrize(
    ("error", "row"), REFUSALS, ids=[f"{row[2]}: {row[3]}"[:60] for _, row in REFUSALS]
)
def test_what_cannot_be_read_is_refused_with_its_name(
    error: type[RoadtorchError], row: tuple[Read, Files, str, str], tmp_path: Path
) -> None:
    read, files, where, what = row
    for name, content in files.items():
        write(tmp_path / name, content)

    with pytest.raises(error) as caught:
        read(tmp_path)

    problem = caught.value
    assert type(problem) is error
    assert problem.where.endswith(where)
    assert re.search(what, f"{problem.what} ({problem.remedy})")
    assert "\n" not in str(problem)
