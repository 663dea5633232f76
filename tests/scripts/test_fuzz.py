"""Tampered pictures: a short run of what ``scripts/fuzz.py`` does with ten thousand."""

import warnings
from pathlib import Path

import pytest

from roadtorch.errors import InputError
from scripts import fuzz


def test_tampered_pictures_are_read_or_refused_by_name(tmp_path: Path) -> None:
    with warnings.catch_warnings():  # whether warnings are errors or not
        warnings.simplefilter("error")
        found = fuzz.fuzz(range(120), seed=1, seconds=20, out=tmp_path)

    assert set(found) == {"read", "refused"}
    assert not list(tmp_path.iterdir())


def test_a_picture_is_the_same_wherever_it_is_made() -> None:
    assert fuzz.mutated(7, 3) == fuzz.mutated(7, 3) != fuzz.mutated(8, 3)


def test_what_fails_is_counted_and_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(path: Path) -> None:
        raise IndexError("deep inside") if path.stem.endswith("0") else InputError("", "bad", "")

    monkeypatch.setattr(fuzz, "read_image", fail)

    found = fuzz.fuzz(range(2), seed=1, seconds=20, out=tmp_path)

    assert sorted(found) == ["crash: IndexError: deep inside", "the name is missing: : bad ()"]
    assert (tmp_path / "1-0.bin").read_bytes() == fuzz.mutated(0, 1)
