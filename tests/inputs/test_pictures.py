"""Finding pictures: files, folders, globs."""

import os
from pathlib import Path

import pytest

from roadtorch.base.errors import InputError
from roadtorch.inputs.item import Item
from roadtorch.inputs.pictures import find_pictures, picture_item


@pytest.fixture
def footage(tmp_path: Path) -> Path:
    root = tmp_path / "footage"
    for name in ("b.jpg", "a.PNG", "sub/c.webp", "sub/deep/d.tif", ".hidden/e.jpg", "notes.txt"):
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
    return root


def names(pictures: list[Item]) -> list[str]:
    return [picture.name for picture in pictures]


@pytest.mark.parametrize(
    ("ends", "expected"),
    [
        ([""], ["a", "b", "sub/c", "sub/deep/d"]),
        (["*.jpg"], ["b"]),
        (["**/*.*"], ["a", "b", "sub/c", "sub/deep/d"]),
        (["s*"], ["sub/c", "sub/deep/d"]),
        (["b.jpg", "b.jpg"], ["b"]),
        (["b.jpg", "none.jpg"], ["b", "none"]),  # reading that one fails
    ],
)
def test_folders_globs_and_files(footage: Path, ends: list[str], expected: list[str]) -> None:
    assert names(find_pictures([f"{footage}/{end}" for end in ends])) == expected


def test_pipes_are_listed_and_never_opened(footage: Path) -> None:
    os.mkfifo(footage / "sub" / "pipe.png")

    for end in "sub", "sub/*.png":
        (item,) = (one for one in find_pictures([footage / end]) if one.name.endswith("pipe"))
        with pytest.raises(InputError, match="it is a pipe or a device"):
            item.read()


def test_a_name_with_brackets_that_exists_is_no_glob(footage: Path) -> None:
    path = footage / "x[1].jpg"
    path.touch()

    assert find_pictures([path]) == [picture_item(path, "x[1]")]


def test_own_results_and_the_output_folder_are_not_looked_at(footage: Path) -> None:
    for name in ("b.mask.png", "b.overlay.jpg", "b.likelihood.png", "b.cue.layout.png"):
        (footage / name).touch()

    assert names(find_pictures([footage], apart=footage / "sub")) == ["a", "b"]
    assert names(find_pictures([footage / "b.mask.png"])) == ["b.mask"]  # asked for by name


def test_nothing_found_is_an_error_that_names_the_input(footage: Path) -> None:
    (footage / "bare").mkdir()

    for item, what in [
        (footage / "bare", "holds no pictures"),
        (footage / "*.gif", "holds no pictures"),
        (footage / "none.jpg", "does not exist"),
    ]:
        with pytest.raises(InputError) as caught:
            find_pictures([item])
        assert (caught.value.where, caught.value.what) == (str(item), what)


def test_links_to_themselves_are_files_like_others(footage: Path) -> None:
    (footage / "loop.png").symlink_to(footage / "loop.png")
    (footage / "sub" / "around").symlink_to(footage / "sub" / "around")
    (footage / "sub" / "up").symlink_to(footage)

    assert names(find_pictures([footage], apart=footage / "loop.png")) == [
        *("a", "b", "loop", "sub/c", "sub/deep/d")
    ]
