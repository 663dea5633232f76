"""roadtorch infer on images: files, second runs, and bad input."""

import os
import struct
import tomllib
import zlib
from hashlib import sha256
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from roadtorch.base.image import read_image, write_rgb
from roadtorch.detectors.catalogue import load_detector
from roadtorch.detectors.detection import Detection
from roadtorch.run.loop import Inference
from roadtorch.run.writers.maps import cue_image
from roadtorch.testing.scenes import render_scene
from tests.command import GREY, ROWS, Call, files_in, read_index_rows, save_image

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


# --- settings -------------------------------------------------------------------------------


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


# --- a second run ---------------------------------------------------------------------------


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


# --- bad input ------------------------------------------------------------------------------


def test_broken_images_become_failed_rows_beside_others(
    call: Call, footage: Path, out: Path
) -> None:
    whole = (footage / "a.jpg").read_bytes()
    (footage / "cut.jpg").write_bytes(whole[: len(whole) // 2])
    (footage / "empty.png").touch()
    (footage / "text.png").write_text("not an image")
    save_image(footage / "tiny.png", size=(1, 1))

    result = call("infer", footage, footage / "none.jpg", *ROWS, "--out", out, "--jobs", "2")

    assert result.exit_code == 1
    assert result.stderr.splitlines()[-1] == f"roadtorch: 3 done, 5 failed; results in {out}"
    rows = read_index_rows(out)
    for file, problem in [
        ("cut.jpg", "cannot be decoded"),
        ("empty.png", "is empty"),
        ("text.png", "is not an image"),
        ("tiny.png", "is 1×1 pixels"),
        ("none.jpg", "does not exist"),
    ]:
        assert rows[file]["status"].startswith("failed: ")
        assert problem in rows[file]["status"]
        assert file in result.stderr
    assert rows["a.jpg"]["status"] == "done"
    assert not any(name.endswith(".part") for name in files_in(out))
    assert "Traceback" not in result.stderr


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


# --- trust --------------------------------------------------------------------------------


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


# --- names and kinds of files -----------------------------------------------------------------


def test_odd_names_and_files_that_are_none(run: Call, footage: Path, out: Path) -> None:
    odd = footage / os.fsdecode(b"z\xff.jpg")
    (footage / "a.jpg").rename(odd)
    os.mkfifo(footage / "pipe.png")
    (footage / "loop.png").symlink_to(footage / "loop.png")

    for skipped in ("", "0 done, 3 skipped"):  # what is done under such a name is done
        result = run()
        assert result.exit_code == 1
        rows = read_index_rows(out)
        done = [file for file, row in rows.items() if row["status"] == "done"]
        assert done == ["b.png", "sub/c.png", r"z\xff.jpg"]
        assert set(rows) - set(done) == {"loop.png", "pipe.png"}
        assert skipped in result.stderr
    assert (out / os.fsdecode(b"z\xff.mask.png")).exists()


@pytest.mark.parametrize(
    ("kind", "reason"),
    [
        ("pipe", "cannot be read: it is a pipe or a device, not a file"),
        ("damaged", "cannot be decoded: "),
        ("oversized", "has more than "),
    ],
)
def test_a_first_image_that_cannot_be_read_is_a_failed_row(
    kind: str, reason: str, call: Call, tmp_path: Path, out: Path
) -> None:
    path = tmp_path / "in" / "x.png"
    path.parent.mkdir()
    if kind == "pipe":
        os.mkfifo(path)
    else:
        Image.new("L", (64, 48)).save(path)
        data = bytearray(path.read_bytes())
        if kind == "oversized":
            data[16:24] = struct.pack(">2I", 30_000, 6_000)
            data[29:33] = struct.pack(">I", zlib.crc32(data[12:29]))
        else:
            data[data.index(b"IDAT") - 1] -= 8  # its length
        path.write_bytes(data)

    result = call("infer", path.parent, *ROWS, "--out", out)

    assert result.exit_code == 1, result.stderr
    assert read_index_rows(out)["x.png"]["status"].startswith(f"failed: {path}: {reason}")
