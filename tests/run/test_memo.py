"""What is remembered: under a key of everything it depends on, whole or not at all."""

from pathlib import Path

import pytest
import torch

from roadtorch.base.errors import InputError
from roadtorch.detectors.catalogue import load_detector
from roadtorch.run import memo
from roadtorch.run.memo import (
    cached_arrays,
    file_digests,
    keep,
    kept,
    key_of,
    paths_in,
    read_arrays,
)

ARRAYS = {"road": torch.rand(3, 4) > 0.5, "sums": torch.arange(6.0).view(2, 3)}


def test_arrays_come_back_under_their_key_alone(tmp_path: Path) -> None:
    path = tmp_path / "made" / "x.npz"

    keep(path, key_of("a"), ARRAYS)

    for key in (key_of("a"), None):
        arrays = kept(path, key)
        assert arrays is not None
        assert arrays.keys() == ARRAYS.keys()
        assert all(torch.equal(arrays[name], ARRAYS[name]) for name in ARRAYS)
    named = kept(path, key_of("a"), "sums")
    assert named is not None
    assert [*named] == ["sums"]
    assert kept(path, key_of("b")) is None
    assert kept(path, key_of("a"), "none") is None
    assert [file.name for file in path.parent.iterdir()] == ["x.npz"]


@pytest.mark.parametrize(
    "change",
    [
        lambda data: b"",
        lambda data: b"PK garbage",
        lambda data: data[:-30],
        lambda data: data[:60] + b"\xff" * 20 + data[80:],
        lambda data: b"PK\5\6" + bytes(18),  # the end of an archive without members
    ],
)
def test_a_damaged_file_holds_nothing(tmp_path: Path, change) -> None:
    path = tmp_path / "x.npz"
    keep(path, "k", ARRAYS)
    path.write_bytes(change(path.read_bytes()))

    assert kept(path, "k") is None
    assert kept(tmp_path / "none.npz", "k") is None
    with pytest.raises(InputError, match=r"x\.npz: is damaged \(remove it; it will be made again"):
        read_arrays(path)


def test_arrays_without_a_key_are_not_ours(tmp_path: Path) -> None:
    memo.write_arrays(tmp_path / "x.npz", ARRAYS)

    assert kept(tmp_path / "x.npz", None) is None
    read = cached_arrays()
    assert read(tmp_path / "x.npz") is read(tmp_path / "x.npz")


def test_a_key_changes_with_every_part(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file, folder = tmp_path / "file", tmp_path / "folder"
    (folder / "below").mkdir(parents=True)
    file.write_text("a")
    (folder / "below" / "x").write_text("a")
    keys = [key_of("a", 1, file, folder)]
    same = key_of("a", 1, file, folder)

    keys += [key_of("b", 1, file, folder), key_of("a", 1.0, file, folder)]
    keys += [key_of("a", 1, folder), key_of("a1", file, folder)]
    file.write_text("b")
    keys.append(key_of("a", 1, file, folder))
    (folder / "below" / "x").write_text("b")
    keys.append(key_of("a", 1, file, folder))
    (folder / "below" / "x").rename(folder / "y")
    keys.append(key_of("a", 1, file, folder))
    settings = {"a": str(file), "b": {"c": [file, "none"], "d": 3, "e": ""}, "f": str(folder)}
    assert paths_in(settings) == [file, file, folder]
    assert list(file_digests(settings)) == [str(file)]
    assert [path.name for path in paths_in({"w": "cnn-7"})] == ["cnn-7.safetensors"]
    detector = load_detector("prior:rows")
    keys += [key_of(detector), key_of(load_detector("prior:rows", threshold=0.4))]
    changed = load_detector("layout:cnn-7")
    keys.append(key_of(changed))
    with torch.no_grad():
        next(changed.parameters()).add_(1)
    keys.append(key_of(changed))
    monkeypatch.setattr(memo, "__version__", "99")
    keys.append(key_of("a", 1, file, folder))

    assert same == keys[0]
    assert len(set(keys)) == len(keys)
    assert {len(key) for key in keys} == {32}
