"""What a run of ``infer`` leaves beside the pictures' files, and how it ends."""

import json
from hashlib import sha256
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from roadtorch.base.compute import Threads
from roadtorch.data.polygons import read_outlined_mask
from roadtorch.testing.scenes import render_scene, write_picture
from tests.command import ROWS, Call, bytes_in, rows_of

# --- polygons and facts -----------------------------------------------------------------


def test_polygons_are_the_mask_and_coco_has_all(call: Call, tmp_path: Path, out: Path) -> None:
    pictures = tmp_path / "in"
    for seed in (1, 2):
        write_picture(pictures / f"{seed}.png", render_scene(seed, 60, 80))

    cocos = []
    for given in (pictures / "1.png", pictures):
        call("infer", given, "--detector", "cpf", "--out", out, "--save", "polygons,mask")
        cocos.append(json.loads((out / "coco.json").read_text()))

    names = [[one["file_name"] for one in coco["images"]] for coco in cocos]
    assert names == [["1.png"], ["1.png", "2.png"]]
    for seed, one in zip((1, 2), cocos[1]["annotations"], strict=True):
        mask = np.asarray(Image.open(out / f"{seed}.mask.png")) == 255
        assert np.array_equal(read_outlined_mask(out / f"{seed}.labelme.json", mask.shape), mask)
        assert one["area"] == mask.sum() > 0


def test_an_image_does_not_depend_on_the_run(call: Call, footage: Path, tmp_path: Path) -> None:
    for out in ("one", "two"):
        call("infer", footage, *ROWS, "--out", tmp_path / out, "--save", "json,polygons")

    facts = json.loads((tmp_path / "one" / "sub" / "c.json").read_text())

    assert bytes_in(tmp_path / "one") == bytes_in(tmp_path / "two")
    assert facts["file"] == "sub/c.png"
    assert (facts["width"], facts["height"], facts["detector"]) == (64, 48, "prior:rows")
    assert facts["trust"] is None
    assert facts["road_share"] == pytest.approx(0.5, abs=0.05)


# --- run.json ---------------------------------------------------------------------------


def test_run_json_says_how_the_results_were_made(run: Call, footage: Path, out: Path) -> None:
    (footage / "bad.png").write_bytes(b"no picture")

    before = Threads.of_now()
    try:
        run("--threshold", "0.4", "--threads", "2")
    finally:
        before.set()

    record = json.loads((out / "run.json").read_text())
    assert record["versions"]["torch"] == torch.__version__
    assert record["threads"] == {"torch": 2, "opencv": 2}
    assert record["detector"] == "prior:rows"
    assert record["settings"]["threshold"] == 0.4
    assert record["pictures"] == {"all": 4, "done": 3, "doubtful": 0, "failed": 1, "not_tried": 0}
    assert record["exit_status"] == 1
    assert record["index_sha256"] == sha256((out / "index.csv").read_bytes()).hexdigest()
    assert record["started"] < record["ended"]
    lines = [f"{row['sha256']}  {name}\n" for name, row in rows_of(out).items() if row["sha256"]]
    assert record["inputs_sha256"] == sha256("".join(lines).encode()).hexdigest()
