"""Pictures, folders, configs and checkpoints that cannot be used: told, and nothing lost."""

import csv
import json
from pathlib import Path

import pytest
import torch

from roadtorch.cli import main
from roadtorch.errors import ConfigError, InputError, WeightsError
from roadtorch.train.config import Training, build_training
from roadtorch.train.run import Order, train
from tests.train.runs import (
    PATCHES,
    order_of,
    training_of,
    write_config,
    write_streets,
)


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


def test_a_folder_without_pictures_is_told(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()

    with pytest.raises(InputError, match="holds no pictures"):
        train(build_training({}), Order(str(tmp_path / "empty"), tmp_path / "run"))

    assert not (tmp_path / "run").exists()


def test_a_folder_with_broken_pictures_only_is_told(tmp_path: Path) -> None:
    (tmp_path / "bad").mkdir()
    (tmp_path / "bad" / "one.png").write_bytes(b"")

    with pytest.raises(InputError, match="holds no picture that can be used"):
        train(build_training({}), Order(str(tmp_path / "bad"), tmp_path / "run", quiet=True))


@pytest.fixture(scope="module")
def finished(
    streets: Path, kept: Path, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Training, Order]:
    folder = tmp_path_factory.mktemp("finished")
    training = training_of("patches", folder)
    order = order_of(streets, kept, folder / "run", "patches")
    train(training, order)
    return training, order


def again(order: Order, **changes: object) -> Order:
    return Order(**{**order.__dict__, "resume": True, **changes})  # type: ignore[arg-type]


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}


def test_a_folder_with_a_run_is_not_overwritten(finished: tuple[Training, Order]) -> None:
    training, order = finished
    before = contents(order.out)

    with pytest.raises(ConfigError, match="holds a run already"):
        train(training, order)

    assert contents(order.out) == before


def test_a_finished_run_stays_as_it_is(finished: tuple[Training, Order]) -> None:
    training, order = finished
    before = (order.out / "weights.safetensors").read_bytes()

    outcome = train(training, again(order))

    assert outcome.weights == order.out / "weights.safetensors"
    assert (order.out / "weights.safetensors").read_bytes() == before


@pytest.mark.parametrize(
    ("values", "what"),
    [
        ({"kind": "pictures"}, "kind: is 'pictures', and 'patches' in the run"),
        ({"mix": 3}, "mix: is 3, and 2 in the run"),
    ],
)
def test_the_config_of_another_network_is_told(
    values: dict[str, object], what: str, finished: tuple[Training, Order]
) -> None:
    training, order = finished
    changed = {**training.model_dump(), **values} if "mix" in values else values
    before = contents(order.out)

    with pytest.raises(ConfigError, match=what):
        train(build_training(changed), again(order))

    assert contents(order.out) == before


def test_other_pictures_are_told(finished: tuple[Training, Order], tmp_path: Path) -> None:
    training, order = finished

    with pytest.raises(ConfigError, match="holds a run on other pictures"):
        train(training, again(order, images=str(write_streets(tmp_path, 2))))


def test_labelled_pictures_of_other_settings_are_told(
    finished: tuple[Training, Order], tmp_path: Path
) -> None:
    training, order = finished
    changed = build_training({**training.model_dump(), "sites": {"around": 1}})

    with pytest.raises(ConfigError, match="holds pictures prepared with other settings"):
        train(changed, again(order, out=tmp_path / "new"))


def test_files_of_somebody_else_are_not_overwritten(streets: Path, tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text("mine")

    with pytest.raises(ConfigError, match=r"holds log.csv, which is not of a run"):
        train(build_training({}), Order(str(streets), tmp_path))

    assert (tmp_path / "log.csv").read_text() == "mine"


@pytest.mark.parametrize(
    ("state", "what"),
    [
        ({"format": 2}, "has the format 2; this roadtorch reads up to 1"),
        (b"<html></html>", "is damaged or no checkpoint"),
        (b"", "is damaged or no checkpoint"),
    ],
)
def test_checkpoints_that_cannot_be_used_are_told(
    state: object, what: str, streets: Path, kept: Path, tmp_path: Path
) -> None:
    training = training_of("patches", tmp_path)
    order = order_of(streets, kept, tmp_path / "run", "patches")
    train(training, order)
    path = order.out / "checkpoint.pt"
    path.write_bytes(state) if isinstance(state, bytes) else torch.save(state, path)
    before = contents(order.out)

    with pytest.raises(WeightsError, match=what):
        train(training, again(order))

    assert contents(order.out) == before


def test_a_run_of_older_code_goes_on_with_settings_that_are_new(
    streets: Path, kept: Path, tmp_path: Path
) -> None:
    training = training_of("patches", tmp_path)
    order = order_of(streets, kept, tmp_path / "run", "patches")
    train(training, order)
    path = order.out / "run.json"
    record = json.loads(path.read_text())
    del record["config"]["balance"]
    path.write_text(json.dumps(record))

    assert train(training, again(order)).weights


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
