"""The folder of a run's results: for one run and its settings alone."""

import fcntl
import os
from pathlib import Path

import pytest

from roadtorch.base.errors import ConfigError, InputError
from roadtorch.run.folder import result_folder
from roadtorch.run.ledger import has_result


def test_a_bag_that_is_a_folder_is_there_once_it_has_its_list(tmp_path: Path) -> None:
    (tmp_path / "a.road").mkdir()

    assert not has_result(tmp_path, "a.road")
    (tmp_path / "a.road" / "metadata.yaml").touch()
    assert has_result(tmp_path, "a.road")


def test_results_of_other_settings_are_not_mixed_in(tmp_path: Path) -> None:
    out = tmp_path / "out"
    for effective in ("a = 1", "a = 2"):  # nothing was done with the first ones
        with result_folder(out, effective, overwrite=False):
            assert (out / "config.toml").read_text() == f"{effective}\n"
    (out / "index.csv").write_text("file\n")

    with (
        pytest.raises(ConfigError, match=r"holds results of other settings \(config\.toml\)"),
        result_folder(out, "a = 1", overwrite=False),
    ):
        pass
    with result_folder(out, "a = 1", overwrite=True):
        assert (out / "config.toml").read_text() == "a = 1\n"


def test_a_folder_is_for_one_run_alone_and_no_address(tmp_path: Path) -> None:
    handle = os.open(tmp_path, os.O_RDONLY)
    fcntl.flock(handle, fcntl.LOCK_EX)
    with (
        pytest.raises(InputError, match=r"another run is writing here \(wait for it, or give ano"),
        result_folder(tmp_path, "", overwrite=False),
    ):
        pass
    os.close(handle)
    with (
        pytest.raises(InputError, match="is an address"),
        result_folder(Path("s3://bucket/out"), "", overwrite=False),
    ):
        pass
