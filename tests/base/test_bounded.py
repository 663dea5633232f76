"""Files of bounded size, and names in any encoding."""

import os
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadtorch.base.bounded import printable, read_regular


def test_a_file_is_read_up_to_its_bound(tmp_path: Path) -> None:
    path = tmp_path / "a"
    path.write_bytes(b"12345")

    assert read_regular(path, most=5) == b"12345"
    assert b"MemTotal" in read_regular("/proc/meminfo")  # whose size is told as 0
    with pytest.raises(OSError, match="more than 4 bytes"):
        read_regular(path, most=4)


def test_bytes_that_are_no_text_are_shown_and_ascii_systems_get_their_letters_back() -> None:
    assert printable(os.fsdecode(b"z\xff.jpg")) == r"z\xff.jpg"
    assert printable("Straße".encode().decode("ascii", "surrogateescape")) == "Straße"
    assert printable("Straße") == "Straße"


@given(st.binary())
def test_every_name_can_be_written(name: bytes) -> None:
    shown = printable(os.fsdecode(name)).encode()

    assert shown.decode("utf-8") == name.decode("utf-8", "backslashreplace")
