"""Pictures, folders, configs and checkpoints that cannot be used: told, and nothing lost."""

import csv
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch

from roadtorch.cli import main
from roadtorch.errors import ConfigError, InputError, WeightsError
from roadtorch.train.config import Training, as_values, build_training
from roadtorch.train.run import Request, train
from tests.train.runs import PATCHES, write_config, write_streets


def test_broken_pictures_are_skipped_and_listed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    footage = write_streets(tmp_path / "footage", 1)
    (footage / "broken.jpg").write_bytes(b"not a picture")
    (footage / "cut.png").write_bytes((footage / "street_0.png").read_bytes()[:500])
    config = write_config(tmp_path / "c.toml", PATCHES)

    with pytest.raises(SystemExit) as left:
        main(words_of(config, footage, tmp_path / "run"))

    told = capsys.readouterr().err
    assert left.value.code == 1
    assert f"roadtorch: skipped: {footage}/broken.jpg: is not a picture (" in told
    assert "one picture only" in told
    assert "2 skipped, see pictures.csv" in told
    with (tmp_path / "run" / "pictures.csv").open(newline="") as file:
        status = {row["file"]: row["status"] for row in csv.DictReader(file)}
    assert status["street_0.png"] == "used"
    assert "is not a picture" in status["broken.jpg"]
    assert "cannot be decoded" in status["cut.png"]


def words_of(config: Path, images: Path, out: Path) -> list[str]:
    return ["train", "--config", str(config), "--images", str(images), "--out", str(out)]


@pytest.mark.parametrize(
    ("names", "what"),
    [((), "holds no pictures"), (("one.png",), "holds no picture that can be used")],
)
def test_a_folder_without_pictures_that_can_be_used_is_told(
    names: tuple[str, ...], what: str, tmp_path: Path
) -> None:
    (tmp_path / "bad").mkdir()
    for name in names:
        (tmp_path / "bad" / name).write_bytes(b"")

    with pytest.raises(InputError, match=what):
        train(build_training({}), Request(str(tmp_path / "bad"), tmp_path / "run", quiet=True))

    assert (tmp_path / "run").exists() == bool(names)


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}


def test_a_folder_with_a_run_is_not_overwritten(finished: tuple[Training, Request]) -> None:
    training, request = finished
    before = contents(request.out)

    with pytest.raises(ConfigError, match="holds a run already"):
        train(training, replace(request, resume=False))

    assert contents(request.out) == before


@pytest.mark.parametrize(
    ("values", "what"),
    [
        ({"kind": "pictures"}, "kind: is 'pictures', and 'patches' in the run"),
        ({"mix": 3}, "mix: is 3, and 2 in the run"),
    ],
)
def test_the_config_of_another_network_is_told(
    values: dict[str, object], what: str, finished: tuple[Training, Request]
) -> None:
    training, request = finished
    given = {**training.model_dump(), **values} if "mix" in values else values
    before = contents(request.out)

    with pytest.raises(ConfigError, match=what):
        train(build_training(given), request)

    assert contents(request.out) == before


def test_other_pictures_are_told(finished: tuple[Training, Request], tmp_path: Path) -> None:
    training, request = finished

    with pytest.raises(ConfigError, match="holds a run on other pictures"):
        train(training, replace(request, images=str(write_streets(tmp_path, 2))))


def test_labelled_pictures_of_other_settings_are_told(
    finished: tuple[Training, Request], tmp_path: Path
) -> None:
    training, request = finished
    other = build_training({**training.model_dump(), "centres": {"around": 1}})

    with pytest.raises(ConfigError, match="holds pictures prepared with other settings"):
        train(other, replace(request, out=tmp_path / "new"))


