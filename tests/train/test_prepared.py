"""Images prepared once; recordings and their ego cars."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest
import torch

from roadtorch.base.errors import ConfigError
from roadtorch.base.image import read_image
from roadtorch.base.signals import StopRequest
from roadtorch.inputs.images import find_images
from roadtorch.inputs.item import Item
from roadtorch.run.memo import Arrays, cache_key, read_arrays
from roadtorch.train import recordings
from roadtorch.train.config import Recordings
from roadtorch.train.prepared import Preparation, PreparedImage, prepare
from roadtorch.train.recordings import aspect_bin, find_ego_cars, read_ego
from tests.train.runs import bonnet, write_bonnets, write_streets


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


# --- recordings -------------------------------------------------------------------------


NUMBERED = Recordings(separator="_", min_frames=8)
ALONE = (StopRequest(), True)


def overlap(a: torch.Tensor, b: torch.Tensor) -> float:
    return float((a & b).sum() / (a | b).sum())


@pytest.fixture(scope="module")
def footage(tmp_path_factory: pytest.TempPathFactory) -> list[Item]:
    """Write eight frames with a bonnet, one that cannot be read, and two of another camera."""
    folder = tmp_path_factory.mktemp("cameras")
    write_bonnets(folder, 8)
    (folder / "bonnet_9.png").write_bytes(b"not an image")
    return find_images([str(write_streets(folder, 2))])


def test_the_ego_car_of_a_recording_is_found_cut_to_each_size_and_not_looked_for_again(
    footage: list[Item], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cars = find_ego_cars(footage, tmp_path, NUMBERED, *ALONE)

    image = read_image(footage[0].path)
    larger, wider = torch.zeros(3, 120, 160), torch.zeros(3, 60, 120)
    folder = cars[footage[0].name]
    for size, least in ((image, 0.9), (larger, 0.88)):
        ego = read_ego(folder, size)
        assert ego is not None
        assert ego.dtype == torch.bool
        assert overlap(ego, bonnet(*size.shape[1:])) > least
    assert read_ego(folder, wider) is None
    assert aspect_bin(larger) == aspect_bin(image) != aspect_bin(wider)
    # Of small recordings nothing is known.
    assert {name.partition("_")[0] for name in cars} == {"bonnet"}
    assert read_ego(cars.get("street_0"), image) is None

    monkeypatch.setattr(recordings, "detect_ego_car", lambda _: pytest.fail("looked again"))
    assert find_ego_cars(footage, tmp_path, NUMBERED, *ALONE) == cars


# --- looked at -----------------------------------------------------------------------------


@pytest.fixture
def examined(monkeypatch: pytest.MonkeyPatch) -> list[list[torch.Tensor]]:
    """Return the frames in which ego cars are looked for, without finding any."""
    calls: list[list[torch.Tensor]] = []
    monkeypatch.setattr(recordings, "detect_ego_car", calls.append)
    return calls


def test_that_there_is_none_is_kept_until_a_frame_changes(
    footage: list[Item], examined: list[list[torch.Tensor]], tmp_path: Path
) -> None:
    _, cars = (find_ego_cars(footage, tmp_path, NUMBERED, *ALONE) for _ in range(2))
    assert len(examined) == 1
    assert read_ego(cars["bonnet_0"], torch.zeros(3, 60, 80)) is None
    find_ego_cars(footage[:8], tmp_path, NUMBERED, *ALONE)
    assert len(examined) == 2


def test_nothing_is_looked_at_without_a_separator_or_after_a_request_to_stop(
    footage: list[Item], examined: list[list[torch.Tensor]], tmp_path: Path
) -> None:
    assert find_ego_cars(footage, tmp_path, Recordings(), *ALONE) == {}
    stop = StopRequest()
    stop.request(15)
    find_ego_cars(footage, tmp_path, NUMBERED, stop, True)
    assert not examined
    assert not list(tmp_path.iterdir())
