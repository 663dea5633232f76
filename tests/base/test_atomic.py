"""Atomic writes, bounded reads, and names in any encoding."""

import io
import os
from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from roadtorch.base import atomic as files
from roadtorch.base.atomic import (
    atomic_write,
    csv_text,
    lock_folder,
    remove_leftovers,
    share_folder,
    write_text,
)
from roadtorch.base.bounded import read_regular, to_printable
from roadtorch.base.errors import InputError
from roadtorch.base.image import write_npy


def test_csv_has_the_columns_that_are_named_and_ends_lines_alike_everywhere() -> None:
    assert csv_text(["b", "a"], [{"a": 1, "b": 2.5}, {"b": "x\ny"}]) == 'b,a\n2.5,1\n"x\ny",\n'


# --- whole or not at all ----------------------------------------------------------------


def test_a_name_may_be_as_long_as_the_file_system_allows(tmp_path: Path) -> None:
    write_text(tmp_path / ("x" * 255), "whole")
    (tmp_path / ("x" * 255)).rename(tmp_path / "y")

    with pytest.raises(InputError, match=r"File name too long \(give it a shorter name\)"):
        write_text(tmp_path / ("x" * 256), "whole")
    assert [path.read_text() for path in tmp_path.iterdir()] == ["whole"]


@pytest.mark.parametrize(
    "write", [lambda path: write_text(path, "x"), lambda path: write_npy(path, torch.ones(50, 50))]
)
def test_a_full_disk_is_blamed_on_the_room(
    write: Callable[[Path], None], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    full = io.open
    monkeypatch.setattr(io, "open", lambda _, *args, **kwargs: full("/dev/full", *args, **kwargs))

    with pytest.raises(InputError, match=r"x: cannot be written: No space left .* \(make room"):
        write(tmp_path / "x")


def test_a_failed_write_leaves_the_old_file_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_text("old")

    with pytest.raises(KeyboardInterrupt), atomic_write(path) as temporary:  # noqa: PT012
        temporary.write_text("half of the n")
        raise KeyboardInterrupt

    assert [entry.name for entry in tmp_path.iterdir()] == ["a.txt"]
    assert path.read_text() == "old"


def test_a_shared_folder_is_cleared_of_leftovers_by_its_first_run(tmp_path: Path) -> None:
    left = tmp_path / "made" / "below" / ".roadtorch.0123abcd.part"

    with share_folder(tmp_path / "made"):
        left.parent.mkdir()
        left.touch()
        with share_folder(tmp_path / "made"):  # the first run may be writing it
            assert left.exists()
    with lock_folder(left.parent):
        left.touch()
        with share_folder(tmp_path / "made"):  # a run may be writing it
            assert left.exists()
    with share_folder(tmp_path / "made"):
        assert not left.exists()
        assert left.parent.is_dir()


def test_no_library_writes_under_names_of_its_own() -> None:
    """Forbid ``save_file`` of safetensors: its .tmpXXXXXX stays behind when it is killed."""
    package = Path(files.__file__).parents[1]

    modules = [path for path in package.rglob("*.py") if "save_file" in path.read_text()]

    assert modules == []


def test_leftovers_of_killed_processes_go_and_all_else_stays(tmp_path: Path) -> None:
    with atomic_write(tmp_path / "x") as temporary:
        left = tmp_path / f"{temporary.name}"
        left.write_text("half")
        os.link(left, tmp_path / ".a.mask.png.0123abcd.part")  # of earlier versions
    os.link(tmp_path / "x", left)  # as if it had been killed
    (tmp_path / "mine.part").touch()

    remove_leftovers([tmp_path, tmp_path / "none"])

    assert sorted(path.name for path in tmp_path.iterdir()) == ["mine.part", "x"]


# --- bounded reads and names --------------------------------------------------------------


def test_a_file_is_read_up_to_its_bound(tmp_path: Path) -> None:
    path = tmp_path / "a"
    path.write_bytes(b"12345")

    assert read_regular(path, max_bytes=5) == b"12345"
    assert b"MemTotal" in read_regular("/proc/meminfo")  # whose stated size is 0
    with pytest.raises(OSError, match="more than 4 bytes"):
        read_regular(path, max_bytes=4)


def test_bytes_that_are_no_text_are_shown_and_ascii_systems_get_their_letters_back() -> None:
    assert to_printable(os.fsdecode(b"z\xff.jpg")) == r"z\xff.jpg"
    assert to_printable("Straße".encode().decode("ascii", "surrogateescape")) == "Straße"
    assert to_printable("Straße") == "Straße"


@given(st.binary())
def test_every_name_can_be_written(name: bytes) -> None:
    data = to_printable(os.fsdecode(name)).encode()

    assert data.decode("utf-8") == name.decode("utf-8", "backslashreplace")
