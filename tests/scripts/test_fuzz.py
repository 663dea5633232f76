"""Tampered files: a short run of each kind of what ``scripts/fuzz.py`` does with thousands."""

import time
import warnings
from pathlib import Path

import pytest

from roadtorch.errors import InputError
from scripts import fuzz

COUNT = {"pictures": 120, "weights": 40, "checkpoints": 40}


@pytest.mark.parametrize("kind", fuzz.KINDS)
def test_tampered_files_are_read_or_refused_by_name(kind: str, tmp_path: Path) -> None:
    with warnings.catch_warnings():  # whether warnings are errors or not
        warnings.simplefilter("error")
        found = fuzz.fuzz(kind, range(COUNT.get(kind, 80)), seed=1, seconds=20, out=tmp_path)

    assert fuzz.wrong(found) == 0, found
    assert found[fuzz.REFUSED] > 0
    assert not list(tmp_path.glob(f"{kind}-*"))


@pytest.mark.parametrize("kind", fuzz.KINDS)
def test_a_file_is_the_same_wherever_it_is_made(kind: str, tmp_path: Path) -> None:
    one, again, other = (
        fuzz.made(kind, number, 3, tmp_path / folder).read_bytes()
        for folder, number in (("a", 7), ("b", 7), ("a", 8))
    )

    assert one == again != other


def test_what_fails_is_counted_kept_and_read_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail(path: Path) -> bool:
        raise IndexError("deep") if path.parent.name[-1] == "0" else InputError("", "bad", "")

    make = fuzz.KINDS["pictures"].make
    monkeypatch.setitem(fuzz.KINDS, "pictures", fuzz.Kind(make, fail))  # type: ignore[arg-type]

    found = fuzz.fuzz("pictures", range(2), seed=1, seconds=20, out=tmp_path)
    code = fuzz.main(["--kind", "pictures", "--read", str(tmp_path / "pictures-1-0/picture.bin")])

    assert sorted(found) == ["crash: IndexError: deep", "the name is missing: : bad ()"]
    assert code == 1
    assert capsys.readouterr().out.endswith("crash: IndexError: deep\n")


def test_a_refusal_without_end_and_memory_without_bound_are_failures(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(path: Path) -> bool:
        raise InputError(path, "bad", "r" * 10_000)

    path = tmp_path / "a.bin"
    assert fuzz.judge(path, refuse, 20).what.startswith("a refusal of 10")
    assert fuzz.judge(path, lambda _: False, 20).what == "what was read makes no sense"
    monkeypatch.setattr(fuzz, "GIGABYTES", 0.0)
    assert fuzz.judge(path, lambda _: True, 20).what.endswith(" GiB")


def test_the_peak_of_memory_is_that_of_one_file(tmp_path: Path) -> None:
    def take(_: Path) -> bool:
        return bytes(range(256)) * 2**20 != b""  # 256 MiB, written to

    large = fuzz.judge(tmp_path, take, 20).gigabytes
    small = fuzz.judge(tmp_path, lambda _: time.sleep(0) is None, 20).gigabytes

    assert large > small + 0.2
