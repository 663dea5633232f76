from pathlib import Path

import pytest

from roadtorch.base.errors import ConfigError
from roadtorch.base.shipped_configs import CONFIGS, config_file, shipped_configs

REPOSITORY = Path(__file__).resolve().parents[2]


def test_the_package_has_the_repositorys_configs() -> None:
    assert CONFIGS.resolve() == REPOSITORY / "configs"


def test_every_file_has_a_name_that_leads_to_it() -> None:
    files = {config_file(name).resolve() for name in shipped_configs()}

    assert files == set((REPOSITORY / "configs").rglob("*.toml"))
    assert {"adapt", "layout-free", "thresholds/labeller"} <= {*shipped_configs()}


def test_a_file_goes_before_a_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "layout-free").mkdir()  # a folder is no config
    assert config_file("layout-free") == CONFIGS / "layout-free.toml"

    (tmp_path / "adapt").write_text("random_seed = 1")
    assert config_file("adapt") == Path("adapt")
    assert config_file("none.toml") == Path("none.toml")  # to be refused when it is read


@pytest.mark.parametrize(
    ("name", "remedy"),
    [
        ("adpat", "did you mean adapt"),
        ("xyz", "known: adapt, backbone-free, cnn7, "),
        ("", "known: adapt, backbone-free, cnn7, "),
    ],
)
def test_an_unknown_name_tells_those_that_are_known(name: str, remedy: str) -> None:
    with pytest.raises(ConfigError) as caught:
        config_file(name)

    assert caught.value.what == "unknown config, and no file"
    assert caught.value.remedy.startswith(remedy)
