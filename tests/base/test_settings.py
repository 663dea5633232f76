"""Settings, and the errors that users see."""

import io
import pickle
import sys
from pathlib import Path
from typing import Annotated, Any

import pytest
from pydantic import AfterValidator, Field

from roadtorch.base import progress
from roadtorch.base.errors import (
    ConfigError,
    DatasetError,
    InputError,
    RoadtorchError,
    WeightsError,
    unknown_name_error,
)
from roadtorch.base.progress import Progress
from roadtorch.base.settings import (
    CONFIGS,
    Settings,
    build_settings,
    find_config,
    list_shipped_configs,
    parse_assignments,
    read_settings_file,
    to_toml,
)
from roadtorch.layout.weights import SHIPPED, weights_path


class Texture(Settings):
    bins: int = Field(default=64, ge=2)


def _known_plane(name: str) -> str:
    if name != "R":
        raise ValueError(unknown_name_error("plane", name, ["R"]))
    return name


class Example(Settings):
    threshold: float = Field(default=0.5, ge=0, le=1)
    plane: Annotated[str, AfterValidator(_known_plane)] = "R"
    texture: Texture = Texture()
    several: tuple[Texture, ...] = ()


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"texture": {"bin": 1}}, "texture.bin: unknown setting (did you mean texture.bins?)"),
        ({"several": ({"wide": 2},)}, "several.0.wide: unknown setting"),
        ({"texture": {"bins": 1}}, "texture.bins: 1 was given (input should be greater than or"),
        ({"texture": {"bins": "many"}}, "texture.bins: 'many' was given (input should be a valid"),
        ({"threshold": float("nan")}, "threshold: nan was given"),
        ({"texture": 3}, "texture: 3 was given for a group of settings (set one of its keys: bins"),
        ({"plane": "X"}, "plane: unknown plane 'X' (known: R)"),
    ],
)
def test_a_mistake_names_the_key_and_the_value(values: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError) as caught:
        build_settings(Example, values)

    assert str(caught.value).startswith(message)


def test_assignments_become_nested_values_of_their_toml_type() -> None:
    items = ["texture.bins=64", "a=0.5", "b=true", "c=drop", 'd="7"', "e=[1, 2]", "f=x=y"]

    values = {"a": 0.5, "b": True, "c": "drop", "d": "7", "e": [1, 2], "f": "x=y"}
    assert parse_assignments(items) == {"texture": {"bins": 64}} | values


@pytest.mark.parametrize(
    ("items", "problem"),
    [
        *(([item], "is not a setting") for item in ("", "bins", "=3", "a..b=1", ".a=1")),
        (["a=1", "a.b=2"], "a is already set to a value"),
        (["a.b=2", "a=1"], "is a group of settings, or is given twice"),
        (["a=2", "a=1"], "is a group of settings, or is given twice"),
    ],
)
def test_a_wrong_assignment_is_refused(items: list[str], problem: str) -> None:
    with pytest.raises(ConfigError) as caught:
        parse_assignments(items)

    assert caught.value.problem == problem


def test_written_settings_are_read_again_without_none(tmp_path: Path) -> None:
    class Written(Settings):
        limit: int | None = None
        text: str = 'a "b" \\ ß'
        shares: tuple[float, ...] = (0.5, 1e-05)
        texture: Texture = Texture(bins=9)

    (tmp_path / "a.toml").write_text(to_toml("cpf:v2", Written()), encoding="utf-8-sig")

    assert read_settings_file(tmp_path / "a.toml") == {
        "detector": "cpf:v2",
        "text": 'a "b" \\ ß',
        "shares": [0.5, 1e-05],
        "texture": {"bins": 9},
    }


