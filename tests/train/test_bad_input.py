"""Settings of training; images, folders and checkpoints that cannot be used: nothing is lost."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from roadtorch.base.atomic import lock_folder
from roadtorch.base.errors import ConfigError, InputError, RoadtorchError, WeightsError
from roadtorch.layout.patch_network import PatchNetwork
from roadtorch.layout.weights import save_network
from roadtorch.train.config import Descent, Training, build_training
from roadtorch.train.run import TrainingRequest, train
from tests.command import Call
from tests.train.runs import PATCHES, write_config, write_streets


def test_broken_images_are_skipped_and_listed(call: Call, tmp_path: Path) -> None:
    footage, out = write_streets(tmp_path / "footage", 1), tmp_path / "run"
    (footage / "broken.jpg").write_bytes(b"not an image")
    (footage / "cut.png").write_bytes((footage / "street_0.png").read_bytes()[:500])
    config = write_config(tmp_path / "c.toml", PATCHES)

    result = call("train", "--config", config, "--images", footage, "--out", out)

    assert result.exit_code == 1
    assert f"roadtorch: skipped: {footage}/broken.jpg: is not an image (" in result.stderr
    assert "2 skipped, see images.csv" in result.stderr
    rows = (out / "images.csv").read_text().splitlines()
    status = dict(row.split(",", 1) for row in rows)
    assert status["street_0.png"] == "used"
    assert "is not an image" in status["broken.jpg"]
    assert "cannot be decoded" in status["cut.png"]


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}


def test_a_folder_with_something_else_is_refused_and_stays_as_it_is(
    finished: tuple[Training, TrainingRequest], streets: Path, tmp_path: Path
) -> None:
    training, request = finished
    values = training.model_dump()
    whole, changed = map(build_training, ({"kind": "images"}, {**values, "shuffle_images": 3}))
    images = str(write_streets(tmp_path / "other", 2))
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "log.csv").write_text("mine")
    foreign = TrainingRequest(str(streets), tmp_path / "mine")
    save_network(tmp_path / "network", PatchNetwork(), {})
    start = build_training({**values, "initial_weights": str(tmp_path / "network")})
    new = TrainingRequest(str(streets), tmp_path / "new")
    rows: list[tuple[Training, TrainingRequest, type[RoadtorchError], str]] = [
        (whole, request, ConfigError, "holds a run with other settings"),
        (changed, request, ConfigError, "holds a run with other settings"),
        (training, replace(request, images=images), ConfigError, "holds a run with other images"),
        (training, foreign, ConfigError, r"log.csv: exists and was not written by roadtorch"),
        (start, new, WeightsError, "holds a network with other settings"),
    ]
    for run, refused, error, message in rows:
        old = contents(refused.out) if refused.out.exists() else None
        with pytest.raises(error, match=message):
            train(run, refused)
        assert (contents(refused.out) if refused.out.exists() else None) == old
    with lock_folder(request.out), pytest.raises(InputError, match="another run is writing here"):
        train(training, request)


@pytest.mark.parametrize(
    ("state", "message"),
    [
        ({"format": 3}, "has the format 3; this roadtorch reads 2"),
        (b"<html></html>", "is damaged or no checkpoint"),
        ({"format": 2, "progress": {"rows": 3}}, "is damaged or no checkpoint"),
        ({"format": 2, "progress": {}, "network": {}}, "holds another network"),
    ],
)
def test_checkpoints_that_cannot_be_used_are_refused(
    state: object, message: str, finished: tuple[Training, TrainingRequest]
) -> None:
    training, request = finished
    path = request.out / "checkpoint.pt"
    path.write_bytes(state) if isinstance(state, bytes) else torch.save(state, path)

    with pytest.raises(WeightsError, match=message):
        train(training, request)


# --- settings ---------------------------------------------------------------------------


EGO_CARS = {"kind": "images", "augmentation": {"ego_car": 0.5}}


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"kind": "patch"}, r"patch: unknown kind of training \(did you mean patches\?\)"),
        ({"kind": "images", "shuffle_images": 3}, "shuffle_images: unknown setting"),
        ({"kind": "images", "rounds": []}, "rounds: unknown setting"),
        ({"network": {"topology": {"size1": 9}}}, "topology: leaves an empty or odd"),
        ({"kind": "images", "network": {"width": 80}}, "network.width: .* multiple of 32"),
        ({"initial_weights": "imagenet"}, "initial_weights: is imagenet, but patches have no"),
        (EGO_CARS, "augmentation.ego_car: is 0.5, but only rendered worlds"),
    ],
)
def test_mistakes_are_told_with_their_key(values: dict[str, object], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        build_training(values)


def test_the_learning_rate_stays_or_falls_to_nothing() -> None:
    cosine = Descent(learning_rate=0.2, schedule="cosine")

    assert Descent(learning_rate=0.2).learning_rate_at(0.9) == 0.2
    assert cosine.learning_rate_at(0) == 0.2
    assert cosine.learning_rate_at(0.5) == pytest.approx(0.1)
    assert cosine.learning_rate_at(1) == pytest.approx(0)
