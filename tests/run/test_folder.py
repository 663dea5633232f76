"""The folder of a run's results: here or behind a URL, for one run alone; who owns which name."""

import fcntl
import os
import uuid
from collections.abc import Sequence
from pathlib import Path

import fsspec
import pytest

from roadtorch.base.errors import ConfigError, InputError
from roadtorch.base.urls import is_url, url_bytes
from roadtorch.inputs.pictures import find_pictures, picture_item
from roadtorch.run.folder import Owners, ResultFolder, result_folder


@pytest.fixture
def url() -> str:
    return f"memory://{uuid.uuid4().hex}/out"


def put(folder: ResultFolder, name: str, text: str) -> None:
    with folder.staged() as place:
        (place / name).parent.mkdir(parents=True, exist_ok=True)
        (place / name).write_text(text)


@pytest.mark.parametrize("remote", [False, True])
def test_what_is_put_is_read(remote: bool, url: str, tmp_path: Path) -> None:
    folder = ResultFolder(tmp_path, url if remote else "")
    put(folder, "sub/x.txt", "one")
    put(folder, "sub/x.txt", "two")

    assert str(folder) == (url if remote else str(tmp_path))
    assert folder.read("sub/x.txt") == b"two"
    assert folder.has("sub/x.txt")
    assert not folder.has("sub")
    assert folder.read("y.txt") is None
    assert any(tmp_path.iterdir()) != remote
    if remote:
        (tmp_path / "index.csv").write_text("file\n")
        folder.publish(tmp_path / "index.csv")
        assert folder.read("index.csv") == b"file\n"
        names = fsspec.filesystem("memory").find(url.removeprefix("memory:/"))
        assert [name.rpartition("/")[2] for name in names] == ["index.csv", "x.txt"]


def test_a_bag_that_is_a_folder_is_there_once_it_has_its_list(tmp_path: Path) -> None:
    (tmp_path / "a.road").mkdir()

    assert not ResultFolder(tmp_path).has("a.road")
    (tmp_path / "a.road" / "metadata.yaml").touch()
    assert ResultFolder(tmp_path).has("a.road")


def test_leftovers_of_killed_workers_are_removed(url: str, tmp_path: Path) -> None:
    folder = ResultFolder(tmp_path, url)
    put(folder, "sub/.roadtorch.01234567.part", "half")
    put(folder, "sub/x.part", "not ours")

    with result_folder(url, "a = 1", overwrite=False) as opened:
        assert not opened.has("sub/.roadtorch.01234567.part")
        assert opened.has("sub/x.part")


@pytest.mark.parametrize("remote", [False, True])
def test_results_of_other_settings_are_not_mixed_in(remote: bool, url: str, tmp_path: Path) -> None:
    out = url if remote else str(tmp_path / "out")
    for effective in ("a = 1", "a = 2"):  # nothing was done with the first ones
        with result_folder(out, effective, overwrite=False) as folder:
            assert folder.read("config.toml") == f"{effective}\n".encode()
    with result_folder(out, "a = 2", overwrite=False) as folder:
        (folder.path / "index.csv").write_text("file\n")
        folder.publish(folder.path / "index.csv")

    with (
        pytest.raises(ConfigError, match=r"holds results of other settings \(config\.toml\)"),
        result_folder(out, "a = 1", overwrite=False),
    ):
        pass
    with result_folder(out, "a = 1", overwrite=True) as folder:
        assert folder.read("config.toml") == b"a = 1\n"


def test_a_folder_is_for_one_run_alone_and_not_inside_a_file(tmp_path: Path) -> None:
    handle = os.open(tmp_path, os.O_RDONLY)
    fcntl.flock(handle, fcntl.LOCK_EX)
    with (
        pytest.raises(InputError, match=r"another run is writing here \(wait for it, or give ano"),
        result_folder(str(tmp_path), "", overwrite=False),
    ):
        pass
    os.close(handle)
    with (
        pytest.raises(InputError, match="is inside another file"),
        result_folder("zip://out::file:///a.zip", "", overwrite=False),
    ):
        pass


# --- whose is which name ----------------------------------------------------------------


@pytest.mark.parametrize(
    ("taken", "second", "clashes"),
    [
        (("a", [".png", ".json"]), ("a", [".json"]), True),
        (("a", [".png"]), ("a", [".json"]), False),
        (("a", [".cue.{}.png"]), ("a", [".cue.{}.png"]), True),
        (("a\udcff", [".png"]), ("a\\xff", [".png"]), True),  # index.csv calls both a\xff
        (("drive/000003", [".png"]), "drive", True),
        (("drive/x", [".png"]), "drive", False),
        ("drive", ("drive/000003", [".png"]), True),
        ("drive", ("drive/x", [".png"]), False),
        ("drive", "drive", True),
        ("run", ("run", [".json"]), True),
        ("index", ("index", [".csv"]), True),
    ],
)
def test_every_result_has_one_owner(
    taken: str | tuple[str, Sequence[str]], second: str | tuple[str, Sequence[str]], clashes: bool
) -> None:
    owners = Owners("out")

    def take(what: str | tuple[str, Sequence[str]], origin: str) -> None:
        if isinstance(what, str):
            owners.take_source(what, origin, has_files=True)
        else:
            owners.take(*what, origin)

    take(taken, "first")
    if not clashes:
        take(second, "second")
        return
    with pytest.raises(ConfigError, match=r" and second: both would write out/"):
        take(second, "second")


# --- pictures behind URLs ---------------------------------------------------------------


def test_pictures_behind_urls_are_found_as_in_folders(url: str, tmp_path: Path) -> None:
    for name in ("b.jpg", "sub/a.PNG", ".hidden/c.jpg", "b.mask.png", "notes.txt", "a.jpg"):
        put(ResultFolder(tmp_path, url), name, "x")

    for end, expected in ("", ["a", "b", "sub/a"]), ("/*.jpg", ["a", "b"]), ("/a.jpg", ["a"]):
        items = find_pictures([url + end])
        assert [item.name for item in items] == expected
        assert items[0].digest is not None
        assert items[0].digest().startswith("2d711642b726b044")  # of x


@pytest.mark.parametrize(
    ("given", "kind", "what"),
    [
        ("memory://nothing/here/*.jpg", InputError, "holds no pictures"),
        ("nosuch://x/y", ConfigError, "unknown kind of URL"),
        ("s3://bucket/x", ConfigError, "cannot be reached"),
    ],
)
def test_what_cannot_be_reached_is_told(given: str, kind: type[Exception], what: str) -> None:
    with pytest.raises(kind, match=what):
        find_pictures([given])


def test_urls_are_told_from_paths_and_a_missing_file_names_its_url() -> None:
    assert is_url("s3://b/x")
    assert is_url("zip://x.png::file:///a.zip")
    assert not is_url("a/b:c.jpg")
    assert not is_url("//share/x")
    item = picture_item("memory://none/x.jpg", "x")
    assert item.digest is not None
    assert item.digest() == ""
    for read in (item.read, lambda: url_bytes(item.origin)):
        with pytest.raises(InputError, match=r"memory://none/x\.jpg: does not exist"):
            read()
