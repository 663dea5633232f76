import io
from pathlib import Path

import pytest

from roadtorch.errors import ConfigError, InputError
from roadtorch.sources.frame import Selection
from roadtorch.sources.open import (
    SourceOptions,
    camera_number,
    find_inputs,
    open_source,
    slug,
)
from tests.command import save_picture
from tests.videos import write_video


@pytest.fixture
def mixed(tmp_path: Path) -> Path:
    """A folder with a.jpg, drive.mp4, sub/late.avi, and an overlay of ours."""
    root = tmp_path / "mixed"
    save_picture(root / "a.jpg")
    write_video(root / "drive.mp4")
    (root / "sub").mkdir()
    write_video(root / "sub" / "late.avi", codec="mjpeg")
    write_video(root / "drive.overlay.mp4")
    return root


def test_a_folder_is_searched_for_both(mixed: Path) -> None:
    pictures, sources = find_inputs([str(mixed)])

    assert [picture.name for picture in pictures] == ["a"]
    assert [source.name for source in sources] == ["drive", "sub/late"]
    assert sources[0].rate == 10


def test_a_glob_stands_for_videos(mixed: Path) -> None:
    pictures, sources = find_inputs([str(mixed / "*.mp4")])

    assert pictures == []
    assert [one.name for one in sources] == ["drive"]


def test_the_folder_of_results_is_left_out(mixed: Path) -> None:
    sources = find_inputs([str(mixed)], options=SourceOptions(mixed / "sub")).sources

    assert [source.name for source in sources] == ["drive"]


def test_names_come_from_standard_input_and_lists(mixed: Path, tmp_path: Path) -> None:
    listed = tmp_path / "list.txt"
    listed.write_text("b.png\n\nother.mp4\r\n")
    given = ["-", f"@{listed}", str(mixed / "a.jpg")]

    pictures, sources = find_inputs(given, names=io.StringIO("0\na.jpg\n"))

    assert [str(one.origin) for one in pictures] == ["a.jpg", "b.png", given[-1]]
    assert [one.origin for one in sources] == ["camera:0", "other.mp4"]


def test_a_list_that_is_missing_or_empty_is_told(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"none.txt: cannot be read"):
        find_inputs([f"@{tmp_path / 'none.txt'}"])
    with pytest.raises(InputError, match="-: names nothing"):
        find_inputs(["-"], names=io.StringIO("\n"))
    with pytest.raises(InputError, match="-: takes names of files, not their bytes"):
        find_inputs(["-"], names=io.StringIO("\udcff\udcd8\udcff\udce0\0\x10JFIF"))


def test_a_file_named_0_wins(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert (camera_number("0"), camera_number("camera:12"), camera_number("0.png")) == (0, 12, None)

    (tmp_path / "0").write_bytes(b"")

    assert (camera_number("0"), camera_number("camera:0")) == (None, 0)


@pytest.mark.parametrize(
    ("url", "name"),
    [
        ("rtsp://user:secret@10.0.0.4:554/stream1?x=1", "10.0.0.4-554-stream1"),
        ("http://host/", "host"),
    ],
)
def test_addresses_give_names_without_passwords(url: str, name: str) -> None:
    assert slug(url) == name
    (source,) = find_inputs([url]).sources
    assert source.live
    assert source.name == name
    assert "secret" not in source.origin


def test_one_source_of_an_input(mixed: Path) -> None:
    assert open_source(str(mixed / "drive.mp4"), Selection()).moving
    pictures = open_source(str(mixed / "a.jpg"), Selection())
    assert not pictures.moving
    assert [frame.name for frame in pictures.frames()] == ["a"]
    with pytest.raises(ConfigError, match="holds 2 videos and pictures"):
        open_source(str(mixed), Selection())
