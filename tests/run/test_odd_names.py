"""Names and cells as users, shells and spreadsheets leave them."""

import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from roadtorch import RoadtorchError, load_detector
from tests.command import ROWS, Call, read_index_rows, save_image


def test_a_missing_folder_of_a_list_is_a_failed_row(call: Call, footage: Path, out: Path) -> None:
    (footage / "list.txt").write_text(f"{footage / 'a.jpg'}\n{footage / 'gone'}/\n")

    result = call("infer", f"@{footage / 'list.txt'}", *ROWS, "--out", out, "--jobs", "1")

    assert result.exit_code == 1
    assert [row["status"][:6] for row in read_index_rows(out).values()] == ["done", "failed"]


def test_a_glob_meets_each_file_once(call: Call, footage: Path, out: Path) -> None:
    (footage / "0").symlink_to(".")

    call("infer", f"{footage}/**/*.png", *ROWS, "--out", out, "--save", "mask", "--jobs", "1")

    assert {*read_index_rows(out)} == {"b.png", "sub/c.png"}


@pytest.mark.parametrize(
    ("old", "new", "code"), [(",64,48,", ",64.0,48.0,", 0), (",64,", ",x,", 2)]
)
def test_an_index_that_a_spreadsheet_rewrote_is_read_or_refused(
    old: str, new: str, code: int, call: Call, footage: Path, out: Path
) -> None:
    words = ("infer", footage, *ROWS, "--save", "polygons", "--jobs", "1", "--out", out)
    call(*words)
    index = out / "index.csv"
    index.write_text(index.read_text().replace(old, new))

    result = call(*words)

    assert result.exit_code == code, result.stderr
    assert "bug" not in result.stderr


def test_names_beyond_16_bits_and_bytes_that_are_not_utf_8_are_found(
    call: Call, tmp_path: Path
) -> None:
    data = save_image(tmp_path / "images" / "\N{GRINNING FACE}.png").read_bytes()
    (tmp_path / "images" / os.fsdecode(b"b\xff\xfe.png")).write_bytes(data)

    place = [
        part for value in ("fov=60", "height=1", "pitch=5") for part in ("--set", f"grid.{value}")
    ]
    save = ("--save", "polygons,grid", *place)
    call("infer", tmp_path / "images", *ROWS, *save, "--out", tmp_path, "--jobs", "1")

    assert len(json.loads((tmp_path / "coco.json").read_text())["images"]) == 2
    text = (tmp_path / "\N{GRINNING FACE}.grid.yaml").read_text(encoding="utf-8")
    assert (tmp_path / yaml.safe_load(text)["image"]).is_file()


@pytest.mark.parametrize(
    ("options", "image"),
    [({"camera": "camera.toml"}, None), ({"runtime": None}, None), ({"device": 3.5}, None),
     ({"order": "rgb"}, np.zeros((0, 160, 3), np.uint8))],
)  # fmt: skip
def test_python_arguments_are_refused_by_an_error_of_ours(
    options: dict[str, Any], image: Any
) -> None:
    with pytest.raises(RoadtorchError):
        load_detector("prior:rows", **options)(image)
