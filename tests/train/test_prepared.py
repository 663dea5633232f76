"""Pictures made ready: once, remade when they changed; arrays on disk."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest
import torch

from roadtorch.base.errors import ConfigError, InputError
from roadtorch.base.signals import Stop
from roadtorch.inputs.item import Item
from roadtorch.inputs.pictures import find_pictures
from roadtorch.run.memo import Arrays, key_of, read_arrays, write_arrays
from roadtorch.train.prepared import (
    Preparation,
    PreparedPicture,
    from_bytes,
    prepare,
    to_bytes,
)
from tests.train.runs import write_streets


class Maker:
    """Remembers the names of the pictures that it was asked to make ready."""

    def __init__(self) -> None:
        self.names: list[str] = []

    def __call__(self, image: torch.Tensor, name: str) -> Arrays:
        self.names.append(name)
        return {"mean": image.mean((1, 2))}


@pytest.fixture
def pictures(tmp_path: Path) -> list[Item]:
    return find_pictures([str(write_streets(tmp_path / "footage", 3))])


def key_with(settings: dict[str, int], picture: Item) -> str:
    return key_of(settings, picture.path)


def prepared(
    path: Path,
    pictures: list[Item],
    make: Callable[[torch.Tensor, str], Arrays],
    stop: Stop | None = None,
    **settings: int,
) -> list[PreparedPicture]:
    preparation = Preparation(path / "kept", partial(key_with, settings), make)
    return prepare(pictures, preparation, stop or Stop(), quiet=True)


def test_pictures_are_made_ready_once(tmp_path: Path, pictures: list[Item]) -> None:
    make = Maker()

    first, second = (prepared(tmp_path, pictures, make) for _ in range(2))

    assert make.names == [picture.name for picture in pictures] == [f"street_{i}" for i in range(3)]
    assert first == second
    assert [item.name for item in first] == ["street_0.png", "street_1.png", "street_2.png"]
    assert all(item.file and read_arrays(item.file, "mean")["mean"].shape == (3,) for item in first)


def test_a_changed_picture_is_made_again_and_with_other_settings_all_are(
    tmp_path: Path, pictures: list[Item]
) -> None:
    make = Maker()
    prepared(tmp_path, pictures, make)
    pictures[0].path.write_bytes(pictures[1].path.read_bytes())
    prepared(tmp_path, pictures, make)
    assert make.names[3:] == ["street_0"]
    prepared(tmp_path, pictures, make, around=1)
    assert make.names[4:] == [picture.name for picture in pictures]


def test_a_file_damaged_anywhere_is_made_again(tmp_path: Path, pictures: list[Item]) -> None:
    make, file = Maker(), tmp_path / "kept" / "street_0.png.npz"
    prepared(tmp_path, pictures[:1], make)
    whole, mean = file.read_bytes(), read_arrays(file, "mean")["mean"]
    damaged = [
        whole[:at] + bytes([whole[at] ^ 255]) + whole[at + 1 :] for at in range(0, len(whole), 7)
    ]

    for data in [b"PK", *damaged]:
        calls = len(make.names)
        file.write_bytes(data)
        prepared(tmp_path, pictures[:1], make)
        again = read_arrays(file, "mean")["mean"]
        assert len(make.names) == calls + 1 or torch.equal(again, mean)


def test_a_detector_that_trips_costs_one_picture_a_wrong_setting_everything(
    tmp_path: Path, pictures: list[Item], capsys: pytest.CaptureFixture[str]
) -> None:
    def trips(image: torch.Tensor, name: str) -> Arrays:
        if name == "street_0":
            raise ZeroDivisionError("in a\nhurry")
        return {"mean": image.mean()}

    def wrong(_: torch.Tensor, __: str) -> Arrays:
        raise ConfigError("teacher.detector", "has no layout", "use another")

    made = prepared(tmp_path, pictures, trips)
    assert [item.file is None for item in made] == [True, False, False]
    assert "street_0.png: ZeroDivisionError: in a hurry (report it)" in capsys.readouterr().err
    with pytest.raises(ConfigError):
        prepared(tmp_path, pictures, wrong)


def test_a_request_to_stop_is_heard_between_pictures(tmp_path: Path, pictures: list[Item]) -> None:
    stop = Stop()

    def make(image: torch.Tensor, _: str) -> Arrays:
        stop.ask(15)
        return {"mean": image.mean()}

    assert len(prepared(tmp_path, pictures, make, stop)) == 1


# --- arrays -------------------------------------------------------------------------------


def test_arrays_come_back_all_or_those_that_are_named(tmp_path: Path) -> None:
    arrays = {"a": torch.arange(6, dtype=torch.int16).view(2, 3), "b": torch.tensor(7)}
    path = tmp_path / "a.npz"
    write_arrays(path, arrays)

    again = read_arrays(path)
    assert again.keys() == arrays.keys()
    assert all(torch.equal(again[name], value) for name, value in arrays.items())
    assert again["a"].dtype == torch.int16
    assert list(read_arrays(path, "b")) == ["b"]

    path.write_bytes(path.read_bytes()[:60])
    with pytest.raises(InputError, match="is damaged"):
        read_arrays(path)


def test_bytes_are_the_nearest_levels() -> None:
    levels = torch.arange(256, dtype=torch.uint8)

    assert torch.equal(to_bytes(from_bytes(levels)), levels)
    assert to_bytes(torch.tensor([0.0, 0.3 / 255, 0.7 / 255, 1.0])).tolist() == [0, 0, 1, 255]
