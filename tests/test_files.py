"""Texts for files: CSV that any reader takes apart again."""

import csv
import io

import pytest

from roadtorch.files import csv_text


def test_csv_comes_back_as_it_was_written() -> None:
    rows = [{"file": 'a, "b".png', "status": "two\nlines"}, {"file": "ö.png", "status": ""}]

    text = csv_text(["file", "status"], rows)

    assert list(csv.DictReader(io.StringIO(text, newline=""))) == rows
    assert text.startswith("file,status\n")
    assert "\r" not in text


def test_csv_has_the_columns_that_are_named_in_their_order() -> None:
    assert csv_text(["b", "a"], [{"a": 1, "b": 2.5}, {"b": None}]) == "b,a\n2.5,1\n,\n"
    assert csv_text(["a"], []) == "a\n"
    with pytest.raises(ValueError, match="'c'"):
        csv_text(["a"], [{"c": 1}])
