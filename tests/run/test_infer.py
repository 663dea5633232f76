"""roadtorch infer on images: files, rows, run.json, odd and bad inputs, refusals."""

import fcntl
import json
import os
import shlex
import struct
import tomllib
import zlib
from collections.abc import Sequence
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image

from roadtorch import RoadtorchError
from roadtorch.base.compute import Threads
from roadtorch.base.image import read_image, write_rgb
from roadtorch.data.correction_formats import read_coco_labels
from roadtorch.detectors.catalogue import load_detector
from roadtorch.detectors.detection import Detection
from roadtorch.run.loop import Inference
from roadtorch.run.writers.maps import cue_image
from roadtorch.testing.scenes import render_scene, write_image
from tests.command import GREY, ROWS, Call, bytes_in, files_in, read_index_rows, save_image
from tests.videos import write_video

# --- what is written ------------------------------------------------------------------------


def test_a_folder_gives_three_files_an_image(run: Call, footage: Path, out: Path) -> None:
    result = run()

    assert (result.exit_code, result.stdout) == (0, "")
    assert result.stderr == f"roadtorch: 3 done; results in {out}\n"
    kinds = ("likelihood.png", "mask.png", "overlay.jpg")
    expected = {f"{name}.{kind}" for name in ("a", "b", "sub/c") for kind in kinds}
    assert files_in(out) == expected | {"index.csv", "config.toml", "run.json"}
    rows = read_index_rows(out)
    assert list(rows) == ["a.jpg", "b.png", "sub/c.png"]
    assert list(rows["a.jpg"]) == [
        *("file", "width", "height", "ms", "road_fraction", "trust", "status"),
        *("saved", "method", "sha256", "seconds", "cues"),
    ]
    assert rows["a.jpg"]["sha256"] == sha256((footage / "a.jpg").read_bytes()).hexdigest()
    assert rows["a.jpg"]["saved"] == "likelihood mask overlay"
    assert {row["status"] for row in rows.values()} == {"done"}
    assert {row["trust"] for row in rows.values()} == {""}  # a floor does not say
    assert (rows["a.jpg"]["width"], rows["a.jpg"]["height"]) == ("64", "48")
    assert float(rows["a.jpg"]["road_fraction"]) == pytest.approx(0.5, abs=0.05)
    assert float(rows["a.jpg"]["ms"]) >= 0


def test_files_hold_what_the_library_says(call: Call, tmp_path: Path, out: Path) -> None:
    image = save_image(tmp_path / "x.png")
    kinds = "likelihood,mask,overlay,cues, npy"

    call("infer", image, *GREY, "--save", kinds, "--depth", "16", "--out", out)

    detection = load_detector("grey-uniformity").detect(read_image(image))
    stored = np.asarray(Image.open(out / "x.likelihood.png"))
    assert stored.dtype == np.uint16
    assert np.array_equal(stored, (detection.likelihood.double() * 65535).round().numpy())
    mask = np.asarray(Image.open(out / "x.mask.png"))
    assert np.array_equal(mask == 255, detection.mask.numpy())
    with Image.open(out / "x.overlay.jpg") as overlay:
        assert overlay.size == (64, 48)
    assert np.array_equal(np.load(out / "x.likelihood.npy"), detection.likelihood.numpy())
    for name, cue in detection.cues.items():
        assert (out / f"x.cue.{name}.png").is_file()
        assert np.array_equal(np.load(out / f"x.{name}.npy"), cue.numpy())


