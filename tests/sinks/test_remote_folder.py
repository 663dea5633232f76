import uuid

import pytest

from roadtorch.errors import ConfigError, InputError
from roadtorch.io.addresses import file_system, is_url
from roadtorch.sinks.remote_folder import RemoteFolder
from roadtorch.sources.pictures import Picture, find_images


@pytest.fixture
def folder() -> RemoteFolder:
    return RemoteFolder(f"memory://{uuid.uuid4().hex}/out")


def test_what_is_written_is_read(folder: RemoteFolder) -> None:
    folder.write("sub/x.txt", b"one")
    folder.write("sub/x.txt", b"two")

    assert folder.read("sub/x.txt") == b"two"
    assert folder.has("sub/x.txt")
    assert not folder.has("sub")
    assert folder.read("y.txt") is None
    system, path = file_system(folder.url)
    assert [name.rpartition("/")[2] for name in system.find(path)] == ["x.txt"]


def test_leftovers_of_killed_workers_are_removed(folder: RemoteFolder) -> None:
    folder.write("sub/.roadtorch.01234567.part", b"half")
    folder.write("sub/x.part", b"not ours")

    folder.tidy()

    assert not folder.has("sub/.roadtorch.01234567.part")
    assert folder.has("sub/x.part")


def test_pictures_behind_urls_are_found_as_in_folders(folder: RemoteFolder) -> None:
    names = ["b.jpg", "sub/a.PNG", ".hidden/c.jpg", "b.mask.png", "notes.txt", "a.jpg"]
    for name in names:
        folder.write(name, b"")

    for end, expected in ("", ["a", "b", "sub/a"]), ("/*.jpg", ["a", "b"]), ("/a.jpg", ["a"]):
        found = find_images([folder.url + end])
        assert [one.name for one in found] == expected
        assert found[0].data() == b""


@pytest.mark.parametrize(
    ("url", "kind", "what"),
    [
        ("memory://nothing/here/*.jpg", InputError, "holds no pictures"),
        ("nosuch://x/y", ConfigError, "unknown kind of URL"),
        ("s3://bucket/x", ConfigError, "cannot be reached"),
    ],
)
def test_what_cannot_be_reached_is_told(url: str, kind: type[Exception], what: str) -> None:
    with pytest.raises(kind, match=what):
        find_images([url])


def test_urls_are_told_from_paths() -> None:
    assert is_url("s3://b/x")
    assert is_url("zip://x.png::file:///a.zip")
    assert not is_url("a/b:c.jpg")
    assert not is_url("//share/x")


def test_a_missing_file_names_its_url() -> None:
    with pytest.raises(InputError, match=r"memory://none/x\.jpg: does not exist"):
        Picture("memory://none/x.jpg", "x").data()


def test_a_folder_inside_an_archive_is_refused() -> None:
    with pytest.raises(InputError, match="inside another file"):
        RemoteFolder("zip://out::file:///a.zip").write("x", b"")
