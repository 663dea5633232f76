"""Video files: frames, time stamps, rotation, damage."""

import os
import re
import struct
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from itertools import islice
from pathlib import Path
from typing import Any

import av
import pytest
import torch
from av.error import FFmpegError
from av.video.reformatter import VideoReformatter

from roadtorch.base.decoding import MEGAPIXELS_VARIABLE
from roadtorch.base.errors import InputError
from roadtorch.inputs import video
from roadtorch.inputs.item import Item, Selection
from roadtorch.inputs.video import count_frames, video_frames, video_source
from tests.videos import hide_frames, street_pixels, write_tracks, write_video

FORTY = [n / 10 for n in range(40)]  # seconds of frames


def chosen(path: Path, **selection: float) -> list[Item]:
    return list(video_source(path, "drive", Selection(**selection)).items())  # pyright: ignore


def check_from(path: Path, start: float, limit: int = 5, **selection: float) -> list[int]:
    """Assert that frames from a start are those of the whole run; return their numbers."""
    every = {frame.number: frame for frame in chosen(path)}
    late = chosen(path, start=start, limit=limit, **selection)
    for frame in late:
        assert frame.seconds == pytest.approx(every[frame.number].seconds)
        assert torch.equal(frame.read(), every[frame.number].read())
    return [frame.number for frame in late]


def read_until_problem(path: Path) -> tuple[list[bool], str]:
    """Return whether each frame can be read, and the error at the end, "" without one."""
    frames: list[bool] = []
    try:
        for frame in video_frames(path, "drive"):
            frames.append(False)
            with suppress(InputError):
                frames[-1] = frame.read() is not None
    except InputError as error:
        return frames, error.problem if error.where == str(path) else str(error)
    return frames, ""


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
    seconds = [0, 0.04, 0.3, 0.31, 1.0, 2.5]
    varying = chosen(write_video(tmp_path / "varying.mkv", seconds))
    assert [frame.seconds for frame in varying] == pytest.approx(seconds)


@pytest.mark.parametrize("open_gop", ["0", "1"])
def test_frames_are_the_same_whatever_the_start(open_gop: str, tmp_path: Path) -> None:
    options = {"g": "7", "bf": "2", "x264-params": f"open-gop={open_gop}:scenecut=0"}
    path = write_video(tmp_path / "drive.mkv", FORTY, options=options)

    for start, first in ((0.05, 1), (0.7, 7), (1.95, 20), (3.9, 39)):
        assert check_from(path, start, 3)[0] == first
    assert check_from(path, 1.0, 3, every=4, end=2.5) == [10, 14, 18]


TURNS = [(a, 0, 0, d) for a in (1, -1) for d in (1, -1)]
TURNS += [(0, b, c, 0) for b in (1, -1) for c in (1, -1)]


@pytest.mark.parametrize("turn", TURNS)
def test_all_eight_display_matrices_are_applied(
    turn: tuple[int, int, int, int], tmp_path: Path
) -> None:
    path = write_video(tmp_path / "drive.mp4")
    stored, data = chosen(path)[0].read(), bytearray(path.read_bytes())
    at = data.index(b"tkhd") + 4 + 40  # ISO/IEC 14496-12, 8.3.2: version 0
    assert struct.unpack(">9i", data[at : at + 36])[0] == 65536
    a, b, c, d = (65536 * value for value in turn)
    data[at : at + 36] = struct.pack(">9i", a, b, 0, c, d, 0, 0, 0, 1 << 30)
    path.write_bytes(data)

    image = chosen(path)[0].read()

    y, x = torch.meshgrid(*map(torch.arange, stored.shape[1:]), indexing="ij")
    across, down = turn[0] * x + turn[2] * y, turn[1] * x + turn[3] * y
    expected = torch.empty_like(image)
    expected[:, down - down.min(), across - across.min()] = stored
    assert torch.equal(image, expected)


@pytest.mark.parametrize(("hidden", "start"), [(2, 1.0), (2, 2.0), (9, 1.5), (12, 0.5)])
def test_numbers_are_those_of_the_whole_run_in_a_trimmed_video(
    hidden: int, start: float, tmp_path: Path
) -> None:
    whole = write_video(tmp_path / "whole.mp4", FORTY, options={"g": "10", "bf": "0"})
    path = hide_frames(tmp_path / "drive.mp4", whole, hidden)

    assert count_frames(path) == 40 - hidden
    assert check_from(path, start) == [round(start * 10) + number for number in range(5)]


