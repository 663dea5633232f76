"""Resolution of images and videos: files, folders, globs, lists, URLs; selections of items."""

import io
import shutil
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest
import torch

from roadtorch.base.atomic import claim_results, file_digest
from roadtorch.base.errors import ConfigError, InputError
from roadtorch.base.urls import slug
from roadtorch.inputs.find import find_inputs, open_source, parse_camera
from roadtorch.inputs.images import find_images
from roadtorch.inputs.item import Item, Selection, Source, evenly_spaced
from roadtorch.testing.scenes import render_scene, write_image
from tests.inputs.bags import ROS2, raw_image, write_bag
from tests.videos import write_video

BLACK = np.zeros((16, 16, 3), np.uint8)

NAMES = ["b.jpg", "a.PNG", "c[1].jpg", "sub/c.webp", "sub/deep/d.tif", ".hidden/e.jpg", "notes.txt"]
OWN = ["b.mask.png", "b.overlay.jpg", "b.likelihood.png", "b.cue.layout.png", "drive.overlay.mp4"]
LINKS = {"loop.png": "loop.png", "sub/around": "around", "sub/up": ".."}


@pytest.fixture(scope="module")
def footage(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write images and videos, results of roadtorch, links to themselves and an empty folder."""
    root = tmp_path_factory.mktemp("footage")
    (root / "bare").mkdir()
    for name in (*NAMES, *OWN):
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).touch()
    for name, target in LINKS.items():
        (root / name).symlink_to(target)
    write_video(root / "drive.mp4")
    write_video(root / "sub" / "late.avi", codec="mjpeg")
    return root


def test_images_that_are_not_read_and_linked_folders_are_named(tmp_path: Path) -> None:
    (tmp_path / "far").mkdir()
    names = ("a.jpg", "b.jfif", "c.HEIC", "sub/d.mpo", ".e.heic", "notes.txt", "sub/deep/f.jpg")
    for name in names:
        (tmp_path / "in" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "in" / name).touch()
    for name, target in {"more": "../far", "up": "..", "again": "sub"}.items():
        (tmp_path / "in" / name).symlink_to(target)

    unread = r"4 left out: more, b.jfif, c.HEIC, sub/d.mpo \("
    with pytest.warns(UserWarning, match=unread) as warnings:
        images, _ = find_inputs([str(tmp_path / "in")])

    assert [image.name for image in images] == ["a", "sub/deep/f"]
    assert len(warnings) == 1


ALL = ["a", "b", "c[1]", "loop", "sub/c", "sub/deep/d"]


@pytest.mark.parametrize(
    ("ends", "exclude", "images", "videos"),
    [
        ([""], "loop.png", ALL, ["drive", "sub/late"]),
        (["[sx]*/d*/**"], "none", ["sub/deep/d"], []),
        ([""], "sub", ["a", "b", "c[1]", "loop"], ["drive"]),
        (["*.PNG"], "none", ["a"], []),
        (["s*"], "none", ["sub/c", "sub/deep/d"], ["sub/late"]),
        (["*.mp4"], "none", [], ["drive"]),
        (["drive.mp4"], "none", [], ["drive"]),
        (["c[1].jpg"], "none", ["c[1]"], []),  # no glob, as it exists
        (["b.mask.png"], "none", ["b.mask"], []),  # asked for by name
        (["b.jpg", "b.jpg"], "none", ["b"], []),
        (["b.jpg", "none.jpg"], "none", ["b", "none"], []),  # reading that one fails
    ],
)
def test_folders_and_globs(
    footage: Path, ends: list[str], exclude: str, images: list[str], videos: list[str]
) -> None:
    inputs = find_inputs([f"{footage}/{end}" for end in ends], exclude=footage / exclude)

    assert [image.name for image in inputs.images] == images
    assert [source.name for source in inputs.sources] == videos
    assert {source.rate for source in inputs.sources if source.name == "drive"} <= {10}


# --- lists, addresses -------------------------------------------------------------


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])  # the last of Windows
def test_names_come_from_standard_input_and_lists(
    footage: Path, tmp_path: Path, encoding: str
) -> None:
    listed = tmp_path / "list.txt"
    listed.write_bytes("ü.png\n\nother.mp4\r\n".encode(encoding))
    arguments = ["-", f"@{listed}", str(footage / "b.jpg")]

    with patch("sys.stdin", io.StringIO("\ufeff0\r\na.jpg\n")):
        images, sources = find_inputs(arguments)

    assert [str(image.origin) for image in images] == ["a.jpg", "ü.png", arguments[-1]]
    assert [image.origin for image in sources] == ["camera:0", "other.mp4"]


@pytest.mark.parametrize(
    ("argument", "text", "error"),
    [
        ("@none.txt", "", "none.txt: cannot be read"),
        ("-", "\n", "-: contains no names"),
        ("", "", "'': is an empty name"),
        ("-", "\udcff\udcd8\udcff\udce0\0\x10JFIF", "-: expects file names, not the"),
    ],
)
def test_a_list_that_is_missing_or_empty_is_told(argument: str, text: str, error: str) -> None:
    with patch("sys.stdin", io.StringIO(text)), pytest.raises(InputError, match=error):
        find_inputs([argument])


def test_a_file_named_0_wins(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert (parse_camera("0"), parse_camera("camera:12"), parse_camera("0.png")) == (0, 12, None)

    (tmp_path / "0").write_bytes(b"")

    assert (parse_camera("0"), parse_camera("camera:0")) == (None, 0)


def test_addresses_give_names_without_passwords() -> None:
    (source,) = find_inputs(["rtsp://user:secret@10.0.0.4:554/stream1?x=1"]).sources

    assert source.live
    assert source.name == "10.0.0.4-554-stream1"
    assert "secret" not in source.origin
    assert slug("http://host/") == "host"


def test_one_source_of_an_input(footage: Path) -> None:
    assert open_source(str(footage / "drive.mp4"), Selection()).rate == 10
    images = open_source(str(footage / "b.jpg"), Selection())
    assert (images.rate, images.count) == (None, 1)
    assert [frame.name for frame in images.items()] == ["b"]
    with pytest.raises(ConfigError, match="holds 2 videos and images"):
        open_source(str(footage), Selection())


# --- items --------------------------------------------------------------------------------


def item(number: int, seconds: float | None = None) -> Item:
    read = lambda: torch.zeros(3, 2, 2)  # noqa: E731
    return Item(f"{number}", f"{number}", read, number=number, seconds=seconds)


@pytest.mark.parametrize(
    ("count", "counted", "expected"),
    [(100, True, [0, 33, 66]), (2, True, [0, 1]), (100, False, [0, 1, 2]), (0, True, [])],
)
def test_sampled_items_are_evenly_spaced(count: int, counted: bool, expected: list[int]) -> None:
    numbers: list[int] = []
    closed: list[bool] = []

    def items() -> Iterator[Item]:
        try:
            for number in range(count):
                numbers.append(number)
                yield item(number)
        finally:
            closed.append(True)

    opened = items()  # held here, so that it is not closed by itself
    source = Source("a", "a", lambda: opened, count=count if counted else None)

    assert [frame.number for frame in source.subsample(3).items()] == expected
    assert len(numbers) <= (expected[-1] + 1 if expected else 0)
    assert closed == [True]


@pytest.mark.parametrize(
    ("selection", "clock", "expected"),
    [
        (Selection(), True, [0, 1, 2, 3, 4, 5]),
        (Selection(every=2, start=0.1, limit=2), True, [1, 3]),
        (Selection(start=0.2, end=0.4), True, [2, 3]),
        (Selection(start=2, end=4), False, [2, 3]),  # one a second
    ],
)
def test_selections(selection: Selection, clock: bool, expected: list[int]) -> None:
    items = (item(number, number / 10 if clock else None) for number in range(6))

    assert [frame.number for frame in selection.select(items)] == expected


def test_images_have_no_time_and_values_are_spread() -> None:
    assert Selection(every=2, limit=2).select_images("abcdef") == "ac"
    with pytest.raises(ConfigError, match="images have no time stamps"):
        Selection(start=1).select_images("abc")
    assert [*evenly_spaced(range(10), 3)] == [0, 4, 8]
    assert [*evenly_spaced(range(2), 3)] == [0, 1]


def test_times_and_what_is_elsewhere() -> None:
    assert item(3).nanoseconds == 3_000_000_000
    assert item(3, 0.5).nanoseconds == 500_000_000
    with pytest.raises(InputError, match=r"s3://b/a: is not on this machine \(give files"):
        assert Item("a", "s3://b/a", torch.rand).path


# --- nothing left out, nothing twice, no results ------------------------------------------


def test_bags_in_a_folder_stand_beside_its_images_and_videos(tmp_path: Path) -> None:
    """A list of recordings makes a bag of a folder; other recordings are sources of their own."""
    folder = tmp_path / "in"
    for name in ("left", "right", "listed"):
        write_bag(tmp_path / name, {"/image": [raw_image(ROS2, BLACK, "rgb8", 10**18)]}, "mcap")
    shutil.copytree(tmp_path / "listed", folder / "listed")
    for name in ("left", "right"):
        (recording,) = (tmp_path / name).glob("*.mcap")
        shutil.copy(recording, folder / f"listed/{name}.mcap")
    (folder / "old.bag").write_bytes(b"#ROSBAG V2.0\n")
    write_video(folder / "drive.mp4")
    for name in ("a.png", "listed/b.png"):
        (folder / name).touch()
    (folder / "metadata.yaml").write_text("licence: free\n")

    images, sources = find_inputs([str(folder)])
    one, _ = find_inputs([str(folder / "listed")])

    assert [image.name for image in images] == ["a", "listed/b"]
    names = ["drive", "old", "listed", "listed/left", "listed/right"]
    assert [source.name for source in sources] == names
    assert [item.name for item in sources[3].items()] == ["listed/left/000000"]
    assert [image.name for image in one] == ["b"]
    with pytest.raises(InputError, match=r"old\.bag: cannot be read as a bag"):
        sources[1].items()
    with (
        pytest.warns(UserWarning, match=r"5 left out: drive\.mp4, old\.bag, listed, listed/left"),
        suppress(InputError),
    ):
        find_images([folder])


def test_results_in_a_ledger_are_no_inputs(tmp_path: Path) -> None:
    names = ("camera.jpg", "labels/a.png", "frames/b.jpg", "photo.jpg", "labels/photo.png")
    (tmp_path / "labels").mkdir()
    with (
        claim_results(tmp_path, {"cam{}.jpg": "", "frames/": ""}),
        claim_results(tmp_path / "labels", {"a.png": "../photo.jpg"}),
    ):
        (tmp_path / "frames").mkdir()
        for name in names:
            (tmp_path / name).touch()

    folder, pattern = (find_inputs([f"{tmp_path}{end}"]).images for end in ("", "/**/*.[jp]*"))
    below, single = (find_inputs([f"{tmp_path}{end}"]).images for end in ("/frames", "/camera.jpg"))

    assert [image.name for image in folder] == ["photo", "labels/photo"]
    assert {image.name for image in pattern} == {"photo", "labels/photo"}
    assert [image.name for image in (*below, *single)] == ["b", "camera"]


def test_a_link_to_its_own_folder_shows_no_image_twice(tmp_path: Path) -> None:
    (tmp_path / "a.png").touch()
    (tmp_path / "again").symlink_to(".")

    images = find_images([f"{tmp_path}/**/*.png"])
    same, _ = find_inputs([str(tmp_path), str(tmp_path / "again")])

    assert [image.name for image in images] == ["a"]
    assert [image.name for image in same] == ["a"]


def test_an_image_and_its_digest_are_of_the_same_bytes(tmp_path: Path) -> None:
    path = tmp_path / "snapshot.png"
    write_image(path, render_scene(0, 16, 16))
    (item,) = find_images([path])
    image, digest, held = item.read(), file_digest(path), item.hold()

    shown = held.read()
    write_image(path, render_scene(1, 16, 16))

    assert torch.equal(shown, image)
    assert held.digest is not None
    assert held.digest() == digest != file_digest(path)
