import re
import struct
from contextlib import suppress
from functools import partial
from itertools import islice
from pathlib import Path

import av
import numpy as np
import pytest
import torch
from av.error import FFmpegError

from roadtorch.errors import ConfigError, InputError
from roadtorch.io.decoding import MEGAPIXELS_VARIABLE
from roadtorch.sources import video
from roadtorch.sources.frame import Frame, Selection
from roadtorch.sources.video import count_frames, video_frames, video_source
from tests.videos import street_pixels, write_sound, write_video

FORTY = [n / 10 for n in range(40)]  # seconds of frames


def chosen(path: Path, **selection: float) -> list[Frame]:
    return list(video_source(path, "drive", Selection(**selection)).frames())  # pyright: ignore


def read_until_told(path: Path) -> tuple[list[Frame], str]:
    """The frames of a video that lacks some, and what is said behind the last one."""
    read: list[Frame] = []
    with pytest.raises(InputError) as caught:
        read.extend(iter(partial(next, video_frames(path, "drive")), None))
    assert caught.value.where == str(path)
    return read, caught.value.what


def spoiled(path: Path, start: float, end: float) -> None:
    """Put zeros between two shares of a file."""
    data = bytearray(path.read_bytes())
    place = slice(round(start * len(data)), round(end * len(data)))
    data[place] = bytes(len(data[place]))
    path.write_bytes(data)


def test_frames_have_names_numbers_and_seconds(tmp_path: Path) -> None:
    path = write_video(tmp_path / "drive.mp4")

    frames = chosen(path)

    assert [frame.number for frame in frames] == list(range(12))
    assert frames[3].name == "drive/000003"
    assert [frame.seconds for frame in frames] == pytest.approx([n / 10 for n in range(12)])
    assert count_frames(path) == 12
    image = frames[4].read()
    assert image.shape == (3, 48, 64)
    true = torch.from_numpy(street_pixels(1)).permute(2, 0, 1) / 255
    assert (image - true).abs().mean() < 0.03


@pytest.mark.parametrize(
    ("suffix", "codec"),
    [(".mp4", "mpeg4"), (".avi", "mjpeg"), (".mkv", "libx264"), (".ts", "libx264"),
     (".webm", "libvpx"), (".mov", "libx264")],
)  # fmt: skip
def test_containers_and_codecs(suffix: str, codec: str, tmp_path: Path) -> None:
    frames = chosen(write_video(tmp_path / f"drive{suffix}", codec=codec))

    assert len(frames) == 12
    seconds = [frame.seconds or 0.0 for frame in frames]
    assert seconds == pytest.approx([n / 10 for n in range(12)], abs=0.02)


def test_a_variable_rate_keeps_its_time_stamps(tmp_path: Path) -> None:
    seconds = [0, 0.04, 0.3, 0.31, 1.0, 2.5]

    frames = chosen(write_video(tmp_path / "drive.mkv", seconds))

    assert [frame.seconds for frame in frames] == pytest.approx(seconds)


@pytest.mark.parametrize("open_gop", ["0", "1"])
def test_a_frame_has_the_same_number_and_pixels_whatever_the_start(
    open_gop: str, tmp_path: Path
) -> None:
    options = {"g": "7", "bf": "2", "x264-params": f"open-gop={open_gop}:scenecut=0"}
    path = write_video(tmp_path / "drive.mkv", FORTY, options=options)
    every = {frame.number: frame for frame in chosen(path)}
    some = chosen(path, every=4, start=1.0, end=2.5, limit=3)
    assert [frame.number for frame in some] == [10, 14, 18]

    for start in (0.05, 0.7, 1.95, 3.9):
        late = chosen(path, start=start, limit=3)
        assert late[0].number == next(n for n in every if n / 10 >= start - 1e-9)
        for frame in late:
            assert frame.seconds == every[frame.number].seconds
            assert torch.equal(frame.read(), every[frame.number].read())


def test_what_lies_ahead_of_the_start_is_not_decoded(tmp_path: Path) -> None:
    options = {"g": "10", "x264-params": "scenecut=0"}
    path = write_video(tmp_path / "drive.mp4", FORTY, options=options)
    frames = video_frames(path, "drive", start=2.5)

    assert next(frames).number == 20
    frames.close()


