import io
from pathlib import Path

import pytest

from roadtorch.base.errors import ConfigError, InputError
from roadtorch.inputs.find import camera_number, find_inputs, open_source, slug
from roadtorch.inputs.item import Selection
from tests.command import save_picture
from tests.videos import write_video


@pytest.fixture(scope="module")
def mixed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a.jpg, drive.mp4, sub/late.avi, and an overlay of ours."""
    root = tmp_path_factory.mktemp("mixed")
    save_picture(root / "a.jpg")
    write_video(root / "drive.mp4")
    (root / "sub").mkdir()
    write_video(root / "sub" / "late.avi", codec="mjpeg")
    (root / "drive.overlay.mp4").symlink_to("drive.mp4")
    return root


@pytest.mark.parametrize(
    ("end", "apart", "pictures", "videos"),
    [
        ("", None, ["a"], ["drive", "sub/late"]),
        ("", "sub", ["a"], ["drive"]),
        ("*.mp4", None, [], ["drive"]),
        ("drive.mp4", None, [], ["drive"]),
    ],
)
def test_folders_and_globs_are_searched_for_both(
    mixed: Path, end: str, apart: str | None, pictures: list[str], videos: list[str]
) -> None:
    inputs = find_inputs([str(mixed / end)], apart=mixed / apart if apart else None)

    assert [picture.name for picture in inputs.pictures] == pictures
    assert [source.name for source in inputs.sources] == videos
    assert inputs.sources[0].rate == 10


def test_names_come_from_standard_input_and_lists(mixed: Path, tmp_path: Path) -> None:
    listed = tmp_path / "list.txt"
    listed.write_text("b.png\n\nother.mp4\r\n")
    given = ["-", f"@{listed}", str(mixed / "a.jpg")]

    pictures, sources = find_inputs(given, names=io.StringIO("0\na.jpg\n"))

    assert [str(one.origin) for one in pictures] == ["a.jpg", "b.png", given[-1]]
    assert [one.origin for one in sources] == ["camera:0", "other.mp4"]


@pytest.mark.parametrize(
    ("given", "text", "problem"),
    [
        ("@none.txt", "", "none.txt: cannot be read"),
        ("-", "\n", "-: names nothing"),
        ("-", "\udcff\udcd8\udcff\udce0\0\x10JFIF", "-: takes names of files, not their bytes"),
    ],
)
def test_a_list_that_is_missing_or_empty_is_told(given: str, text: str, problem: str) -> None:
    with pytest.raises(InputError, match=problem):
        find_inputs([given], names=io.StringIO(text))


def test_a_file_named_0_wins(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert (camera_number("0"), camera_number("camera:12"), camera_number("0.png")) == (0, 12, None)

    (tmp_path / "0").write_bytes(b"")

    assert (camera_number("0"), camera_number("camera:0")) == (None, 0)


def test_addresses_give_names_without_passwords() -> None:
    (source,) = find_inputs(["rtsp://user:secret@10.0.0.4:554/stream1?x=1"]).sources

    assert source.live
    assert source.name == "10.0.0.4-554-stream1"
    assert "secret" not in source.origin
    assert slug("http://host/") == "host"


def test_one_source_of_an_input(mixed: Path) -> None:
    assert open_source(str(mixed / "drive.mp4"), Selection()).rate == 10
    pictures = open_source(str(mixed / "a.jpg"), Selection())
    assert (pictures.rate, pictures.count) == (None, 1)
    assert [frame.name for frame in pictures.items()] == ["a"]
    with pytest.raises(ConfigError, match="holds 2 videos and pictures"):
        open_source(str(mixed), Selection())