def test_cue_images() -> None:
    draw = cue_image
    ramp = torch.linspace(-3, 5, 12).view(3, 4)
    layout = torch.zeros(3, 2, 2)
    layout[0] = 1
    sky = torch.tensor([86.0, 180, 233])

    assert (draw("texture", ramp).min(), draw("texture", ramp).max()) == (0, 1)
    assert torch.equal(draw("texture", torch.full((2, 2), 7.0)), torch.zeros(3, 2, 2))
    holes = draw("texture", torch.tensor([[float("nan"), 0, 2]]))
    assert holes[0].tolist() == [[0, 0, 1]]
    assert torch.equal((draw("layout", layout)[:, 0, 0] * 255).round(), sky)
    labels = draw("layout_labels", torch.tensor([[0, 255]]))
    assert torch.equal(labels[:, 0, 0] * 255, sky)
    assert not labels[:, 0, 1].any()
    image = torch.rand(3, 4, 5, generator=torch.Generator().manual_seed(0))
    low, high = image.aminmax()  # one range for all channels
    torch.testing.assert_close(draw("dictionary", image * 2 - 1), (image - low) / (high - low))
    assert torch.equal(draw("maps", torch.stack([ramp, -ramp])), torch.zeros(3, 3, 4))
    segments = draw("segments", torch.arange(30).view(5, 6)).flatten(1)
    assert len({tuple(colour) for colour in segments.T.tolist()}) == 30


def test_polygons_are_the_mask_and_coco_has_all(call: Call, tmp_path: Path, out: Path) -> None:
    images, names = tmp_path / "in", ["1", os.fsdecode(b"2\xff")]
    for seed, name in enumerate(names, 1):
        write_image(images / f"{name}.png", render_scene(seed, 60, 80))

    cocos = []
    for inputs in (images / "1.png", images):
        call("infer", inputs, "--detector", "cpf", "--out", out, "--save", "polygons,mask,json")
        cocos.append(json.loads((out / "coco.json").read_text()))

    files = [[entry["file_name"] for entry in coco["images"]] for coco in cocos]
    assert files == [["1.png"], ["1.png", r"2\xff.png"]]
    facts = json.loads((out / "1.json").read_text())
    assert (facts["file"], facts["width"], facts["height"]) == ("1.png", 80, 60)
    assert (facts["detector"], facts["trust"]) == ("cpf", None)
    road = np.asarray(Image.open(out / "1.mask.png")) == 255
    assert facts["road_fraction"] == pytest.approx(road.mean(), abs=1e-6)
    for name, entry in zip(names, cocos[1]["annotations"], strict=True):
        mask = np.asarray(Image.open(out / f"{name}.mask.png")) == 255
        assert entry["area"] == mask.sum() > 0
    labels = read_coco_labels(out / "1.coco.json", {"1.png": (60, 80)})
    assert np.array_equal(labels["1.png"] == 1, road)


def test_run_json_says_how_the_results_were_made(run: Call, footage: Path, out: Path) -> None:
    (footage / "bad.png").write_bytes(b"no image")

    threads = Threads.current()
    try:
        run("--threshold", "0.4")
    finally:
        threads.set()

    record = json.loads((out / "run.json").read_text())
    assert record["versions"]["torch"] == torch.__version__
    assert record["threads"] == {"torch": 1, "opencv": 1}
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


def test_the_five_least_trusted_images_are_named_in_order(call: Call, tmp_path: Path) -> None:
    for seed in range(6):
        write_rgb(tmp_path / f"street-{seed}.jpg", render_scene(seed, 120, 160).image)
    noise = torch.rand(3, 120, 160, generator=torch.Generator().manual_seed(0))
    write_rgb(tmp_path / "noise.jpg", noise)

    result = call("infer", tmp_path, "--out", tmp_path / "out")

    rows = read_index_rows(tmp_path / "out")
    first, *lines = result.stdout.splitlines()
    trusts = [float(line.split()[0]) for line in lines]
    assert "of 7; least trusted (trust does not tell pavement from road: see" in first
    assert trusts == sorted(float(row["trust"]) for row in rows.values())[:5]
    assert lines[0].split()[1].startswith("noise.jpg")
    for row in rows.values():
        assert row["status"].startswith("doubtful: ") == (float(row["trust"]) < 0.6)
    again = call("infer", tmp_path, "--out", tmp_path / "out")
    assert again.exit_code == 0
    assert again.stderr.startswith("roadtorch: 0 done, 7 skipped")  # doubtful ones are done


