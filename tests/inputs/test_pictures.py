"""Finding images: files, folders, globs."""

import os
from pathlib import Path

import pytest

from roadtorch.base.errors import InputError
from roadtorch.inputs.pictures import find_pictures

NAMES = ["b.jpg", "a.PNG", "c[1].jpg", "sub/c.webp", "sub/deep/d.tif", ".hidden/e.jpg", "notes.txt"]
OWN = ["b.mask.png", "b.overlay.jpg", "b.likelihood.png", "b.cue.layout.png"]
LINKS = {"loop.png": "loop.png", "sub/around": "around", "sub/up": ".."}


@pytest.fixture(scope="module")
def footage(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Images, results of ours among them, links to themselves and an empty folder."""
    root = tmp_path_factory.mktemp("footage")
    (root / "bare").mkdir()
    for name in (*NAMES, *OWN):
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).touch()
    for name, target in LINKS.items():
        (root / name).symlink_to(target)
    return root


ALL = ["a", "b", "c[1]", "loop", "sub/c", "sub/deep/d"]


@pytest.mark.parametrize(
    ("ends", "apart", "expected"),
    [
        ([""], "loop.png", ALL),
        (["[sx]*/d*/**"], "none", ["sub/deep/d"]),
        ([""], "sub", ["a", "b", "c[1]", "loop"]),
        (["*.PNG"], "none", ["a"]),
        (["s*"], "none", ["sub/c", "sub/deep/d"]),
        (["c[1].jpg"], "none", ["c[1]"]),  # no glob, as it exists
        (["b.mask.png"], "none", ["b.mask"]),  # asked for by name
        (["b.jpg", "b.jpg"], "none", ["b"]),
        (["b.jpg", "none.jpg"], "none", ["b", "none"]),  # reading that one fails
    ],
)
def test_folders_globs_and_files(
    footage: Path, ends: list[str], apart: str, expected: list[str]
) -> None:
    images = find_pictures([f"{footage}/{end}" for end in ends], apart=footage / apart)

    assert [image.name for image in images] == expected


@pytest.mark.parametrize(
    ("end", "what"),
    [
        ("bare", "holds no pictures"),
        ("*.gif", "holds no pictures"),
        ("none.jpg", "does not exist"),
    ],
)
def test_nothing_found_is_an_error_that_names_the_input(footage: Path, end: str, what: str) -> None:
    with pytest.raises(InputError) as caught:
        find_pictures([footage / end])

    assert (caught.value.where, caught.value.what) == (str(footage / end), what)


def test_pipes_are_listed_and_never_opened(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.png")

    (item,) = find_pictures([tmp_path])

    with pytest.raises(InputError, match="it is a pipe or a device"):
        item.read()
