import errno
from collections import deque
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from roadtorch.errors import InputError
from roadtorch.io.atomic import RoomyFile
from roadtorch.io.image import to_pixels
from roadtorch.scenes.street import render_scene
from roadtorch.sinks import video
from roadtorch.sinks.video import GifSink, VideoSink
from tests.videos import pixels_of, stamps_of, street_pixels


def write(
    path: Path, seconds: Sequence[float | None], size: tuple[int, int] = (48, 64), rate: float = 10
) -> Path:
    with closing(VideoSink(path, rate)) as sink:
        for number, at in enumerate(seconds):
            sink.write(street_pixels(number % 3, *size), at)
    return path


def test_time_stamps_are_kept_from_the_first_frame_on(tmp_path: Path) -> None:
    path = write(tmp_path / "x.mp4", [5.0, 5.04, 5.3, 7.0, 7.0 + 1001 / 30000])

    assert stamps_of(path) == pytest.approx([0, 0.04, 0.3, 2.0, 2 + 1001 / 30000], abs=2e-5)
    assert [one.name for one in tmp_path.iterdir()] == ["x.mp4"]
    still = write(tmp_path / "x.mp4", [0, 0.1, 0.1, 0.05, 0.2])
    assert len(stamps_of(still)) == 5  # time that stands still gives every frame


def test_without_a_clock_frames_follow_at_the_rate(tmp_path: Path) -> None:
    path = write(tmp_path / "x.mp4", [None] * 3, rate=4)

    assert stamps_of(path) == pytest.approx([0, 0.25, 0.5])


@pytest.mark.parametrize("size", [(47, 64), (48, 63), (47, 63)])
def test_odd_sides_are_padded(size: tuple[int, int], tmp_path: Path) -> None:
    frames = pixels_of(write(tmp_path / "x.mp4", [0, 0.1], size))

    assert frames[0].shape == (48, 64, 3)
    inside = frames[0][: size[0], : size[1]].astype(int)
    assert np.abs(inside - street_pixels(0, *size)).mean() < 8


def test_masks_stay_masks_and_other_sizes_become_the_first(tmp_path: Path) -> None:
    mask = np.zeros((48, 64), np.uint8)
    mask[20:40, 10:50] = 255
    with closing(VideoSink(tmp_path / "x.mp4", 10)) as sink:
        sink.write(mask, 0.0)
        sink.write(street_pixels(1, 96, 128), 0.1)

    frames = pixels_of(tmp_path / "x.mp4")
    assert ((frames[0][..., 0] > 127) == (mask > 0)).mean() > 0.99
    assert [one.shape for one in frames] == [(48, 64, 3)] * 2


def test_no_frame_gives_no_file(tmp_path: Path) -> None:
    write(tmp_path / "x.mp4", [])
    with closing(GifSink(tmp_path / "x.gif", 5.0, 6.0)) as gif:
        gif.write(street_pixels(0), 1.0)

    assert list(tmp_path.iterdir()) == []


def test_without_libx264_it_is_mpeg4_with_a_word(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(video, "ENCODERS", {"mpeg4": video.ENCODERS["mpeg4"]})

    with pytest.warns(UserWarning, match=r"x.mp4: PyAV has no libx264 here; written as mpeg4"):
        path = write(tmp_path / "x.mp4", [0, 0.04, 0.3])

    assert stamps_of(path) == pytest.approx([0, 0.04, 0.3], abs=1e-4)


class FullDisk:
    """A file in whose way stands a disk with room for so many bytes, and no more until let go."""

    def __init__(self, file: object, room: int) -> None:
        self.file, self.room = file, room

    def __getattr__(self, name: str) -> object:
        return getattr(self.file, name)

    def write(self, data: bytes) -> int:
        if self.room < len(data):
            raise OSError(errno.ENOSPC, "No space left on device")
        self.room -= len(data)
        return self.file.write(data)  # pyright: ignore[reportAttributeAccessIssue]


def fill_the_disk(patch: pytest.MonkeyPatch, room: int, held: int = video.ROOM) -> None:
    """Let every ``RoomyFile`` find room for so many bytes, and then what it held."""
    real = RoomyFile.__init__

    def opened(self: RoomyFile, path: Path, mode: str, size: int) -> None:
        real(self, path, mode, size)  # pyright: ignore[reportArgumentType]
        disk = FullDisk(self._file, room)
        let_go = self._let_go
        self._file = disk  # pyright: ignore[reportAttributeAccessIssue]

        def more() -> None:
            let_go()
            disk.room += held

        self._let_go = more

    patch.setattr(RoomyFile, "__init__", opened)


def test_a_full_disk_leaves_a_video_of_what_was_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fill_the_disk(monkeypatch, 30_000)
    sink = VideoSink(tmp_path / "x.mp4", 10)
    rng = np.random.default_rng(0)
    frames = (rng.integers(0, 255, (48, 64, 3), np.uint8) for _ in range(500))

    with pytest.raises(InputError, match=r"x.mp4: ends here: No space left .*\(make room"):
        deque((sink.write(pixels, None) for pixels in frames), maxlen=0)
    sink.close()

    assert len(pixels_of(tmp_path / "x.mp4")) > 5


def test_a_disk_without_any_room_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fill_the_disk(monkeypatch, 0, held=0)
    sink = VideoSink(tmp_path / "x.mp4", 10)

    with pytest.raises(InputError, match="ends here"):
        deque((sink.write(street_pixels(number % 3), None) for number in range(200)), maxlen=0)
    with pytest.raises(InputError, match=r"cannot be written: .*No space left"):
        sink.close()

    assert list(tmp_path.iterdir()) == []


def test_the_same_frames_give_the_same_bytes_wherever_memory_lies(tmp_path: Path) -> None:
    frames = [to_pixels(render_scene(seed, 270, 480).image) for seed in range(3)] * 8
    written = set()

    for number in range(2):
        _ = [np.full(200_000 + 3_000 * number, 77, np.uint8) for _ in range(30 + 7 * number)]
        with closing(VideoSink(tmp_path / "drive.mp4", 15.0)) as sink:
            for at, pixels in enumerate(frames):
                sink.write(pixels, at / 15)
        written.add((tmp_path / "drive.mp4").read_bytes())

    assert len(written) == 1


# --- GIF --------------------------------------------------------------------------------


def test_a_stretch_is_small_and_ten_a_second(tmp_path: Path) -> None:
    with closing(GifSink(tmp_path / "x.gif", 1.0, 2.0)) as sink:
        for number in range(90):
            sink.write(np.tile(street_pixels(number // 3 % 3), (10, 10, 1)), number / 30)

    with Image.open(tmp_path / "x.gif") as gif:
        assert gif.size == (480, 360)
        assert gif.n_frames == 10  # pyright: ignore[reportAttributeAccessIssue]
        assert gif.info["duration"] == pytest.approx(100, abs=10)
        assert gif.info["loop"] == 0
