"""Frames are kept in stretches, in halves, from pictures and videos, and once."""

from pathlib import Path

import pytest
import torch

from roadtorch.adapt.frames import keep_frames
from roadtorch.errors import ConfigError, InputError
from roadtorch.io.image import read_image, write_jpeg
from roadtorch.scenes.street import render_scene, write_picture
from tests.videos import write_video


@pytest.fixture
def pictures(tmp_path: Path) -> Path:
    for seed in range(10):
        write_picture(tmp_path / f"drive/{seed:02d}.png", render_scene(seed, 32, 48))
    return tmp_path / "drive"


def test_pictures_are_halved_in_their_order(pictures: Path, tmp_path: Path) -> None:
    kept = keep_frames([str(pictures)], tmp_path / "kept", 100, quiet=True)

    assert kept.halves == (5, 5)
    assert not kept.moving
    assert [one.name for one in kept.pictures("second")] == [
        f"second_{n:06d}" for n in range(5, 10)
    ]
    last, own = read_image(kept.pictures()[-1].path), read_image(pictures / "09.png")
    assert float((last - own).abs().mean()) < 0.02  # but for JPEG


def test_of_too_many_stretches_stay_evenly_spread(tmp_path: Path) -> None:
    drive = tmp_path / "drive"
    drive.mkdir()
    for number in range(60):
        write_jpeg(drive / f"{number:02d}.jpg", torch.full((3, 32, 48), number / 60))

    kept = keep_frames([str(drive)], tmp_path / "kept", 20, quiet=True)

    numbers = [round(float(one.read().mean()) * 60) for one in kept.pictures()]
    assert numbers == [first + step for first in (0, 10, 30, 40) for step in range(5)]
    assert len(list((tmp_path / "kept").glob("*.jpg"))) == kept.count


def test_of_a_video_some_frames_a_second_are_kept(tmp_path: Path) -> None:
    video = write_video(tmp_path / "drive.mp4", [number / 10 for number in range(25)])

    kept = keep_frames([str(video)], tmp_path / "kept", 100, quiet=True)

    assert kept.moving
    assert kept.count == 7  # at 0, .4, .8 … 2.4 of its 2.5 seconds


def test_a_picture_that_cannot_be_read_is_told_and_left_out(pictures: Path, tmp_path: Path) -> None:
    (pictures / "05.png").write_bytes(b"no picture")

    kept = keep_frames([str(pictures)], tmp_path / "kept", 100, quiet=True)

    assert kept.count == 9
    assert len(kept.skipped) == 1
    assert "05.png" in kept.skipped[0]


def test_what_was_kept_is_kept_and_other_footage_is_refused(pictures: Path, tmp_path: Path) -> None:
    first = keep_frames([str(pictures)], tmp_path / "kept", 100, quiet=True)
    times = [one.path.stat().st_mtime_ns for one in first.pictures()]

    again = keep_frames([str(pictures)], tmp_path / "kept", 100, quiet=True)

    assert again == first
    assert [one.path.stat().st_mtime_ns for one in again.pictures()] == times
    with pytest.raises(ConfigError, match="other footage"):
        keep_frames([str(pictures)], tmp_path / "kept", 50, quiet=True)


def test_frames_of_a_run_that_was_cut_short_are_kept_anew(
    pictures: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(path: Path, _: object) -> None:
        if path.stem.endswith("7"):
            raise KeyboardInterrupt
        path.write_bytes(b"")

    monkeypatch.setattr("roadtorch.adapt.frames.write_jpeg", full)
    with pytest.raises(KeyboardInterrupt):
        keep_frames([str(pictures)], tmp_path / "kept", 100, quiet=True)
    monkeypatch.undo()

    kept = keep_frames([str(pictures)], tmp_path / "kept", 100, quiet=True)

    assert kept.count == 10
    assert len(list((tmp_path / "kept").glob("*.jpg"))) == 10


def test_pictures_that_stand_where_frames_would_go_are_left_alone(
    pictures: Path, tmp_path: Path
) -> None:
    with pytest.raises(ConfigError, match="holds files that are not of a run"):
        keep_frames([str(pictures)], pictures, 100, quiet=True)

    assert len(list(pictures.iterdir())) == 10


def test_one_frame_is_no_footage(pictures: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="has 1 frame"):
        keep_frames([str(pictures / "00.png")], tmp_path / "kept", 100, quiet=True)
