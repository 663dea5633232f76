"""Arrays on disk: as they were, or told."""

from pathlib import Path

import pytest
import torch

from roadtorch.errors import InputError
from roadtorch.train.prepared import from_bytes, read_arrays, to_bytes, write_arrays


def test_arrays_come_back_all_or_those_that_are_named(tmp_path: Path) -> None:
    arrays = {"a": torch.arange(6, dtype=torch.int16).view(2, 3), "b": torch.tensor(7)}

    write_arrays(tmp_path / "a.npz", arrays)

    found = read_arrays(tmp_path / "a.npz")
    assert found.keys() == arrays.keys()
    assert all(torch.equal(found[name], value) for name, value in arrays.items())
    assert found["a"].dtype == torch.int16
    assert list(read_arrays(tmp_path / "a.npz", "b")) == ["b"]


def test_bytes_are_the_nearest_levels() -> None:
    levels = torch.arange(256, dtype=torch.uint8)

    assert torch.equal(to_bytes(from_bytes(levels)), levels)
    assert to_bytes(torch.tensor([0.0, 0.3 / 255, 0.7 / 255, 1.0])).tolist() == [0, 0, 1, 255]


def test_a_damaged_archive_is_told(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    write_arrays(path, {"a": torch.arange(100)})
    path.write_bytes(path.read_bytes()[:60])

    with pytest.raises(InputError, match="is damaged"):
        read_arrays(path)
