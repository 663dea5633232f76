import pickle
from pathlib import Path

import pytest

from roadtorch.errors import (
    ConfigError,
    DatasetError,
    InputError,
    RoadtorchError,
    WeightsError,
    unknown_name,
)


def test_reads_where_what_remedy() -> None:
    error = InputError("a.jpg", "is empty", "replace the file")

    assert str(error) == "a.jpg: is empty (replace the file)"


@pytest.mark.parametrize("kind", [InputError, ConfigError, DatasetError, WeightsError])
def test_every_kind_is_caught_as_ours_and_survives_a_process_boundary(
    kind: type[RoadtorchError],
) -> None:
    error = pickle.loads(pickle.dumps(kind("here", "is wrong", "mend it")))

    assert isinstance(error, RoadtorchError)
    assert type(error) is kind
    assert (error.where, error.what, error.remedy) == ("here", "is wrong", "mend it")


def test_what_a_file_holds_is_not_repeated_at_length_but_paths_are() -> None:
    path = Path("/".join(["folder"] * 100)) / "a.png"
    error = InputError("k" * 10_000, f"holds {'x' * 100_000} pixels", "replace the file")

    assert len(str(error)) < 900
    assert str(error).endswith("x pixels (replace the file)")
    assert str(pickle.loads(pickle.dumps(error))) == str(error)
    assert str(path) in str(InputError(path, "is empty", "replace the file"))


def test_unknown_name_tells_the_nearest() -> None:
    error = unknown_name("detector", "fuson", ["lbp", "fusion", "cpf"])

    assert str(error) == "fuson: unknown detector (did you mean fusion?)"


def test_unknown_name_without_a_near_one_tells_all() -> None:
    error = unknown_name("detector", "zzz", ["lbp", "cpf"])

    assert error.remedy == "known: cpf, lbp"