# --- settings, and a second run ---------------------------------------------------------------


def test_set_goes_over_the_file_and_threshold_over_both_and_what_is_kept_gives_the_same(
    call: Call, footage: Path, tmp_path: Path
) -> None:
    path, saved = tmp_path / "c.toml", tmp_path / "out" / "config.toml"
    path.write_text('detector = "cpf"\nthreshold = 0.1\n[texture]\nbins = 8\n')
    options = ("--config", path, "--set", "texture.ridge=0.5", "--set", "threshold=0.2")

    call("infer", footage, *options, "--threshold", "0.3", "--out", saved.parent)
    again = call("infer", footage, "--config", saved, "--out", saved.parent)

    values = tomllib.loads(saved.read_text())
    assert (values["detector"], values["threshold"]) == ("cpf", 0.3)
    assert (values["texture"]["bins"], values["texture"]["ridge"]) == (8, 0.5)
    assert "3 skipped (done before)" in again.stderr


def test_what_is_done_is_skipped_until_overwrite(run: Call, footage: Path, out: Path) -> None:
    run()
    (out / "a.mask.png").unlink()
    (out / "b.mask.png").write_bytes(b"marked")
    save_image(footage / "d.png")

    again = run()
    assert again.stderr == f"roadtorch: 2 done, 2 skipped (done before); results in {out}\n"
    assert (out / "a.mask.png").exists()
    assert (out / "b.mask.png").read_bytes() == b"marked"
    assert list(read_index_rows(out)) == ["a.jpg", "b.png", "d.png", "sub/c.png"]

    anew = run("--overwrite")
    assert anew.stderr.startswith("roadtorch: 4 done;")
    assert (out / "b.mask.png").read_bytes() != b"marked"


def test_results_beside_the_images_are_not_taken_for_images(call: Call, footage: Path) -> None:
    for _ in range(2):
        result = call("infer", footage, *ROWS, "--out", footage, "--save", "mask,cues")
        assert result.exit_code == 0

    assert list(read_index_rows(footage)) == ["a.jpg", "b.png", "sub/c.png"]


# --- odd and bad input ----------------------------------------------------------------------


def write_odd(folder: Path) -> None:
    """Write the files of ``ODD``, which are named after what is odd about them."""
    image = save_image(folder / "whole.png").read_bytes()
    oversized, damaged = bytearray(image), bytearray(image)
    oversized[16:24] = struct.pack(">2I", 30_000, 6_000)
    oversized[29:33] = struct.pack(">I", zlib.crc32(oversized[12:29]))
    damaged[damaged.index(b"IDAT") - 1] -= 8  # its length
    contents = {"cut": image[:1000], "empty": b"", "text": b"not an image", "damaged": damaged}
    for name, data in {**contents, "oversized": oversized}.items():
        (folder / f"{name}.png").write_bytes(data)
    for name in (os.fsdecode(b"z\xff"), "\N{GRINNING FACE}", LONG):
        (folder / f"{name}.png").write_bytes(image)
    save_image(folder / "tiny.png", size=(1, 1))
    os.mkfifo(folder / "pipe.png")
    (folder / "loop.png").symlink_to("loop.png")
    write_video(folder / "drive.mp4", (0.0, 0.1))
    save_image(folder / "drive" / "000003.png")


LONG = "n" * 245
ODD = {
    "whole.png": "done",
    "cut.png": "cannot be decoded",
    "damaged.png": "cannot be decoded: ",
    "empty.png": "is empty",
    "gone": "does not exist",
    "loop.png": "cannot be read: Too many levels of symbolic links",
    "none.jpg": "does not exist",
    "oversized.png": "has more than ",
    "pipe.png": "cannot be read: it is a pipe or a device, not a file",
    "text.png": "is not an image",
    "tiny.png": "is 1×1 pixels",
    f"{LONG}.png": "File name too long",
    r"z\xff.png": "done",
    "\N{GRINNING FACE}.png": "done",
    "drive.mp4": "done",
    "drive/000003.png": "done",
    **{f"drive/{number:06d}": "done" for number in (0, 1)},
}


