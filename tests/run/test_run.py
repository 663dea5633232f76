"""The output folder of infer: coco.json, run.json, locks, and conflicts of names."""

import fcntl
import json
import os
import shlex
import sys
from collections.abc import Sequence
from hashlib import sha256
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import torch
from PIL import Image

from roadtorch.base.compute import Threads
from roadtorch.data.correction_formats import read_coco_labels
from roadtorch.detectors.catalogue import load_detector
from roadtorch.run.ledger import has_result, open_ledger
from roadtorch.run.record import record_run
from roadtorch.testing.scenes import render_scene, write_image
from tests.command import ROWS, Call, bytes_in, read_index_rows, save_image
from tests.videos import write_video

# --- polygons and facts -----------------------------------------------------------------


def test_polygons_are_the_mask_and_coco_has_all(call: Call, tmp_path: Path, out: Path) -> None:
    images = tmp_path / "in"
    for seed in (1, 2):
        write_image(images / f"{seed}.png", render_scene(seed, 60, 80))

    cocos = []
    for inputs in (images / "1.png", images):
        call("infer", inputs, "--detector", "cpf", "--out", out, "--save", "polygons,mask")
        cocos.append(json.loads((out / "coco.json").read_text()))

    names = [[entry["file_name"] for entry in coco["images"]] for coco in cocos]
    assert names == [["1.png"], ["1.png", "2.png"]]
    for seed, entry in zip((1, 2), cocos[1]["annotations"], strict=True):
        mask = np.asarray(Image.open(out / f"{seed}.mask.png")) == 255
        labels = read_coco_labels(out / f"{seed}.coco.json", {f"{seed}.png": mask.shape})
        assert np.array_equal(labels[f"{seed}.png"] == 1, mask)
        assert entry["area"] == mask.sum() > 0


def test_an_image_does_not_depend_on_the_run(call: Call, footage: Path, tmp_path: Path) -> None:
    for out in ("one", "two"):
        call("infer", footage, *ROWS, "--out", tmp_path / out, "--save", "json,polygons")

    facts = json.loads((tmp_path / "one" / "sub" / "c.json").read_text())

    assert bytes_in(tmp_path / "one") == bytes_in(tmp_path / "two")
    assert facts["file"] == "sub/c.png"
    assert (facts["width"], facts["height"], facts["detector"]) == (64, 48, "prior:rows")
    assert facts["trust"] is None
    assert facts["road_fraction"] == pytest.approx(0.5, abs=0.05)


# --- run.json ---------------------------------------------------------------------------


def test_run_json_says_how_the_results_were_made(run: Call, footage: Path, out: Path) -> None:
    (footage / "bad.png").write_bytes(b"no image")

    threads = Threads.current()
    try:
        run("--threshold", "0.4", "--threads", "2")
    finally:
        threads.set()

    record = json.loads((out / "run.json").read_text())
    assert record["versions"]["torch"] == torch.__version__
    assert record["threads"] == {"torch": 2, "opencv": 2}
    assert record["detector"] == "prior:rows"
    assert record["settings"]["threshold"] == 0.4
    assert record["images"] == {"all": 4, "done": 3, "doubtful": 0, "failed": 1, "not_tried": 0}
    assert record["exit_status"] == 1
    assert record["index_sha256"] == sha256((out / "index.csv").read_bytes()).hexdigest()
    assert record["started"] < record["ended"]
    lines = [
        f"{row['sha256']}  {name}\n" for name, row in read_index_rows(out).items() if row["sha256"]
    ]
    assert record["inputs_sha256"] == sha256("".join(lines).encode()).hexdigest()


