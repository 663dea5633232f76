"""Recordings and the ego car that each shows: found, cut, kept, not looked for twice."""

from pathlib import Path

import cv2
import pytest
import torch

from roadtorch.base.image import read_image
from roadtorch.base.signals import Stop
from roadtorch.inputs.item import Item
from roadtorch.inputs.pictures import find_pictures
from roadtorch.train import recordings
from roadtorch.train.config import Recordings
from roadtorch.train.recordings import ego_of, find_ego_cars, is_line, recording_of, shape_of
from tests.train.runs import bonnet, write_bonnets, write_streets

NUMBERED = Recordings(separator="_", least=8)
FEW = Recordings(separator="_", least=3)
ALONE = (Stop(), True)


def overlap(one: torch.Tensor, other: torch.Tensor) -> float:
    return float((one & other).sum() / (one | other).sum())


@pytest.mark.parametrize(
    ("name", "separator", "recording"),
    [
        ("drive_007", "_", "drive"),
        ("a_drive_007", "_", "a_drive"),
        ("folder/007", "/", "folder"),
        ("drive007", "_", "drive007"),
        ("drive_007", "", "drive_007"),
    ],
)
def test_a_recording_is_what_stands_before_the_last_separator(
    name: str, separator: str, recording: str
) -> None:
    assert recording_of(name, separator) == recording


@pytest.fixture(scope="module")
def footage(tmp_path_factory: pytest.TempPathFactory) -> list[Item]:
    """Eight frames with a bonnet, one that cannot be read, and two of another camera."""
    folder = tmp_path_factory.mktemp("cameras")
    write_bonnets(folder, 8)
    (folder / "bonnet_9.png").write_bytes(b"not a picture")
    return find_pictures([str(write_streets(folder, 2))])


def test_the_ego_car_of_a_recording_is_found_cut_to_each_size_and_not_looked_for_again(
    footage: list[Item], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cars = find_ego_cars(footage, tmp_path, NUMBERED, *ALONE)

    image = read_image(footage[0].path)
    larger, wider = torch.zeros(3, 120, 160), torch.zeros(3, 60, 120)
    folder = cars[footage[0].name]
    for size, least in ((image, 0.9), (larger, 0.88)):
        ego = ego_of(folder, size)
        assert ego is not None
        assert ego.dtype == torch.bool
        assert overlap(ego, bonnet(*size.shape[1:])) > least
    assert ego_of(folder, wider) is None
    assert shape_of(larger) == shape_of(image) != shape_of(wider)
    # Of small recordings nothing is known.
    assert {name.partition("_")[0] for name in cars} == {"bonnet"}
    assert ego_of(cars.get("street_0"), image) is None

    monkeypatch.setattr(recordings, "still_ego", lambda _: pytest.fail("looked again"))
    assert find_ego_cars(footage, tmp_path, NUMBERED, *ALONE) == cars


@pytest.mark.parametrize("size", [(60, 80), (480, 640)])
def test_the_edge_of_a_bonnet_is_a_line_and_one_that_jumps_is_none(size: tuple[int, int]) -> None:
    at = torch.Generator().manual_seed(5)
    jumps = 0.7 + 0.1 * torch.rand(40, generator=at).repeat_interleave(size[1] // 40)
    rows = (torch.arange(size[0])[:, None] + 0.5) / size[0]

    assert is_line(bonnet(*size))
    assert not is_line(rows > jumps)


# --- looked at -----------------------------------------------------------------------------


@pytest.fixture
def shown(monkeypatch: pytest.MonkeyPatch) -> list[list[torch.Tensor]]:
    """The frames in which ego cars were looked for, and none was found."""
    calls: list[list[torch.Tensor]] = []
    monkeypatch.setattr(recordings, "still_ego", calls.append)
    return calls


def test_that_there_is_none_is_kept_until_a_frame_changes(
    footage: list[Item], shown: list[list[torch.Tensor]], tmp_path: Path
) -> None:
    for _ in range(2):
        cars = find_ego_cars(footage, tmp_path, NUMBERED, *ALONE)
    assert len(shown) == 1
    assert ego_of(cars["bonnet_0"], torch.zeros(3, 60, 80)) is None
    find_ego_cars(footage[:8], tmp_path, NUMBERED, *ALONE)
    assert len(shown) == 2


def test_of_long_recordings_evenly_spread_frames_are_looked_at_each_kept_small(
    shown: list[list[torch.Tensor]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recordings, "MAX_FRAMES", 4)
    for number in range(9):
        image = torch.full((900, 1200, 3), 20 * number).byte()
        cv2.imwrite(str(tmp_path / f"cam_{number}.png"), image.numpy())

    find_ego_cars(find_pictures([str(tmp_path)]), tmp_path / "kept", FEW, *ALONE)

    (frames,) = shown
    assert [round(float(frame.mean()) * 255 / 20) for frame in frames] == [0, 3, 6]
    assert {tuple(frame.shape) for frame in frames} == {(3, 480, 640)}


def test_nothing_is_looked_at_without_a_separator_or_after_a_request_to_stop(
    footage: list[Item], shown: list[list[torch.Tensor]], tmp_path: Path
) -> None:
    assert find_ego_cars(footage, tmp_path, Recordings(), *ALONE) == {}
    stop = Stop()
    stop.ask(15)
    find_ego_cars(footage, tmp_path, NUMBERED, stop, True)
    assert not shown
    assert not list(tmp_path.iterdir())
