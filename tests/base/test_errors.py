"""Errors: what they say, and that they survive a process boundary."""

import pickle
from pathlib import Path

import pytest

from roadtorch.base.errors import (
    ConfigError,
    DatasetError,
    InputError,
    RoadtorchError,
    WeightsError,
    unknown_name,
)


@pytest.mark.parametrize("kind", [InputError, ConfigError, DatasetError, WeightsError])
def test_errors_survive_a_process_boundary_and_repeat_paths_but_no_content_at_length(
    kind: type[RoadtorchError],
) -> None:
    path = Path("/".join(["folder"] * 100)) / "a.png"
    error = kind("k" * 10_000, f"holds {'x' * 100_000} pixels", "replace the file")

    assert len(str(error)) < 900
    assert str(error).endswith("x pixels (replace the file)")
    again = pickle.loads(pickle.dumps(error))
    assert (type(again), str(again)) == (kind, str(error))
    assert isinstance(again, RoadtorchError)
    assert str(path) in str(InputError(path, "is empty", "replace the file"))


@pytest.mark.parametrize(
    ("name", "remedy"), [("fuson", "did you mean fusion?"), ("zzz", "known: cpf, fusion, lbp")]
)
def test_an_unknown_name_is_told_the_nearest_or_all(name: str, remedy: str) -> None:
    error = unknown_name("detector", name, ["lbp", "fusion", "cpf"])

    assert str(error) == f"{name}: unknown detector ({remedy})"