def test_only_names_of_files_with_a_suffix_are_those_beside_the_file(tmp_path: Path) -> None:
    file = tmp_path / "config.toml"
    for name in ("ego.png", "fusion"):
        (tmp_path / name).touch()
    long = f"{'x' * 300}.png"
    file.write_text(f'detector = "fusion"\nlong = "{long}"\n[ego]\nmask = "ego.png"\nno = "a.png"')

    values = read_settings_file(file)

    assert values["detector"] == "fusion"
    assert values["long"] == long
    assert values["ego"] == {"mask": str(tmp_path / "ego.png"), "no": "a.png"}


# --- shipped configs --------------------------------------------------------------------


def test_every_config_of_the_repository_has_a_name_that_leads_to_it() -> None:
    files = {find_config(name).resolve() for name in list_shipped_configs()}

    assert CONFIGS.resolve() == Path(__file__).resolve().parents[2] / "configs"
    assert files == set(CONFIGS.resolve().rglob("*.toml"))
    assert {"adapt", "fusion", "thresholds/labeller"} <= {*list_shipped_configs()}


@pytest.mark.parametrize("is_folder", [False, True])
def test_a_shipped_name_goes_before_a_file_and_a_path_has_a_separator_or_a_suffix(
    is_folder: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("adapt", "mine", "backbone-free", "thresholds/cpf-v2"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).mkdir() if is_folder else (tmp_path / name).write_text("seed = 1")

    for find, name, folder, suffix in (
        (find_config, "adapt", CONFIGS, ".toml"),
        (find_config, "thresholds/cpf-v2", CONFIGS, ".toml"),
        (weights_path, "backbone-free", SHIPPED, ".safetensors"),
    ):
        assert find(name) == folder / f"{name}{suffix}"
        assert find(f"./{name}") == Path(name)
        assert find(f"none{suffix}") == Path(f"none{suffix}")  # to be refused when it is read
        for unknown in ("mine", f"{name[:-2]}s", "a/none"):
            with pytest.raises(
                ConfigError, match=f"^{unknown}: unknown .*, and no path such as ./"
            ):
                find(unknown)


# --- errors -----------------------------------------------------------------------------


@pytest.mark.parametrize("kind", [InputError, ConfigError, DatasetError, WeightsError])
def test_errors_survive_a_process_boundary_and_are_short(kind: type[RoadtorchError]) -> None:
    path = Path("/".join(["folder"] * 100)) / "a.png"
    error = kind("k" * 10_000, f"holds {'x' * 100_000} pixels", "replace the file")

    assert len(str(error)) < 900
    assert str(error).endswith("x pixels (replace the file)")
    again = pickle.loads(pickle.dumps(error))
    assert (type(again), str(again)) == (kind, str(error))
    assert isinstance(again, RoadtorchError)
    assert str(path) in str(InputError(path, "is empty", "replace the file"))


# --- progress -----------------------------------------------------------------------------


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize(
    ("items", "options", "lines"),
    [
        ([1, 2], {"unit": "image"}, ["50 % (1 of 2 images), ", "100 % (2 of 2"]),
        (iter([1]), {"unit": "frame", "desc": "ego"}, ["ego: 1 frames in 00:00"]),
        ([1, 2], {"unit": "image", "quiet": True}, []),
    ],
)
def test_a_pipe_gets_a_line_when_it_is_due(monkeypatch, capsys, items, options, lines):
    monkeypatch.setattr(progress, "LINE_INTERVAL", 1e-9)

    for _ in Progress(items, **options):
        Progress.write("a.jpg: is empty", file=sys.stderr)

    text = capsys.readouterr().err
    assert "\r" not in text
    printed = [line for line in text.splitlines() if line != "a.jpg: is empty"]
    for line, expected in zip(printed, lines, strict=True):
        assert line.startswith(f"roadtorch: {expected}")


def test_a_short_run_prints_nothing_to_a_pipe_and_draws_its_bar_on_a_terminal(monkeypatch, capsys):
    list(Progress([1, 2], unit="image"))
    assert capsys.readouterr().err == ""

    monkeypatch.setattr(sys, "stderr", terminal := Terminal())
    list(Progress([1, 2], unit="image"))
    assert "100%|" in terminal.getvalue()