def test_files_of_somebody_else_are_not_overwritten(streets: Path, tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text("mine")

    with pytest.raises(ConfigError, match=r"holds log.csv, which is not of a run"):
        train(build_training({}), Request(str(streets), tmp_path))

    assert (tmp_path / "log.csv").read_text() == "mine"


@pytest.mark.parametrize(
    ("state", "what"),
    [
        ({"format": 3}, "has the format 3; this roadtorch reads up to 2"),
        (b"<html></html>", "is damaged or no checkpoint"),
        (b"", "is damaged or no checkpoint"),
        ({"format": 1}, "is damaged or no checkpoint"),
        ({"format": 1, "progress": {"rows": 3}}, "is damaged or no checkpoint"),
        ({"format": 1, "progress": {}}, "is damaged or no checkpoint"),
        ({"format": 1, "progress": {}, "network": 1}, "is damaged or no checkpoint"),
        ({"format": 1, "progress": {}, "network": {}}, "holds another network"),
    ],
)
def test_checkpoints_that_cannot_be_used_are_told(
    state: object, what: str, finished: tuple[Training, Request]
) -> None:
    training, request = finished
    path = request.out / "checkpoint.pt"
    path.write_bytes(state) if isinstance(state, bytes) else torch.save(state, path)
    before = contents(request.out)

    with pytest.raises(WeightsError, match=what):
        train(training, request)

    assert contents(request.out) == before


# --- runs of older versions ------------------------------------------------------------------


def rewrite_config(out: Path, change: Callable[[dict[str, Any]], object]) -> None:
    """Change what run.json says of the settings of a run."""
    record = json.loads((out / "run.json").read_text())
    change(record["config"])
    (out / "run.json").write_text(json.dumps(record))


def test_a_run_of_older_code_goes_on_from_its_checkpoint(
    finished: tuple[Training, Request],
) -> None:
    """Without a mean of the weights, and with other names for the loss and the learning rate."""
    training, request = finished
    path = request.out / "checkpoint.pt"
    state = torch.load(path, weights_only=True)
    del state["average"]
    progress = state["progress"]
    progress["error"] = progress.pop("loss")
    for row in progress["rows"]:
        row["error"], row["rate"] = row.pop("loss"), row.pop("learning_rate")
    torch.save({**state, "format": 1}, path)
    before = (request.out / "weights.safetensors").read_bytes()

    assert train(training, request).weights
    assert (request.out / "weights.safetensors").read_bytes() == before


def test_a_run_of_older_code_goes_on_with_settings_that_are_new_or_had_other_names(
    finished: tuple[Training, Request],
) -> None:
    def older(config: dict[str, Any]) -> None:
        config["seed"] = config.pop("random_seed")
        config["sites"] = config.pop("centres")
        config["descent"]["rate"] = config["descent"].pop("learning_rate")
        del config["balance"]

    training, request = finished
    rewrite_config(request.out, older)

    assert train(training, request).weights
    assert json.loads((request.out / "run.json").read_text())["config"] == as_values(training)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda config: {"seed": config.pop("random_seed") + 1}, "random_seed: is 0, and 1"),
        (lambda _: {"fold": 3}, "fold: is not there, and 3"),
        (lambda _: {"kind": ["patches"]}, "kind: is "),
    ],
    ids=["old name", "gone", "no text"],
)
def test_other_settings_of_older_code_are_told_under_their_present_names(
    change: Callable[[dict[str, Any]], dict[str, Any]],
    told: str,
    finished: tuple[Training, Request],
) -> None:
    training, request = finished
    rewrite_config(request.out, lambda config: config.update(change(config)))
    before = contents(request.out)

    with pytest.raises(ConfigError, match=f"{told}.* in the run"):
        train(training, request)

    assert contents(request.out) == before


# --- configs -----------------------------------------------------------------------------------


def test_mistakes_in_the_config_are_one_line(
    streets: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = write_config(tmp_path / "c.toml", 'kind = "patches"\n[network]\nheight = 120\n')

    with pytest.raises(SystemExit) as left:
        main(words_of(config, streets, tmp_path / "run"))

    told = capsys.readouterr().err
    assert left.value.code == 2
    assert told.startswith("roadtorch: error: network.height: unknown setting (")
    assert told.count("\n") == 1
    assert not (tmp_path / "run").exists()


def test_ego_cars_of_footage_whose_recordings_are_not_known_are_refused() -> None:
    with pytest.raises(
        ConfigError, match=r"augmentation.ego_car.share: is 0.5, .*recordings.separator"
    ):
        build_training({"kind": "pictures", "augmentation": {"ego_car": {"share": 0.5}}})