def test_numbers_are_those_of_the_whole_run_where_the_first_key_frame_is_cut_off(
    tmp_path: Path,
) -> None:
    options = {"g": "12", "bf": "2", "x264-params": "open-gop=1:scenecut=0"}
    path = write_video(tmp_path / "drive.ts", FORTY, options=options)
    with av.open(str(path)) as container:
        cut = [packet.pos for packet in container.demux(video=0)][5]
    data = path.read_bytes()
    path.write_bytes(data[: 3 * 188] + data[cut:])  # tables, then the sixth frame

    assert len(check_from(path, 2.5)) == 5


@pytest.mark.parametrize(("first", "second"), [(0, 0), (100, 0), (0, 0.5)])
def test_time_goes_on_where_recordings_were_joined(
    first: float, second: float, tmp_path: Path
) -> None:
    begins = {"a.ts": first, "b.ts": second}
    parts = [write_tracks(tmp_path / name, [(48, 64)], begin=begins[name]) for name in begins]
    path = tmp_path / "drive.ts"
    path.write_bytes(b"".join(part.read_bytes() for part in parts))

    with pytest.warns(UserWarning, match=r"drive\.ts: the clock steps by -") as caught:
        frames = chosen(path)

    assert [frame.seconds for frame in frames] == pytest.approx([n / 10 for n in range(20)])
    assert len(caught) == 1
    with pytest.warns(UserWarning, match="the clock steps"):
        late = chosen(path, start=1.2)
    assert [frame.number for frame in late] == list(range(12, 20))


@pytest.mark.parametrize("sizes", [[(48, 64), (96, 128)], [(96, 128), (48, 64)]])
@pytest.mark.parametrize("suffix", [".mp4", ".mkv"])
def test_the_largest_stream_is_read(
    sizes: list[tuple[int, int]], suffix: str, tmp_path: Path
) -> None:
    path = write_tracks(tmp_path / f"drive{suffix}", sizes)

    assert chosen(path)[0].read().shape == (3, 96, 128)


