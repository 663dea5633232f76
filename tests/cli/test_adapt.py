"""roadtorch adapt: real footage in; weights, a camera, a page and a sentence out."""

from pathlib import Path

import pytest

from roadtorch.camera.camera import Camera
from roadtorch.detectors.catalogue import load_detector
from roadtorch.io.image import read_image, write_colours
from roadtorch.layout.weights import load_network, read_origin
from tests.command import Call

QUICK = ("samples_per_epoch=16", "stopping.epochs=1", "teacher.views=one")
SMALL = ("network.height=64", "network.width=96")
SHORT = (*(word for one in (*QUICK, *SMALL) for word in ("--set", one)), "--threads", "1")


def test_halves_teach_apart_their_mean_comes_out_and_it_is_judged(
    call: Call, street: Path, tmp_path: Path
) -> None:
    out = tmp_path / "mine"

    done = call("adapt", street, "--out", out, *SHORT)

    assert done.exit_code == 0, done.stderr
    assert done.stdout.split(":")[0] in ("adopt", "do not adopt", "cannot tell")
    assert done.stdout.strip().splitlines()[-1] in (out / "adaptation.html").read_text("utf-8")
    assert "pictures have no times" in done.stderr
    mean, *halves = (
        load_network(out / name / "weights.safetensors") for name in ("", "first", "second")
    )
    of_mean, of_first, of_second = (
        next(iter(one.state_dict().values())) for one in (mean, *halves)
    )
    assert not of_first.equal(of_second)
    assert ((of_first + of_second) / 2).allclose(of_mean, atol=1e-3)
    assert (
        read_origin(out / "weights.safetensors")["config"]["teacher"]["detector"] == "fusion:large"
    )
    detector = load_detector(
        "fusion",
        weights={"file": str(out / "weights.safetensors")},
        camera=Camera.read(out / "camera.toml"),
    )
    assert detector.detect(read_image(street / "00.png")).mask.any()

    before = (out / "weights.safetensors").read_bytes()
    again = call("adapt", street, "--out", out, *SHORT)

    assert again.stdout == done.stdout
    assert (out / "weights.safetensors").read_bytes() == before
    other = call("adapt", street, "--out", out, "--frames", "4", *SHORT)
    assert other.exit_code == 2
    assert "holds frames of other footage" in other.stderr


def test_footage_that_stands_still_is_told_and_not_judged(
    call: Call, street: Path, tmp_path: Path
) -> None:
    same = tmp_path / "parked"
    same.mkdir()
    for number in range(10):
        write_colours(same / f"{number:02d}.png", read_image(street / "00.png"))

    labeller = ("--set", "teacher.detector=labeller")
    done = call("adapt", same, "--out", tmp_path / "out", *SHORT, *labeller)

    assert done.exit_code == 0
    assert "no camera.toml" in done.stderr
    told = "cannot tell: the footage stands still: both halves show the same\n"
    assert done.stdout == told
    assert not (tmp_path / "out/camera.toml").exists()


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("nothing",), "nothing"),
        (("--set", "kind=patches"), "network.height"),
        (("--set", "start="), "start"),
    ],
)
def test_what_cannot_be_adapted_is_told_in_a_line(
    call: Call, street: Path, tmp_path: Path, words: tuple[str, ...], told: str
) -> None:
    given = words if words[0] == "nothing" else (street, *words)

    done = call("adapt", *given, "--out", tmp_path / "out")

    assert done.exit_code != 0
    assert done.stderr.startswith("roadtorch: error: ")
    assert told in done.stderr
    assert done.stderr.count("\n") == 1
