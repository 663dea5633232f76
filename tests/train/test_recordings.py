"""Recordings and the ego car that each shows: found, cut, kept, not looked for twice."""

from pathlib import Path

import cv2
import pytest
import torch

from roadtorch.io.image import read_image
from roadtorch.runtime.signals import Stop
from roadtorch.sources.pictures import Picture, find_images
from roadtorch.train import recordings
from roadtorch.train.config import Recordings
from roadtorch.train.processes import Processes
from roadtorch.train.recordings import ego_of, find_ego_cars, is_line, recording_of, shape_of
from tests.train.runs import bonnet, write_bonnets, write_streets

NUMBERED = Recordings(separator="_", least=8)


ALONE = Processes(quiet=True)


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


# --- found ---------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def footage(tmp_path_factory: pytest.TempPathFactory) -> list[Picture]:
    """Eight frames with a bonnet, one that cannot be read, and two of another camera."""
    folder = tmp_path_factory.mktemp("cameras")
    write_bonnets(folder, 8)
    (folder / "bonnet_9.png").write_bytes(b"not a picture")
    return find_images([str(write_streets(folder, 2))])


@pytest.fixture(scope="module")
def kept_at(footage: list[Picture], tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("ego-cars")
    find_ego_cars(footage, folder, NUMBERED, ALONE)
    return folder


def test_the_ego_car_of_a_recording_is_found(footage: list[Picture], kept_at: Path) -> None:
    found = find_ego_cars(footage, kept_at, NUMBERED, ALONE)

    image = read_image(footage[0].path)
    ego = ego_of(found[footage[0].name], image)
    assert ego is not None
    assert ego.dtype == torch.bool
    assert overlap(ego, bonnet(60, 80)) > 0.9


def test_it_is_cut_to_the_size_of_each_picture_of_that_shape(kept_at: Path) -> None:
    larger, wider = torch.zeros(3, 120, 160), torch.zeros(3, 60, 120)

    ego = ego_of(kept_at / "bonnet", larger)

    assert ego is not None
    assert overlap(ego, bonnet(120, 160)) > 0.88
    assert ego_of(kept_at / "bonnet", wider) is None
    assert shape_of(larger) == shape_of(torch.zeros(3, 60, 80)) != shape_of(wider)


def test_of_small_recordings_nothing_is_known(footage: list[Picture], kept_at: Path) -> None:
    found = find_ego_cars(footage, kept_at, NUMBERED, ALONE)

    assert {name.partition("_")[0] for name in found} == {"bonnet"}
    assert ego_of(found.get("street_0"), torch.zeros(3, 60, 80)) is None


def test_what_was_found_is_not_looked_for_again(
    footage: list[Picture], kept_at: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recordings, "still_ego", lambda _: pytest.fail("looked again"))

    found = find_ego_cars(footage, kept_at, NUMBERED, ALONE)

    assert ego_of(found["bonnet_0"], torch.zeros(3, 60, 80)) is not None


@pytest.mark.parametrize("size", [(60, 80), (120, 160), (480, 640)])
def test_the_edge_of_a_bonnet_is_a_line_and_one_that_jumps_is_none(size: tuple[int, int]) -> None:
    at = torch.Generator().manual_seed(5)
    jumps = 0.7 + 0.1 * torch.rand(40, generator=at).repeat_interleave(size[1] // 40)
    rows = (torch.arange(size[0])[:, None] + 0.5) / size[0]

    assert is_line(bonnet(*size))
    assert not is_line(rows > jumps)


# --- looked at -----------------------------------------------------------------------------


class Looker:
    """Finds no ego car, and remembers the frames that it was shown."""

    def __init__(self) -> None:
        self.shown: list[list[torch.Tensor]] = []

    def __call__(self, frames: list[torch.Tensor]) -> None:
        self.shown.append(frames)


@pytest.fixture
def looker(monkeypatch: pytest.MonkeyPatch) -> Looker:
    found = Looker()
    monkeypatch.setattr(recordings, "still_ego", found)
    return found


def test_that_there_is_none_is_kept_as_well(
    footage: list[Picture], looker: Looker, tmp_path: Path
) -> None:
    for _ in range(2):
        found = find_ego_cars(footage, tmp_path, NUMBERED, ALONE)

    assert len(looker.shown) == 1
    assert ego_of(found["bonnet_0"], torch.zeros(3, 60, 80)) is None


def test_frames_of_another_shape_are_looked_at_by_themselves(
    looker: Looker, tmp_path: Path
) -> None:
    for number in range(6):
        shape = (20, 20) if number % 2 else (20, 40)
        cv2.imwrite(str(tmp_path / f"cam_{number}.png"), torch.zeros(*shape, 3).byte().numpy())
    pictures = find_images([str(tmp_path)])

    few = Recordings(separator="_", least=3)
    find_ego_cars(pictures, tmp_path / "kept", few, ALONE)

    assert [{tuple(frame.shape) for frame in frames} for frames in looker.shown] == [
        {(3, 20, 40)},
        {(3, 20, 20)},
    ]


def test_of_long_recordings_evenly_spread_frames_are_looked_at_each_kept_small(
    looker: Looker, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recordings, "MAX_FRAMES", 4)
    for number in range(9):
        image = torch.full((900, 1200, 3), 20 * number).byte()
        cv2.imwrite(str(tmp_path / f"cam_{number}.png"), image.numpy())
    pictures = find_images([str(tmp_path)])

    few = Recordings(separator="_", least=3)
    find_ego_cars(pictures, tmp_path / "kept", few, ALONE)

    (frames,) = looker.shown
    assert [round(float(frame.mean()) * 255 / 20) for frame in frames] == [0, 3, 6]
    assert {tuple(frame.shape) for frame in frames} == {(3, 480, 640)}


def test_without_a_separator_there_are_no_recordings(
    footage: list[Picture], looker: Looker, tmp_path: Path
) -> None:
    assert find_ego_cars(footage, tmp_path, Recordings(), ALONE) == {}
    assert not looker.shown


def test_a_request_to_stop_is_heard_between_recordings(
    footage: list[Picture], looker: Looker, tmp_path: Path
) -> None:
    stop = Stop()
    stop.ask(15)

    find_ego_cars(footage, tmp_path, NUMBERED, Processes(stop=stop))

    assert not looker.shown
    assert not list(tmp_path.iterdir())
