"""roadtorch adapt: weights, camera, page and verdict from real footage."""

from pathlib import Path
from typing import NoReturn
from unittest.mock import Mock

import pytest
from click.testing import CliRunner, Result

from roadtorch.base.errors import InputError
from roadtorch.base.image import read_image, write_rgb
from roadtorch.base.settings import find_config, read_settings_file
from roadtorch.camera.camera import Camera
from roadtorch.cli import main
from roadtorch.detectors.catalogue import load_detector
from roadtorch.layout.weights import load_network
from roadtorch.train.adaptation.adapt import limit_samples
from roadtorch.train.config import ImageTraining, build_training
from roadtorch.train.run import TrainingRun

SETTINGS = (
    *("samples_per_epoch=16", "stopping.epochs=1"),
    *("teacher.detector=labeller", "network.height=64", "network.width=96"),
)
SHORT = (*(word for setting in SETTINGS for word in ("--set", setting)), "--threads", "1")


def adapt(*words: object) -> Result:
    return CliRunner().invoke(main, ["adapt", *map(str, words)])


@pytest.fixture(scope="module")
def adapted(street: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Result]:
    """Run on the drive; return the folder and the result."""
    out = tmp_path_factory.mktemp("adapted") / "mine"
    return out, adapt(street, "--out", out, *SHORT)


def test_halves_teach_and_their_mean_is_judged(street: Path, adapted: tuple[Path, Result]) -> None:
    out, done = adapted

    assert done.exit_code == 0, done.stderr
    assert done.stdout.split(":")[0] in ("adopt", "do not adopt", "cannot tell")
    page = (out / "adaptation.html").read_text("utf-8")
    assert done.stdout.strip().splitlines()[-1] in page
    assert f"roadtorch adapt {street} --out {out} --set {SETTINGS[0]}" in page
    assert "images have no time stamps" in done.stderr
    assert ("to use it: roadtorch infer" in done.stderr) == done.stdout.startswith("adopt")
    files = [out / name / "weights.safetensors" for name in ("", "first", "second")]
    mean, first, second = (next(iter(load_network(file).state_dict().values())) for file in files)
    assert not first.equal(second)
    assert ((first + second) / 2).allclose(mean, atol=1e-3)
    camera = Camera.read(out / "camera.toml")
    detector = load_detector("fusion", weights={"file": str(files[0])}, camera=camera)
    assert detector.detect(read_image(street / "00.png")).mask.any()

    weights = files[0].read_bytes()
    assert adapt(street, "--out", out, *SHORT).stdout == done.stdout
    assert files[0].read_bytes() == weights
    refused = adapt(street, "--out", out, "--limit", "4", *SHORT)
    assert refused.exit_code == 2
    assert "holds frames of other footage" in refused.stderr


@pytest.mark.parametrize(("frames", "samples"), [(400, 384), (22, 22), (3, 16)])
def test_steps_follow_the_footage(frames: int, samples: int) -> None:
    training = build_training(read_settings_file(find_config("adapt")))
    assert isinstance(training, ImageTraining)

    assert limit_samples(training, frames).samples_per_epoch == samples


def test_frames_are_at_most_the_limit(street: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    limits: list[int] = []

    def take_limit(_: object, __: object, ___: object, limit: int, ____: bool) -> NoReturn:
        limits.append(limit)
        raise InputError("a", "b", "c")

    monkeypatch.setattr("roadtorch.train.adaptation.adapt.adapt", take_limit)
    for words in ((), ("--limit", "9")):
        assert adapt(street, "--out", "out", *words).exit_code == 2

    assert limits == [400, 9]


def test_a_run_cut_short_before_its_first_checkpoint_goes_on(
    street: Path, adapted: tuple[Path, Result], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "mine"
    (out / "frames").mkdir(parents=True)
    (out / "frames" / ".roadtorch.0123abcd.part").write_text("{")  # KILL within the first write
    with monkeypatch.context() as cut:
        cut.setattr(TrainingRun, "_train", Mock(side_effect=KeyboardInterrupt))
        assert adapt(street, "--out", out, *SHORT).exit_code != 0
    assert (out / "first/run.json").exists()
    assert not (out / "first/checkpoint.pt").exists()

    done = adapt(street, "--out", out, *SHORT)

    assert done.exit_code == 0, done.stderr
    for name in ("", "first", "second"):  # the logs hold times
        files = [folder / name / "weights.safetensors" for folder in (adapted[0], out)]
        assert files[0].read_bytes() == files[1].read_bytes()


def test_static_footage_is_reported_and_not_judged(street: Path, tmp_path: Path) -> None:
    for number in range(10):
        write_rgb(tmp_path / f"{number:02d}.png", read_image(street / "00.png"))

    done = adapt(tmp_path, "--out", tmp_path / "out", *SHORT)

    assert done.exit_code == 0
    assert "no camera.toml" in done.stderr
    sentence = "cannot tell: the footage is static: both halves show the same\n"
    assert done.stdout == sentence
    assert not (tmp_path / "out/camera.toml").exists()
