import errno
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest
import torch
from av.error import InvalidDataError, PatchWelcomeError

from roadtorch.base.errors import InputError
from roadtorch.base.image import to_pixels
from roadtorch.detectors.detection import Detection
from roadtorch.inputs.item import Item
from roadtorch.run.writers.video import VideoWriter
from roadtorch.testing.scenes import render_scene
from tests.videos import read_frame_pixels, read_frame_times, street_pixels


def frame(number: int, seconds: float | None = None) -> Item:
    return Item(f"x/{number}", f"x {number}", torch.rand, number=number, seconds=seconds)


def detection(pixels: np.ndarray) -> Detection:
    """Return a detection that is drawn as these pixels."""
    likelihood = torch.zeros(pixels.shape[:2])
    return Detection(likelihood, likelihood > 0, {"pixels": torch.from_numpy(pixels)})


def draw_pixels(detection: Detection) -> np.ndarray:
    return detection.cues["pixels"].numpy()


def write(
    path: Path, seconds: Sequence[float], size: tuple[int, int] = (48, 64), rate: float = 10
) -> Path:
    with closing(VideoWriter(path, draw_pixels, rate)) as writer:
        for number, at in enumerate(seconds):
            writer.write(frame(number, at), detection(street_pixels(number % 3, *size)))
    return path


def test_time_stamps_are_kept_from_the_first_frame_on(tmp_path: Path) -> None:
    path = write(tmp_path / "x.mp4", [5.0, 5.04, 5.3, 7.0, 7.0 + 1001 / 30000])

    assert read_frame_times(path) == pytest.approx([0, 0.04, 0.3, 2.0, 2 + 1001 / 30000], abs=2e-5)
    assert [path.name for path in tmp_path.iterdir()] == ["x.mp4"]
    still = write(tmp_path / "x.mp4", [0, 0.1, 0.1, 0.05, 0.2])
    assert len(read_frame_times(still)) == 5  # time that stands still gives every frame
    write(tmp_path / "none.mp4", [])
    assert not (tmp_path / "none.mp4").exists()


@pytest.mark.parametrize("gap", [43_200, 1.7e9])
def test_long_gaps_are_cut_and_the_first_is_reported(gap: float, tmp_path: Path) -> None:
    seconds = [0, 0.1, gap, gap + 599, 2 * gap, 2 * gap + 0.1]

    with pytest.warns(
        UserWarning, match=r"^x\.mp4: the gap of \d+ seconds before frame 2"
    ) as caught:
        path = write(tmp_path / "x.mp4", seconds)

    expected = [0, 0.1, 600.1, 1199.1, 1799.1, 1799.2]
    assert read_frame_times(path) == pytest.approx(expected, abs=1e-4)
    assert len(caught) == 1


@pytest.mark.parametrize("step", [500.0, 1e-6, 1e-9])
def test_any_rate_gives_all_frames(step: float, tmp_path: Path) -> None:
    path = write(tmp_path / "x.mp4", [0, step, 2 * step], rate=1 / step)

    assert read_frame_times(path) == pytest.approx([0, step, 2 * step], abs=1e-4)


FULL = OSError(errno.ENOSPC, "No space left on device")


@pytest.mark.parametrize(
    ("error", "problem"),
    [
        (PatchWelcomeError(1, "Not yet implemented"), "cannot be encoded: Not yet implemented"),
        (InvalidDataError(1, "Not yet implemented"), "cannot be encoded: Not yet implemented"),
        (FULL, r"cannot be written: No space left on device \(make room"),
    ],
)
def test_an_error_of_encoder_or_disk_names_the_video_and_leaves_nothing(
    error: Exception, problem: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    writer = VideoWriter(tmp_path / "x.mp4", draw_pixels, 10)
    writer.write(frame(0), detection(street_pixels(0)))
    container = SimpleNamespace(mux=Mock(side_effect=error), close=writer._container.close)
    monkeypatch.setattr(writer, "_container", container)

    with pytest.raises(InputError, match=rf"x\.mp4: {problem}"):
        writer.write(frame(1), detection(street_pixels(1)))
    with pytest.raises(InputError, match=rf"x\.mp4: {problem}"):
        writer.close()

    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("size", [(47, 64), (48, 63), (47, 63)])
def test_odd_sides_are_padded(size: tuple[int, int], tmp_path: Path) -> None:
    frames = read_frame_pixels(write(tmp_path / "x.mp4", [0, 0.1], size))

    assert frames[0].shape == (48, 64, 3)
    inside = frames[0][: size[0], : size[1]].astype(int)
    assert np.abs(inside - street_pixels(0, *size)).mean() < 8


def test_masks_stay_masks_and_other_sizes_become_the_first(tmp_path: Path) -> None:
    mask = np.zeros((48, 64), np.uint8)
    mask[20:40, 10:50] = 255
    with closing(VideoWriter(tmp_path / "x.mp4", draw_pixels, 10)) as writer:
        writer.write(frame(0, 0.0), detection(mask))
        writer.write(frame(1, 0.1), detection(street_pixels(1, 96, 128)))

    frames = read_frame_pixels(tmp_path / "x.mp4")
    assert ((frames[0][..., 0] > 127) == (mask > 0)).mean() > 0.99
    assert [pixels.shape for pixels in frames] == [(48, 64, 3)] * 2


def test_the_same_frames_give_the_same_bytes_wherever_memory_lies(tmp_path: Path) -> None:
    frames = [to_pixels(render_scene(seed, 136, 240).image) for seed in range(3)] * 6
    written = set()

    for number in range(2):
        _ = [np.full(200_000 + 3_000 * number, 77, np.uint8) for _ in range(30 + 7 * number)]
        with closing(VideoWriter(tmp_path / "drive.mp4", draw_pixels, 15.0)) as writer:
            for at, pixels in enumerate(frames):
                writer.write(frame(at, at / 15), detection(pixels))
        written.add((tmp_path / "drive.mp4").read_bytes())

    assert len(written) == 1
