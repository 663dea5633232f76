"""Labels for ``scripts/fuzz.py``: drawings, label pictures, tables, calibration."""

import base64
import io
import random
from pathlib import Path
from typing import Any

import numpy as np
import torch
from PIL import Image

from roadtorch.camera.birds_eye import read_calibration, to_birds_eye
from roadtorch.data.catalogue import open_dataset
from roadtorch.data.conditions import with_conditions
from roadtorch.data.dataset import Item
from roadtorch.data.folder import FolderLabels
from roadtorch.data.labelme import PolygonLabels
from scripts.fuzz_bytes import BYTES, TEXT, mutated, mutated_json
from scripts.fuzz_pictures import resize

HEIGHT, WIDTH = 12, 16
FORMATS = ("PNG", "PNG", "JPEG", "GIF", "TIFF", "EPS")

# --- drawings ---------------------------------------------------------------------------


def _picture(folder: Path) -> Path:
    path = folder / "a.png"
    Image.new("RGB", (WIDTH, HEIGHT)).save(path)
    return path


def _shape(points: Any, kind: str, **more: Any) -> dict[str, Any]:
    return {"label": "road", "points": points, "shape_type": kind, "group_id": None, **more}


def _encoded_mask(draw: random.Random) -> str:
    data = io.BytesIO()
    Image.new("L", (4, 3), 255).save(data, draw.choice(FORMATS))
    content = data.getvalue()
    if draw.random() < 0.7:
        content = mutated(content, draw, (*BYTES, resize))
    return base64.b64encode(content).decode()


def make_labelme(folder: Path, draw: random.Random) -> Path:
    """labelme's JSON beside its picture, with a mask inside, that was tampered with."""
    _picture(folder)
    shapes = [
        _shape([[1, 1], [9, 1], [9, 8]], "polygon"),
        _shape([[2, 3], [9, 8]], "rectangle"),
        _shape([[5, 5], [7, 7]], "circle"),
        _shape([[3, 3], [6, 5]], "mask", mask=_encoded_mask(draw)),
        _shape([[1, 1]], "point"),
    ]
    drawn = draw.sample(shapes, draw.randint(1, 5))
    document = {"version": "5.5.0", "shapes": drawn, "imageHeight": HEIGHT, "imageWidth": WIDTH}
    path = folder / "a.json"
    path.write_bytes(mutated_json(document, draw))
    return path


def make_xml(folder: Path, draw: random.Random) -> Path:
    """LabelMe's XML beside its picture that was tampered with."""
    _picture(folder)
    corners = "\n".join(f"<pt><x>{x}</x><y>{y}</y></pt>" for x, y in ((2, 3), (9, 3), (9, 8)))
    polygon = f"<polygon>\n<username>anna</username>\n{corners}\n</polygon>"
    parts = f"<object>\n<name>road</name>\n<deleted>0</deleted>\n{polygon}\n</object>"
    size = f"<imagesize><nrows>{HEIGHT}</nrows><ncols>{WIDTH}</ncols></imagesize>"
    text = f"<?xml version='1.0' encoding='utf-8'?>\n<annotation>\n{size}\n{parts}\n</annotation>"
    path = folder / "a.xml"
    path.write_bytes(mutated(text.encode(), draw, TEXT))
    return path


def read_truth(path: Path) -> bool:
    """Draw the truth; whether it has the picture's size."""
    truth = PolygonLabels().truth(Item("a", path.parent / "a.png", path))
    return truth.road.shape == truth.valid.shape == (HEIGHT, WIDTH)


# --- label pictures ---------------------------------------------------------------------


def make_labels(folder: Path, draw: random.Random) -> Path:
    """A label picture of a set of one's own that was tampered with."""
    path = folder / "label.png"
    values = np.array([0, 255, 127], np.uint8)[np.arange(HEIGHT * WIDTH) % 3]
    data = io.BytesIO()
    picture = Image.fromarray(values.reshape(HEIGHT, WIDTH))
    picture.convert(draw.choice(("L", "P", "RGB", "I;16", "1"))).save(data, "PNG")
    path.write_bytes(mutated(data.getvalue(), draw, (*BYTES, resize)))
    return path


def read_label_picture(path: Path) -> bool:
    """Decode it; whether every pixel has a meaning."""
    truth = FolderLabels().truth(Item("a", path, path))
    return truth.road.shape == truth.valid.shape and truth.road.dtype == torch.bool


# --- tables and calibration -------------------------------------------------------------


def make_conditions(folder: Path, draw: random.Random) -> Path:
    """A set of two pictures with a table of conditions that was tampered with."""
    for name in ("images/a.png", "images/b.png", "masks/a.png", "masks/b.png"):
        path = folder / "set" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        Image.new("L", (2, 2)).save(path)
    path = folder / "conditions.csv"
    text = 'file,place,condition\na.png,"a town, by the sea",day rain\nb.png,,night\n'
    path.write_bytes(mutated(text.encode(), draw, TEXT))
    return path


def read_conditions(path: Path) -> bool:
    """Give the set its conditions; whether it has its pictures still."""
    dataset = open_dataset("folder", path.parent / "set")
    return len(with_conditions(dataset, path).items) == len(dataset.items)


def make_calibration(folder: Path, draw: random.Random) -> Path:
    """A calibration file in KITTI's form that was tampered with."""
    rows = {
        "P2": "7.2e+02 0 6.1e+02 4.5e+01 0 7.2e+02 1.7e+02 2.2e-01 0 0 1 2.7e-03",
        "R0_rect": "1 0 0 0 1 0 0 0 1",
        "Tr_cam_to_road": "1 0 0 0 0 1 0.02 -1.6 0 -0.02 1 0",
    }
    text = "\n".join(["P0: 1 2 3", *(f"{name}: {row}" for name, row in rows.items()), ""])
    if draw.random() < 0.5:
        value = draw.choice(["1e308", "-1e308", "1e-320", "0", "1e40"])
        words = text.split(" ")
        words[draw.randrange(len(words))] = value
        text = " ".join(words)
    path = folder / "calib.txt"
    path.write_bytes(mutated(text.encode(), draw, TEXT))
    return path


def read_from_above(path: Path) -> bool:
    """Look at a map from above; whether it has the benchmark's size."""
    return to_birds_eye(torch.rand(HEIGHT, WIDTH), read_calibration(path)).shape == (800, 400)