@pytest.mark.parametrize(
    ("suffix", "codec"), [(".mp4", "libx264"), (".webm", "libvpx"), (".avi", "mjpeg")]
)
def test_a_cut_video_is_read_to_its_end(suffix: str, codec: str, tmp_path: Path) -> None:
    path = write_video(tmp_path / f"drive{suffix}", FORTY, codec=codec, ticks=10)
    assert read_until_problem(path) == ([True] * 40, "")
    data = path.read_bytes()
    path.write_bytes(data[: len(data) * 6 // 10])

    # One core, then all: their decoders answer a cut packet differently.
    with ThreadPoolExecutor(1, initializer=os.sched_setaffinity, initargs=(0, {0})) as core:
        alone = core.submit(read_until_problem, path).result()
    for frames, error in (alone, read_until_problem(path)):
        assert 5 < sum(frames) < 40
        assert re.match(r"ends after \d\.\d of \d\.\d seconds$", error)
    assert len(list(islice(video_frames(path, "drive"), 5))) == 5  # who stops before is not told


@pytest.mark.parametrize(("suffix", "is_told"), [(".mp4", True), (".avi", False)])
def test_damage_in_the_middle(suffix: str, is_told: bool, tmp_path: Path) -> None:
    codec = "libx264" if is_told else "mpeg4"
    path = write_video(tmp_path / f"drive{suffix}", FORTY, codec=codec, ticks=10)
    data = path.read_bytes()
    start, end = len(data) * 45 // 100, len(data) * 55 // 100
    path.write_bytes(data[:start] + bytes(end - start) + data[end:])

    frames, error = read_until_problem(path)

    assert len(frames) > 20
    assert error.startswith("lacks ") if is_told else not all(frames)
    assert len(frames) == 40 or not is_told


@pytest.mark.parametrize("damaged", [8, 10])  # a key frame, and one that others depend on
@pytest.mark.parametrize(
    ("suffix", "codec", "options"),
    [
        (".mp4", "libx264", {"g": "8", "bf": "0"}),
        (".mkv", "libx264", {"g": "8", "bf": "2"}),
        (".webm", "libvpx", {"g": "8", "auto-alt-ref": "1", "lag-in-frames": "16"}),
    ],
)
def test_frames_keep_their_numbers_behind_a_damaged_packet(
    suffix: str, codec: str, options: dict[str, str], damaged: int, tmp_path: Path
) -> None:
    path = write_video(tmp_path / f"a{suffix}", FORTY, codec=codec, options=options, ticks=10)
    whole = [(frame.seconds, frame.number) for frame in video_frames(path, "a")]
    with av.open(str(path)) as container:
        packet = bytes([packet for packet in container.demux(video=0) if packet.size][damaged])
    noise = packet[:5] + b"\xa5" * (len(packet) - 5)
    path.write_bytes(path.read_bytes().replace(packet, noise, 1))

    numbers: list[tuple[float | None, int]] = []
    with suppress(InputError):
        for frame in video_frames(path, "a"):
            numbers.append((frame.seconds, frame.number))

    assert numbers == whole


@pytest.mark.parametrize(
    ("aspect", "size"),
    [("2", (48, 128)), ("1/2", (48, 32)), ("0", (48, 64)), ("200/201", (48, 64))],
)
def test_pixels_become_square(aspect: str, size: tuple[int, int], tmp_path: Path) -> None:
    path = write_video(tmp_path / "a.mp4", options={"aspect": aspect})

    assert chosen(path)[0].read().shape == (3, *size)


WHOLE: dict[str, dict[str, Any]] = {
    "a.mp4": {"options": {"bf": "3", "g": "12", "x264-params": "open-gop=1"}},
    "a.ts": {"options": {"x264-params": "interlaced=1"}},
    "a.webm": {"codec": "libvpx", "options": {"auto-alt-ref": "1", "lag-in-frames": "16"}},
    "a.avi": {"codec": "mpeg4", "options": {"bf": "2"}},
    "unstated.webm": {"codec": "libvpx", "live": True},
    "paused.avi": {"codec": "mjpeg", "seconds": [*FORTY[:20], 3.9]},
}


@pytest.mark.parametrize("name", WHOLE)
def test_whole_videos_are_read_without_a_word(name: str, tmp_path: Path) -> None:
    values = {"seconds": FORTY, "ticks": 10} | WHOLE[name]
    path = write_video(tmp_path / name, **values)

    assert read_until_problem(path) == ([True] * len(values["seconds"]), "")


@pytest.mark.parametrize("begin", [0.0, 2.0])
@pytest.mark.parametrize("suffix", [".mkv", ".flv", ".mp4", ".avi", ".ts", "untagged.mkv"])
def test_sound_may_outlast_the_images(suffix: str, begin: float, tmp_path: Path) -> None:
    path = write_tracks(tmp_path / f"drive{suffix}", [(48, 64)], sound=4.0, begin=begin)
    if suffix == "untagged.mkv":  # the tag of a track's duration
        path.write_bytes(path.read_bytes().replace(b"DURATION", b"LOCATION"))

    assert read_until_problem(path) == ([True] * 10, "")


@pytest.mark.parametrize(("missing", "is_told"), [(4, False), (7, True)])
def test_half_a_second_may_be_missing_at_the_end(
    missing: int, is_told: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write_video(tmp_path / "drive.mp4", FORTY)
    monkeypatch.setattr(video, "declared_duration", lambda *_: 4.0 + missing / 10)

    error = read_until_problem(path)[1]

    assert error == (f"ends after 4.0 of {4 + missing / 10:.1f} seconds" if is_told else "")


def test_damaged_vp8_shows_the_same_on_any_number_of_threads(tmp_path: Path) -> None:
    path = write_video(tmp_path / "a.webm", codec="libvpx")
    data = path.read_bytes()

    for at in range(2618, 2630, 2):
        path.write_bytes(data[:at] + bytes([data[at] ^ 0x10]) + data[at + 1 :])
        with av.open(str(path)) as container:
            container.streams.video[0].thread_type = "NONE"
            alone, reformatter = [], VideoReformatter()
            for packet in container.demux(video=0):
                with suppress(FFmpegError):
                    alone += [video.upright_image(reformatter, image) for image in packet.decode()]
        read = []
        with suppress(InputError):  # behind the last frame
            for frame in video_frames(path, "a"):
                with suppress(InputError):
                    read.append(frame.read())
        assert all(torch.equal(*pair) for pair in zip(read, alone, strict=True))


def test_too_many_pixels_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_video(tmp_path / "drive.mp4")
    monkeypatch.setenv(MEGAPIXELS_VARIABLE, "0.003")

    with pytest.raises(InputError, match=r"drive\.mp4: has 64 by 48 pixels, more than 0\.003 mega"):
        next(video_frames(path, "drive"))


@pytest.mark.parametrize(
    ("name", "start", "problem"),
    [
        ("song.mp4", 0.0, "has audio but no video"),
        ("codec.avi", 0.0, "uses a codec that FFmpeg cannot decode"),
        ("late.avi", 20.0, "has no frame from 20 s on"),
    ],
)
def test_what_has_no_images_to_give(name: str, start: float, problem: str, tmp_path: Path) -> None:
    path = tmp_path / name
    if name == "song.mp4":
        write_tracks(path, sound=1.0)
    else:
        write_video(path, codec="mjpeg")
    if name == "codec.avi":
        path.write_bytes(path.read_bytes().replace(b"MJPG", b"ZZZZ"))

    with pytest.raises(InputError) as caught:
        chosen(path, start=start)

    assert (caught.value.where, caught.value.problem) == (str(path), problem)
