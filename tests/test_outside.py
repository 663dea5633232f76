"""Files that are none, files without end, and names in any encoding."""

import os
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadtorch.errors import InputError
from roadtorch.image import read_image
from roadtorch.outside import printable, read_regular


def test_a_pipe_and_a_device_are_refused_and_nobody_waits(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.png")
    (tmp_path / "zero.png").symlink_to("/dev/zero")

    for name in ("pipe.png", "zero.png"):
        with pytest.raises(InputError, match=rf"{name}: cannot be read: it is a pipe or a device"):
            read_image(tmp_path / name)


def test_a_link_to_itself_is_refused_with_its_name(tmp_path: Path) -> None:
    loop = tmp_path / "loop.png"
    loop.symlink_to(loop)

    with pytest.raises(InputError, match=r"loop\.png: cannot be read: Too many levels"):
        read_image(loop)


def test_a_file_is_read_up_to_its_bound(tmp_path: Path) -> None:
    path = tmp_path / "a"
    path.write_bytes(b"12345")

    assert read_regular(path, most=5) == b"12345"
    with pytest.raises(OSError, match="more than 4 bytes"):
        read_regular(path, most=4)


def test_files_that_grow_as_they_are_read_are_read_to_their_end() -> None:
    assert b"MemTotal" in read_regular("/proc/meminfo")  # whose size is told as 0


def test_bytes_that_are_no_text_are_shown_and_ascii_systems_get_their_letters_back() -> None:
    assert printable(os.fsdecode(b"z\xff.jpg")) == r"z\xff.jpg"
    assert printable("Straße".encode().decode("ascii", "surrogateescape")) == "Straße"
    assert printable("Straße") == "Straße"


@given(st.text(st.characters()))
def test_every_text_can_be_written(text: str) -> None:
    printable(text).encode()


@given(st.binary())
def test_every_name_can_be_written(name: bytes) -> None:
    printable(name.decode("utf-8", "surrogateescape")).encode()