def test_run_json_is_written_without_the_version_of_a_runtime(
    footage: Path, out: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    detector = load_detector("prior:rows")
    monkeypatch.setitem(sys.modules, "runtime_without_version", ModuleType("its package is named"))

    for runtime, known in (("torch", torch.__version__), ("runtime_without_version", "unknown")):
        detector.runtime = runtime
        with open_ledger(out, "") as ledger, record_run(ledger, detector, [], {}, "infer"):
            pass
        record = json.loads((out / "run.json").read_text())
        assert record["versions"][runtime] == known


# --- the folder -------------------------------------------------------------------------


def test_a_bag_that_is_a_folder_is_there_once_it_has_its_list(tmp_path: Path) -> None:
    (tmp_path / "a.road").mkdir()

    assert not has_result(tmp_path, "a.road")
    (tmp_path / "a.road" / "metadata.yaml").touch()
    assert has_result(tmp_path, "a.road")


def test_settings_with_which_nothing_was_done_are_replaced(out: Path) -> None:
    for effective in ("a = 1", "a = 2"):
        with open_ledger(out, effective) as ledger:
            assert (out / "config.toml").read_text() == f"{effective}\n"
            assert not ledger.rows


# --- owners of results ------------------------------------------------------------------


def write_inputs(root: Path, names: Sequence[str]) -> Path:
    """Write images and videos to a folder."""
    root.mkdir(exist_ok=True)
    for seed, name in enumerate(names):
        if name.endswith(".mp4"):
            write_video(root / name)
        else:
            save_image(root / name, seed)
    return root


KINDS = "--save json,polygons,cues"


@pytest.mark.parametrize(
    ("names", "line", "message"),
    [
        ("1.png 1.jpg", f"infer in {KINDS}", "in/1.jpg and in/1.png: both would write out/1.co"),
        ("drive.mp4 drive/000003.png", f"infer in {KINDS}", "drive.mp4: both would write out/dri"),
        ("1.png run.png", f"infer in {KINDS}", "the run itself and in/run.png: both would write"),
        ("1.png 1.coco.png", f"infer in {KINDS}", "in/1.coco.png and in/1.png: both would write"),
        (r"1\xff.png " + os.fsdecode(b"1\xff.png"), f"infer in {KINDS}", r"in/1\xff.png and in/1"),
        ("b.png", "infer gone/", "gone: does not exist ("),
        ("b.png", "infer ''", "'': is an empty name (give a file or a folder)"),
        ("b.png", "infer in --engine ray", "--engine ray: Ray is not installed (pip install 'road"),
        ("b.png", "infer in --out s3://bucket/out", "s3:/bucket/out: is an address (give a local"),
        ("b.png", "infer in --out locked", "locked: another run is writing here (wait for it, or "),
        ("b.png", "label in --out in", "in/b.png: is one of the input images (give another --out)"),
    ],
)
def test_refusals(
    names: str, line: str, message: str, call: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(sys.modules, "ray", None)
    Path("locked").mkdir()
    handle = os.open("locked", os.O_RDONLY)
    fcntl.flock(handle, fcntl.LOCK_EX)
    contents = bytes_in(write_inputs(Path("in"), names.split()))
    words = ["--out", "out", *(("--detector", "prior:rows") * line.startswith("infer"))]

    result = call(*shlex.split(line)[:1], *words, *shlex.split(line)[1:])

    os.close(handle)
    assert (result.exit_code, result.stdout, result.stderr.count("\n")) == (2, "", 1)
    assert result.stderr.startswith("roadtorch: error: ")
    assert message in result.stderr
    assert bytes_in(Path("in")) == contents
    assert not {"out", "s3:"} & {path.name for path in tmp_path.iterdir()}


def test_images_beside_a_video_of_their_name_stay(call: Call, tmp_path: Path, out: Path) -> None:
    inputs = write_inputs(tmp_path, ["drive.mp4", "drive/000003.png", "drive/x.png"])

    result = call("infer", inputs, *ROWS, "--out", out)

    assert result.exit_code == 0, result.stderr
    assert {"drive/000003.png", "drive/x.png"} < set(read_index_rows(out))


def test_a_name_that_is_too_long_costs_its_own_image(call: Call, tmp_path: Path, out: Path) -> None:
    names = [*(f"{number}.png" for number in range(4)), f"1{'n' * 245}.png"]
    inputs = write_inputs(tmp_path / "in", names)

    result = call("infer", inputs, *ROWS, "--out", out)

    assert result.exit_code == 1
    statuses = {name[:2]: row["status"] for name, row in read_index_rows(out).items()}
    assert statuses.pop("1n").startswith("failed")
    assert set(statuses.values()) == {"done"}
    assert len(statuses) == 4
