"""Sampling of frames: runs of consecutive ones, halves, images and videos, only once."""

from pathlib import Path

import pytest
import torch

from roadtorch.base.errors import ConfigError, InputError, RoadtorchError
from roadtorch.base.image import read_image, write_rgb
from roadtorch.testing.scenes import render_scene, write_image
from roadtorch.train.adaptation.frames import SampledFrames, sample_frames
from tests.videos import write_video


@pytest.fixture(scope="module")
def images(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("drive")
    for seed in range(10):
        write_image(folder / f"{seed:02d}.png", render_scene(seed, 32, 48))
    return folder


def sample_of(footage: Path, folder: Path, most: int = 100) -> SampledFrames:
    return sample_frames([str(footage)], folder / "kept", most, quiet=True)


def test_images_are_halved_in_their_order_once(images: Path, tmp_path: Path) -> None:
    folder = tmp_path / "run[1]"  # no glob
    sample = sample_of(images, folder)

    assert sample.halves == (5, 5)
    assert not sample.has_times
    names = [frame.path.stem for frame in sample.images("second")]
    assert names == [f"second_{number:06d}" for number in range(5, 10)]
    last, original = read_image(sample.images()[-1].path), read_image(images / "09.png")
    assert float((last - original).abs().mean()) < 0.02  # but for JPEG

    times = [frame.path.stat().st_mtime_ns for frame in sample.images()]
    assert sample_of(images, folder) == sample
    assert [frame.path.stat().st_mtime_ns for frame in sample.images()] == times


def test_of_too_many_stretches_stay_evenly_spread(tmp_path: Path) -> None:
    drive = tmp_path / "drive"
    drive.mkdir()
    for number in range(60):
        write_rgb(drive / f"{number:02d}.jpg", torch.full((3, 32, 48), number / 60))

    sample = sample_of(drive, tmp_path, 20)

    numbers = [round(float(frame.read().mean()) * 60) for frame in sample.images()]
    assert numbers == [first + step for first in (0, 10, 30, 40) for step in range(5)]
    assert len(list((tmp_path / "kept").glob("*.jpg"))) == sample.frame_count


def test_of_a_video_some_frames_a_second_are_kept(tmp_path: Path) -> None:
    video = write_video(tmp_path / "drive.mp4", [number / 10 for number in range(25)])
    sample = sample_of(video, tmp_path)
    assert sample.has_times
    assert sample.frame_count == 7  # at 0, .4, .8 … 2.4 of its 2.5 seconds


def test_a_image_that_cannot_be_read_is_told_and_left_out(tmp_path: Path) -> None:
    for name in ("00.png", "02.png"):
        write_image(tmp_path / "drive" / name, render_scene(1, 32, 48))
    (tmp_path / "drive/01.png").write_bytes(b"no image")

    sample = sample_of(tmp_path / "drive", tmp_path)

    assert sample.frame_count == 2
    (message,) = sample.skipped
    assert "01.png" in message


def test_frames_of_a_run_that_was_cut_short_are_kept_anew(
    images: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(path: Path, _: object) -> None:
        if path.stem.endswith("7"):
            raise KeyboardInterrupt
        path.write_bytes(b"")

    monkeypatch.setattr("roadtorch.train.adaptation.frames.write_rgb", full)
    with pytest.raises(KeyboardInterrupt):
        sample_of(images, tmp_path)
    monkeypatch.undo()

    assert sample_of(images, tmp_path).frame_count == 10
    assert len(list((tmp_path / "kept").glob("*.jpg"))) == 10


def test_too_few_frames_are_not_taken_as_they_are_by_the_next_run(
    images: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        "roadtorch.train.adaptation.frames._frames", lambda *_: iter(())
    )  # all vanish
    with pytest.raises(InputError, match="has 0 frames"):
        sample_of(images, tmp_path)
    monkeypatch.undo()

    assert sample_of(images, tmp_path).frame_count == 10


def test_other_footage_and_single_images_are_refused(images: Path, tmp_path: Path) -> None:
    sample_of(images, tmp_path)
    refusals: list[tuple[Path, Path, int, type[RoadtorchError], str]] = [
        (images, tmp_path, 50, ConfigError, "other footage"),
        (images / "00.png", tmp_path / "one", 100, InputError, "has 1 frame"),
    ]
    for footage, folder, most, error, message in refusals:
        with pytest.raises(error, match=message):
            sample_of(footage, folder, most)