def test_each_odd_input_costs_its_own_row(call: Call, tmp_path: Path, out: Path) -> None:
    folder = tmp_path / "in"
    write_odd(folder)
    (tmp_path / "list.txt").write_text(f"{folder}\n{folder / 'gone'}/\n{folder / 'none.jpg'}\n")
    words = ("infer", f"@{tmp_path / 'list.txt'}", *ROWS, "--out", out)

    for count in ("4 done", "0 done, 4 skipped (done before)"):
        result = call(*words, "--jobs", "2")

        failed = sum(status != "done" for status in ODD.values())
        rows = read_index_rows(out)
        assert result.exit_code == 1
        assert f"roadtorch: {count}, {failed} failed; results in {out}\n" in result.stderr
        assert rows.keys() == ODD.keys()
        for file, problem in ODD.items():
            status = rows[file]["status"]
            assert problem in status
            assert status.startswith("failed: ") != (problem == "done")
            assert problem == "done" or f"roadtorch: {status}\n" in result.stderr
    assert (out / os.fsdecode(b"z\xff.mask.png")).exists()
    assert not list(out.rglob("*.part"))


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (ZeroDivisionError("oh\nno"), "ZeroDivisionError: oh no (report it)"),
        (MemoryError(), "b.png: needs more memory than is available (give smaller images"),
        (RuntimeError("DefaultCPUAllocator: can't allocate memory: you tried"), "needs more mem"),
        (ImportError("x.so: failed to map segment from shared object"), "needs more memory"),
    ],
)
def test_a_detector_that_trips_costs_one_row(
    error: Exception,
    message: str,
    run: Call,
    footage: Path,
    out: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    real = Inference.__call__

    def trips(self: Inference, image: torch.Tensor) -> Detection:
        if torch.equal(image, read_image(footage / "b.png")):
            raise error
        return real(self, image)

    monkeypatch.setattr(Inference, "__call__", trips)

    assert run().exit_code == 1
    assert message in read_index_rows(out)["b.png"]["status"]
    assert read_index_rows(out)["sub/c.png"]["status"] == "done"


@pytest.mark.parametrize(
    ("old", "new", "code"), [(",64,48,", ",64.0,48.0,", 0), (",64,", ",x,", 2)]
)
def test_an_index_that_a_spreadsheet_rewrote_is_read_or_refused(
    old: str, new: str, code: int, run: Call, out: Path
) -> None:
    words = ("--save", "polygons")
    run(*words)
    index = out / "index.csv"
    index.write_text(index.read_text().replace(old, new))

    assert run(*words).exit_code == code


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
        ("drive.mp4 drive/000003.png", f"infer in {KINDS}", "drive.mp4: both would write out/dri"),
        ("1.png run.png", f"infer in {KINDS}", "the run itself and in/run.png: both would write"),
        ("1.png 1.coco.png", f"infer in {KINDS}", "in/1.coco.png and in/1.png: both would write"),
        (r"1\xff.png " + os.fsdecode(b"1\xff.png"), f"infer in {KINDS}", r"in/1\xff.png and in/1"),
        ("b.png", "infer gone/", "gone: does not exist ("),
        ("b.png", "infer in --set device=cpu", "device: unknown setting"),
        ("b.png", "infer in --detector ''", "error: : unknown detector (known"),
        ("b.png", "infer in --end inf", "end: inf was given"),
        ("b.png", "infer ''", "'': is an empty name (give a file or a folder)"),
        ("b.png", "infer in --out s3://bucket/out", "s3:/bucket/out: is an address (give a local"),
        ("b.png", "infer in --out locked", "locked: another run is writing here (wait for it, or "),
        ("b.png", "label in --out in", "in/b.png: is one of the input images (give another --out)"),
    ],
)
def test_refusals(
    names: str, line: str, message: str, call: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
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
