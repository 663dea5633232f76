"""Pictures made ready: once, in shares, remade when they changed; arrays on disk."""

from pathlib import Path

import pytest
import torch

from roadtorch.errors import ConfigError, InputError
from roadtorch.runtime.signals import Stop
from roadtorch.sources.pictures import find_images
from roadtorch.train.prepared import (
    Arrays,
    PreparedFolder,
    from_bytes,
    read_arrays,
    to_bytes,
    write_arrays,
)
from roadtorch.train.processes import Processes
from tests.train.runs import write_streets


class Maker:
    """Counts how often it is asked, and of what."""

    def __init__(self) -> None:
        self.calls = 0
        self.names: list[str] = []
        self.last = torch.empty(0)

    def __call__(self, image: torch.Tensor, name: str) -> Arrays:
        self.calls += 1
        self.names.append(name)
        self.last = image.mean((1, 2))
        return {"mean": self.last}


def folder_in(path: Path, processes: Processes | None = None) -> PreparedFolder:
    return PreparedFolder(path / "kept", processes or Processes(quiet=True))


def test_pictures_are_made_ready_once(tmp_path: Path) -> None:
    pictures = find_images([str(write_streets(tmp_path / "footage", 3))])
    make = Maker()

    first = folder_in(tmp_path).prepare(pictures, make, "labels")
    second = folder_in(tmp_path).prepare(pictures, make, "labels")

    assert make.names == [picture.name for picture in pictures] == [f"street_{i}" for i in range(3)]
    assert first == second
    assert [item.name for item in first] == ["street_0.png", "street_1.png", "street_2.png"]
    assert all(item.file and read_arrays(item.file, "mean")["mean"].shape == (3,) for item in first)


def test_a_changed_picture_and_a_damaged_file_are_made_again(tmp_path: Path) -> None:
    footage = write_streets(tmp_path / "footage", 2)
    pictures = find_images([str(footage)])
    make = Maker()
    folder_in(tmp_path).prepare(pictures, make, "labels")
    (footage / "street_0.png").write_bytes((footage / "street_1.png").read_bytes())
    (tmp_path / "kept" / "street_1.png.npz").write_bytes(b"PK")

    folder_in(tmp_path).prepare(pictures, make, "labels")

    assert make.calls == 4


def test_each_process_makes_its_share(tmp_path: Path) -> None:
    pictures = find_images([str(write_streets(tmp_path / "footage", 3))])

    class Second(Processes):
        def gather(self, item: object) -> list[object]:  # type: ignore[override]
            return [item]

    made = folder_in(tmp_path, Second(1, 2)).prepare(pictures, Maker(), "labels")

    assert [item.name for item in made] == ["street_1.png"]


def test_a_detector_that_trips_costs_one_picture(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pictures = find_images([str(write_streets(tmp_path / "footage", 2))])
    calls: list[int] = []

    def make(image: torch.Tensor, _: str) -> Arrays:
        calls.append(1)
        if len(calls) == 1:
            raise ZeroDivisionError("in a\nhurry")
        return {"mean": image.mean()}

    made = folder_in(tmp_path).prepare(pictures, make, "labels")

    assert [item.file is None for item in made] == [True, False]
    assert "street_0.png: ZeroDivisionError: in a hurry (report it)" in capsys.readouterr().err


def test_a_wrong_setting_stops_everything(tmp_path: Path) -> None:
    pictures = find_images([str(write_streets(tmp_path / "footage", 1))])

    def make(_: torch.Tensor, __: str) -> Arrays:
        raise ConfigError("teacher.detector", "has no layout", "use another")

    with pytest.raises(ConfigError):
        folder_in(tmp_path).prepare(pictures, make, "labels")


def test_a_request_to_stop_is_heard_between_pictures(tmp_path: Path) -> None:
    pictures = find_images([str(write_streets(tmp_path / "footage", 3))])
    stop = Stop()

    def make(image: torch.Tensor, _: str) -> Arrays:
        stop.ask(15)
        return {"mean": image.mean()}

    made = folder_in(tmp_path, Processes(stop=stop)).prepare(pictures, make, "labels")

    assert len(made) == 1


def test_a_file_damaged_anywhere_is_made_again(tmp_path: Path) -> None:
    pictures = find_images([str(write_streets(tmp_path / "footage", 1))])
    make = Maker()
    kept = tmp_path / "kept" / "street_0.png.npz"
    folder_in(tmp_path).prepare(pictures, make, "labels")
    whole = kept.read_bytes()

    for at in range(0, len(whole), 7):
        calls = make.calls
        kept.write_bytes(whole[:at] + bytes([whole[at] ^ 255]) + whole[at + 1 :])
        folder_in(tmp_path).prepare(pictures, make, "labels")
        mean = read_arrays(kept, "mean")["mean"]
        assert make.calls == calls + 1 or torch.equal(mean, make.last)


# --- arrays -------------------------------------------------------------------------------


def test_arrays_come_back_all_or_those_that_are_named(tmp_path: Path) -> None:
    arrays = {"a": torch.arange(6, dtype=torch.int16).view(2, 3), "b": torch.tensor(7)}

    write_arrays(tmp_path / "a.npz", arrays)

    found = read_arrays(tmp_path / "a.npz")
    assert found.keys() == arrays.keys()
    assert all(torch.equal(found[name], value) for name, value in arrays.items())
    assert found["a"].dtype == torch.int16
    assert list(read_arrays(tmp_path / "a.npz", "b")) == ["b"]


def test_bytes_are_the_nearest_levels() -> None:
    levels = torch.arange(256, dtype=torch.uint8)

    assert torch.equal(to_bytes(from_bytes(levels)), levels)
    assert to_bytes(torch.tensor([0.0, 0.3 / 255, 0.7 / 255, 1.0])).tolist() == [0, 0, 1, 255]


def test_a_damaged_archive_is_told(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    write_arrays(path, {"a": torch.arange(100)})
    path.write_bytes(path.read_bytes()[:60])

    with pytest.raises(InputError, match="is damaged"):
        read_arrays(path)