def test_rotation_is_applied(tmp_path: Path) -> None:
    path = write_video(tmp_path / "drive.mp4")
    data = bytearray(path.read_bytes())
    matrix = data.index(b"tkhd") + 4 + 40  # ISO/IEC 14496-12, 8.3.2: version 0
    assert struct.unpack(">9i", data[matrix : matrix + 36])[0] == 65536
    upright = chosen(path)[0].read()
    turned = struct.pack(">9i", 0, 65536, 0, -65536, 0, 0, 0, 0, 1 << 30)  # 90° clockwise
    data[matrix : matrix + 36] = turned
    path.write_bytes(data)

    image = chosen(path)[0].read()

    assert torch.equal(image, torch.rot90(upright, -1, (1, 2)))


# --- what is wrong ----------------------------------------------------------------------


@pytest.mark.parametrize("suffix", [".mp4", ".mkv"])
def test_a_cut_video_gives_what_can_be_read_and_then_says_so(suffix: str, tmp_path: Path) -> None:
    path = write_video(tmp_path / f"drive{suffix}", FORTY, options={"crf": "1"})
    data = path.read_bytes()
    path.write_bytes(data[: len(data) * 6 // 10])

    read, told = read_until_told(path)

    assert 10 < len(read) < 40
    assert re.search(r"ends early, after \d\.\d of 4.0 seconds", told)
    with pytest.raises(InputError, match="ends early"):
        chosen(path)
    assert len(list(islice(video_frames(path, "drive"), 5))) == 5  # who stops before is not told


@pytest.mark.parametrize(
    ("suffix", "codec"),
    [(".avi", "mjpeg"), (".avi", "mpeg4"), (".mkv", "mjpeg"), (".webm", "libvpx"),
     (".mp4", "mpeg4")],
)  # fmt: skip
@pytest.mark.parametrize("place", [(0.6, 1.0), (0.45, 0.55)])
def test_frames_that_are_missing_are_told_in_numbers(
    suffix: str, codec: str, place: tuple[float, float], tmp_path: Path
) -> None:
    path = write_video(tmp_path / f"drive{suffix}", FORTY, codec=codec, ticks=10)
    whole = list(video_frames(path, "drive"))
    if place[1] == 1 and suffix != ".mp4":
        path.write_bytes(path.read_bytes()[: round(place[0] * path.stat().st_size)])
    else:
        spoiled(path, *place)

    read, told = read_until_told(path)

    assert len(whole) == 40
    assert f"{len(read)} of 40 frames" in told or "damaged frames" in told


@pytest.mark.parametrize(
    ("suffix", "codec", "options"),
    [
        (".mp4", "libx264", {"bf": "3", "g": "12", "x264-params": "open-gop=1"}),
        (".ts", "libx264", {"x264-params": "interlaced=1"}),
        (".webm", "libvpx", {"auto-alt-ref": "1", "lag-in-frames": "16"}),
        (".avi", "mpeg4", {"bf": "2"}),
    ],
)
def test_nothing_is_missing_in_a_whole_video(
    suffix: str, codec: str, options: dict[str, str], tmp_path: Path
) -> None:
    path = write_video(tmp_path / f"a{suffix}", FORTY, codec=codec, options=options, ticks=10)

    assert len(list(video_frames(path, "a"))) == 40
    assert len(list(video_frames(path, "a", 2.0))) <= 40


def test_matroska_that_was_sent_live_is_whole_and_without_its_end_is_not(tmp_path: Path) -> None:
    path = write_video(tmp_path / "a.webm", codec="libvpx", live=True)
    whole = list(video_frames(path, "a"))
    path.write_bytes(path.read_bytes()[:-10])

    read, told = read_until_told(path)

    assert len(whole) == 12
    assert len(read) >= 11
    assert "ends early" in told


def test_avi_that_counts_more_frames_than_it_has_is_told_and_a_frame_may_last(
    tmp_path: Path,
) -> None:
    whole = write_video(tmp_path / "a.avi", codec="mjpeg", ticks=10)
    slow = [n / 10 for n in range(40) if n != 20]
    paused = write_video(tmp_path / "b.avi", slow, codec="mjpeg", ticks=10)
    data = bytearray(whole.read_bytes())
    data[4473:4473] = data[78:230]
    del data[12382]  # a frame that nothing else lacks
    whole.write_bytes(data)

    with pytest.raises(InputError, match="11 of 12 frames"):
        list(video_frames(whole, "a"))
    assert len(list(video_frames(paused, "b"))) == 39


def test_damaged_vp8_shows_the_same_on_any_number_of_threads(tmp_path: Path) -> None:
    path = write_video(tmp_path / "a.webm", codec="libvpx")
    data = path.read_bytes()

    for at in range(2618, 2630):
        path.write_bytes(data[:at] + bytes([data[at] ^ 0x10]) + data[at + 1 :])
        with av.open(str(path)) as container:
            container.streams.video[0].thread_type = "NONE"
            alone = []
            for packet in container.demux(video=0):
                with suppress(FFmpegError):
                    alone += [video.upright(picture) for picture in packet.decode()]
        read = []
        with suppress(InputError):  # behind the last frame
            for frame in video_frames(path, "a"):
                with suppress(InputError):
                    read.append(frame.read())
        assert all(torch.equal(*pair) for pair in zip(read, alone, strict=True))


def test_a_video_of_more_pixels_than_allowed_is_refused_before_decoding(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write_video(tmp_path / "drive.mp4")
    monkeypatch.setenv(MEGAPIXELS_VARIABLE, "0.003")

    with pytest.raises(InputError, match=r"drive\.mp4: has 64 by 48 pixels, more than 0\.003 mega"):
        next(video_frames(path, "drive"))


def test_damage_in_the_middle_is_told_behind_the_last_frame(tmp_path: Path) -> None:
    path = write_video(tmp_path / "drive.mkv", FORTY[:30], codec="mpeg4")
    data = bytearray(path.read_bytes())
    middle = len(data) // 2
    data[middle : middle + 400] = np.random.default_rng(0).bytes(400)
    path.write_bytes(data)

    read, told = read_until_told(path)

    assert re.search(r"damaged frames: \d|ends early", told)
    assert len(read) > 10
    good = []
    for frame in read:
        with suppress(InputError):
            good.append(frame.read())
    assert 0 < len(good) < len(read)  # what is damaged is no picture


@pytest.mark.parametrize(
    ("name", "content", "line"),
    [
        ("text.mp4", b"no video", "cannot be decoded as video: "),
        ("empty.mp4", b"", "cannot be decoded as video: "),
        ("missing.mp4", None, "does not exist"),
    ],
)
def test_what_is_no_video(name: str, content: bytes | None, line: str, tmp_path: Path) -> None:
    if content is not None:
        (tmp_path / name).write_bytes(content)

    with pytest.raises(InputError, match=line):
        chosen(tmp_path / name)


def test_what_has_no_pictures_to_give(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="has sound and no moving pictures"):
        chosen(write_sound(tmp_path / "song.mp4"))
    path = write_video(tmp_path / "drive.avi", codec="mjpeg")
    with pytest.raises(InputError, match="has no frame from 20 s on"):
        chosen(path, start=20)
    path.write_bytes(path.read_bytes().replace(b"MJPG", b"ZZZZ"))
    with pytest.raises(InputError, match="codec that FFmpeg cannot decode"):
        chosen(path)


def test_without_pyav_the_extra_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    path = write_video(tmp_path / "drive.mp4")
    monkeypatch.setitem(__import__("sys").modules, "av", None)

    with pytest.raises(ConfigError, match=r"pip install 'roadtorch\[video\]'"):
        video.count_frames(path)


def test_a_name_in_any_encoding(tmp_path: Path) -> None:
    path = write_video(tmp_path / "drive.mp4")
    other = tmp_path / b"dr\xffve: 1.mp4".decode("utf-8", "surrogateescape")
    path.rename(other)

    assert len(chosen(other)) == 12
