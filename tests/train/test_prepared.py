"""Images prepared once."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest
import torch

from roadtorch.base.errors import ConfigError
from roadtorch.base.signals import StopRequest
from roadtorch.inputs.images import find_images
from roadtorch.inputs.item import Item
from roadtorch.run.memo import Arrays, cache_key, read_arrays
from roadtorch.train.prepared import Preparation, PreparedImage, prepare
from tests.train.runs import write_streets


class Maker:
    """A preparation that remembers the names of the images."""

    def __init__(self) -> None:
        self.names: list[str] = []

    def __call__(self, image: torch.Tensor, name: str) -> Arrays:
        self.names.append(name)
        return {"mean": image.mean((1, 2))}


@pytest.fixture
def images(tmp_path: Path) -> list[Item]:
    return find_images([str(write_streets(tmp_path / "footage", 3))])


def key_with(settings: dict[str, int], image: Item) -> str:
    return cache_key(settings, image.path)


def prepared(
    path: Path,
    images: list[Item],
    make: Callable[[torch.Tensor, str], Arrays],
    stop: StopRequest | None = None,
    **settings: int,
) -> list[PreparedImage]:
    preparation = Preparation(path / "kept", partial(key_with, settings), make)
    return prepare(images, preparation, stop or StopRequest(), quiet=True)


def test_images_are_made_ready_once(tmp_path: Path, images: list[Item]) -> None:
    make = Maker()

    first, second = (prepared(tmp_path, images, make) for _ in range(2))

    assert make.names == [image.name for image in images] == [f"street_{i}" for i in range(3)]
    assert first == second
    assert [item.name for item in first] == ["street_0.png", "street_1.png", "street_2.png"]
    assert all(item.file and read_arrays(item.file, "mean")["mean"].shape == (3,) for item in first)


def test_what_changed_or_is_damaged_is_made_again(tmp_path: Path, images: list[Item]) -> None:
    make = Maker()
    prepared(tmp_path, images, make)
    images[0].path.write_bytes(images[1].path.read_bytes())
    prepared(tmp_path, images, make)
    assert make.names[3:] == ["street_0"]
    prepared(tmp_path, images, make, around=1)
    assert make.names[4:] == [image.name for image in images]
    (tmp_path / "kept" / "street_2.png.npz").write_bytes(b"PK")
    prepared(tmp_path, images, make, around=1)
    assert make.names[7:] == ["street_2"]


def test_a_detector_that_trips_costs_one_image_a_wrong_setting_everything(
    tmp_path: Path, images: list[Item], capsys: pytest.CaptureFixture[str]
) -> None:
    def trips(image: torch.Tensor, name: str) -> Arrays:
        if name == "street_0":
            raise ZeroDivisionError("in a\nhurry")
        return {"mean": image.mean()}

    def wrong(_: torch.Tensor, __: str) -> Arrays:
        raise ConfigError("teacher.detector", "has no layout", "use another")

    made = prepared(tmp_path, images, trips)
    assert [item.file is None for item in made] == [True, False, False]
    assert "street_0.png: ZeroDivisionError: in a hurry (report it)" in capsys.readouterr().err
    with pytest.raises(ConfigError):
        prepared(tmp_path, images, wrong)
