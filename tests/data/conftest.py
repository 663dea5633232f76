"""Files of labelled sets as tests write them, and a small CamVid of rendered streets."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from tests.streets import scene, write_camvid

Content = str | bytes | np.ndarray | Image.Image

SIZE = (12, 16)
"""(height, width) of pictures on which shapes are drawn."""

BLOB = [(2, 3), (9, 3), (9, 8), (2, 8)]
SIZE_XML = "<imagesize><nrows>12</nrows><ncols>16</ncols></imagesize>"


def write(path: Path, content: Content) -> Path:
    """Write text, bytes, an array of numbers or a picture, by the ending."""
    path.parent.mkdir(parents=True, exist_ok=True)
    if isinstance(content, np.ndarray) and path.suffix == ".npy":
        np.save(path, content, allow_pickle=True)
    elif isinstance(content, np.ndarray):
        Image.fromarray(content).save(path)
    elif isinstance(content, Image.Image):
        content.save(path)
    else:
        path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


def polygon_xml(points: Any, user: str = "") -> str:
    corners = "".join(f"<pt><x>{x}</x><y>{y}</y></pt>" for x, y in points)
    return f"<polygon><username>{user}</username>{corners}</polygon>"


def object_xml(*polygons: str, name: str = "road", deleted: int = 0) -> str:
    return f"<object><name>{name}</name><deleted>{deleted}</deleted>{''.join(polygons)}</object>"


def xml(*objects: str, size: str = SIZE_XML) -> str:
    """An annotation as LabelMe stores it."""
    return f"<annotation><filename>a.png</filename>{size}{''.join(objects)}</annotation>"


def shape(points: Any, kind: str | None = "polygon", label: str = "road", **more: Any) -> dict:
    return {"label": label, "points": points, "shape_type": kind, "group_id": None, **more}


def document(*shapes: Any, **more: Any) -> str:
    """An annotation as labelme stores it."""
    size = {"imageHeight": 12, "imageWidth": 16}
    return json.dumps({"version": "5.5.0", "shapes": list(shapes), "imageData": None} | size | more)


@pytest.fixture
def camvid(tmp_path: Path) -> Path:
    scenes = {f"{drive}_{i}": scene(i, 24, 32) for i, drive in enumerate(("0001TP", "0006R0"))}
    write_camvid(tmp_path, "train", scenes)
    write_camvid(tmp_path, "val", {"0016E5_7": scene(7, 24, 32)})
    return tmp_path
