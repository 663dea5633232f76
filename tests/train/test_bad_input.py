"""Pictures, folders, configs and checkpoints that cannot be used: told, and nothing lost."""

import csv
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from roadtorch.base.atomic import locked
from roadtorch.base.errors import ConfigError, InputError, RoadtorchError, WeightsError
from roadtorch.cli import main
from roadtorch.layout.patch_network import PatchNetwork
from roadtorch.layout.weights import save_network
from roadtorch.train.config import Training, build_training
from roadtorch.train.run import Request, train
from tests.train.runs import PATCHES, write_config, write_streets


def words_of(config: Path, images: Path, out: Path) -> list[str]:
    return ["train", "--config", str(config), "--images", str(images), "--out", str(out)]


def test_broken_pictures_are_skipped_and_listed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    footage = write_streets(tmp_path / "footage", 1)
    (footage / "broken.jpg").write_bytes(b"not a picture")
    (footage / "cut.png").write_bytes((footage / "street_0.png").read_bytes()[:500])
    config = write_config(tmp_path / "c.toml", PATCHES)

    with pytest.raises(SystemExit) as left:
        main(words_of(config, footage, tmp_path / "run"))

    stderr = capsys.readouterr().err
    assert left.value.code == 1
    assert f"roadtorch: skipped: {footage}/broken.jpg: is not a picture (" in stderr
    assert "one picture only" in stderr
    assert "2 skipped, see pictures.csv" in stderr
    with (tmp_path / "run" / "pictures.csv").open(newline="") as file:
        status = {row["file"]: row["status"] for row in csv.DictReader(file)}
    assert status["street_0.png"] == "used"
    assert "is not a picture" in status["broken.jpg"]
    assert "cannot be decoded" in status["cut.png"]


@pytest.mark.parametrize(
    ("names", "message"),
    [((), "holds no pictures"), (("one.png",), "holds no picture that can be used")],
)
def test_a_folder_without_pictures_that_can_be_used_is_refused(
    names: tuple[str, ...], message: str, tmp_path: Path
) -> None:
    (tmp_path / "bad").mkdir()
    for name in names:
        (tmp_path / "bad" / name).write_bytes(b"")

    with pytest.raises(InputError, match=message):
        train(build_training({}), Request(str(tmp_path / "bad"), tmp_path / "run", quiet=True))

    assert (tmp_path / "run").exists() == bool(names)


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}


def assert_refused(
    training: Training, request: Request, error: type[RoadtorchError], message: str
) -> None:
    """The run is refused with this message, and its folder stays as it was."""
    before = contents(request.out) if request.out.exists() else None
    with pytest.raises(error, match=message):
        train(training, request)
    assert (contents(request.out) if request.out.exists() else None) == before


def test_a_folder_with_something_else_is_refused(
    finished: tuple[Training, Request], tmp_path: Path
) -> None:
    training, request = finished
    values = training.model_dump()
    pictures, other = build_training({"kind": "pictures"}), build_training({**values, "mix": 3})
    images = str(write_streets(tmp_path / "other", 2))
    for run, changes, message in (
        (training, {"resume": False}, "holds a run already"),
        (pictures, {}, "kind: is 'pictures', and 'patches' in the run"),
        (other, {}, "mix: is 3, and 2 in the run"),
        (training, {"images": images}, "holds a run on other pictures"),
    ):
        assert_refused(run, replace(request, **changes), ConfigError, message)


def test_files_of_somebody_else_are_not_overwritten(streets: Path, tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text("mine")
    request = Request(str(streets), tmp_path)

    assert_refused(
        build_training({}), request, ConfigError, r"holds log.csv, which is not of a run"
    )


def test_two_runs_do_not_write_into_one_folder(finished: tuple[Training, Request]) -> None:
    training, request = finished
    with locked(request.out):
        assert_refused(training, request, InputError, "another run is writing here")


def test_weights_of_another_network_are_no_start(streets: Path, tmp_path: Path) -> None:
    save_network(tmp_path / "other", PatchNetwork(), {})
    training = build_training(
        {"start": str(tmp_path / "other"), "network": {"topology": {"k2": 4}}}
    )
    request = Request(str(streets), tmp_path / "run")

    assert_refused(training, request, WeightsError, "holds a network with other settings")


@pytest.mark.parametrize(
    ("state", "message"),
    [
        ({"format": 3}, "has the format 3; this roadtorch reads 2"),
        (b"<html></html>", "is damaged or no checkpoint"),
        (b"", "is damaged or no checkpoint"),
        ({"format": 2}, "is damaged or no checkpoint"),
        ({"format": 2, "progress": {"rows": 3}}, "is damaged or no checkpoint"),
        ({"format": 2, "progress": {}}, "is damaged or no checkpoint"),
        ({"format": 2, "progress": {}, "network": 1}, "is damaged or no checkpoint"),
        ({"format": 2, "progress": {}, "network": {}}, "holds another network"),
    ],
)
def test_checkpoints_that_cannot_be_used_are_refused(
    state: object, message: str, finished: tuple[Training, Request]
) -> None:
    training, request = finished
    path = request.out / "checkpoint.pt"
    path.write_bytes(state) if isinstance(state, bytes) else torch.save(state, path)

    assert_refused(training, request, WeightsError, message)


def test_mistakes_in_the_config_are_one_line(
    streets: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = write_config(tmp_path / "c.toml", 'kind = "patches"\n[network]\nheight = 120\n')

    with pytest.raises(SystemExit) as left:
        main(words_of(config, streets, tmp_path / "run"))

    stderr = capsys.readouterr().err
    assert left.value.code == 2
    assert stderr.startswith("roadtorch: error: network.height: unknown setting (")
    assert stderr.count("\n") == 1
    assert not (tmp_path / "run").exists()
