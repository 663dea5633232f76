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
def test_every_kind_is_caught_as_ours_and_survives_a_process_boundary(
    kind: type[RoadtorchError],
) -> None:
    error = pickle.loads(pickle.dumps(kind("a.jpg", "is empty", "replace the file")))

    assert isinstance(error, RoadtorchError)
    assert type(error) is kind
    assert (error.where, error.what, error.remedy) == ("a.jpg", "is empty", "replace the file")
    assert str(error) == "a.jpg: is empty (replace the file)"


def test_what_a_file_holds_is_not_repeated_at_length_but_paths_are() -> None:
    path = Path("/".join(["folder"] * 100)) / "a.png"
    error = InputError("k" * 10_000, f"holds {'x' * 100_000} pixels", "replace the file")

    assert len(str(error)) < 900
    assert str(error).endswith("x pixels (replace the file)")
    assert str(pickle.loads(pickle.dumps(error))) == str(error)
    assert str(path) in str(InputError(path, "is empty", "replace the file"))


@pytest.mark.parametrize(
    ("name", "remedy"), [("fuson", "did you mean fusion?"), ("zzz", "known: cpf, fusion, lbp")]
)
def test_an_unknown_name_is_told_the_nearest_or_all(name: str, remedy: str) -> None:
    error = unknown_name("detector", name, ["lbp", "fusion", "cpf"])

    assert str(error) == f"{name}: unknown detector ({remedy})"
