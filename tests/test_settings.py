from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import AfterValidator, Field

from roadtorch.errors import ConfigError, InputError, unknown_name
from roadtorch.settings import Settings, build_settings, parse_assignments, read_settings_file


class Texture(Settings):
    bins: int = Field(default=64, ge=2)


def _known_plane(name: str) -> str:
    if name != "R":
        raise ValueError(unknown_name("plane", name, ["R"]))
    return name


class Example(Settings):
    threshold: float = Field(default=0.5, ge=0, le=1)
    plane: Annotated[str, AfterValidator(_known_plane)] = "R"
    texture: Texture = Texture()


def test_defaults_stay_where_nothing_is_given() -> None:
    assert build_settings(Example, {"texture": {"bins": 8}}) == Example(texture=Texture(bins=8))


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"texture": {"bin": 1}}, "texture.bin: unknown setting (did you mean texture.bins?)"),
        ({"treshold": 0.1}, "treshold: unknown setting (did you mean threshold?)"),
        ({"texture": {"bins": 1}}, "texture.bins: 1 was given (input should be greater than or"),
        ({"texture": {"bins": "many"}}, "texture.bins: 'many' was given (input should be a valid"),
        ({"texture": {"bins": 2.5}}, "texture.bins: 2.5 was given"),
        ({"threshold": float("nan")}, "threshold: nan was given"),
        ({"texture": 3}, "texture: 3 was given for a group of settings (set one of its keys: bins"),
        ({"plane": "X"}, "plane: unknown plane 'X' (known: R)"),
    ],
)
def test_a_mistake_names_the_full_key_and_what_was_given(
    values: dict[str, Any], message: str
) -> None:
    with pytest.raises(ConfigError) as caught:
        build_settings(Example, values)

    assert str(caught.value).startswith(message)


def test_assignments_become_nested_values_of_their_toml_type() -> None:
    given = ["texture.bins=64", "a=0.5", "b=true", "c=drop", 'd="7"', "e=[1, 2]", "f=x=y"]

    assert parse_assignments(given) == {
        "texture": {"bins": 64},
        "a": 0.5,
        "b": True,
        "c": "drop",
        "d": "7",
        "e": [1, 2],
        "f": "x=y",
    }


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_numbers_survive_the_way_through_text(value: float) -> None:
    assert parse_assignments([f"x={value!r}"]) == {"x": value}


def test_an_old_key_is_refused_with_the_new_one() -> None:
    class Inner(Settings):
        renamed: ClassVar[Mapping[str, str]] = {"seed": "random_seed"}
        random_seed: int = 0

    class Outer(Settings):
        draws: Inner = Inner()

    with pytest.raises(
        ConfigError, match=r"draws\.seed: has another .* \(write draws\.random_seed\)"
    ):
        build_settings(Outer, {"draws": {"seed": 3}})


def test_all_keys_that_are_gone_are_told_at_once_with_what_to_do_instead() -> None:
    class Inner(Settings):
        removed: ClassVar[Mapping[str, str]] = {"place": "write row for place.row"}
        row: int = 0

    class Outer(Settings):
        removed: ClassVar[Mapping[str, str]] = dict.fromkeys(("bias", "reach"), "leave it out")
        inner: Inner = Inner()

    kept = {"bias": 1, "inner": {"place": {"row": 3}}, "reach": 2}
    told = r"inner\.place, bias, reach: are gone \(write row for place\.row; leave it out\)"
    with pytest.raises(ConfigError, match=told):
        build_settings(Outer, kept)
    with pytest.raises(ConfigError, match=r"^reach: is gone \(leave it out\)"):
        build_settings(Outer, {"reach": 2, "nonsense": 1})


@pytest.mark.parametrize("item", ["", "bins", "=3", "a..b=1", ".a=1"])
def test_an_item_that_is_no_assignment_is_refused(item: str) -> None:
    with pytest.raises(ConfigError, match="is not a setting"):
        parse_assignments([item])


@pytest.mark.parametrize("items", [["a=1", "a.b=2"], ["a.b=2", "a=1"]])
def test_a_key_cannot_be_a_value_and_a_group(items: list[str]) -> None:
    with pytest.raises(ConfigError, match=r"already set to a value|is a group"):
        parse_assignments(items)


def test_a_settings_file_is_toml(tmp_path: Path) -> None:
    path = tmp_path / "a.toml"
    path.write_text("threshold = 0.25\n[texture]\nbins = 8\n")

    assert read_settings_file(path) == {"threshold": 0.25, "texture": {"bins": 8}}


def test_a_missing_or_broken_settings_file_is_named(tmp_path: Path) -> None:
    broken = tmp_path / "b.toml"
    broken.write_text("threshold = = 1")

    with pytest.raises(InputError, match=r"none\.toml: cannot be read"):
        read_settings_file(tmp_path / "none.toml")
    with pytest.raises(ConfigError, match=r"b\.toml: is not TOML"):
        read_settings_file(broken)


DEEP_LIST, LONG_NUMBER = "[" * 3_000, "9" * 5_000


@pytest.mark.parametrize(
    "item",
    [
        f"threshold={DEEP_LIST}",
        f"threshold={DEEP_LIST}{']' * 3_000}",
        f"threshold={'[' * 50}{']' * 50}",
        f"threshold={LONG_NUMBER}",
        f"threshold=0x{'f' * 5_000}",
        f"threshold={{{'a.' * 50_000}a = 1}}",
        f"{'a.' * 50_000}a=1",
    ],
)
def test_values_without_end_are_refused_in_a_line(item: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError) as caught:
        build_settings(Example, parse_assignments([item]))
    assert len(str(caught.value)) < 500

    path = tmp_path / "a.toml"
    path.write_text(item)
    with pytest.raises(ConfigError, match=r"a\.toml: ") as caught:
        read_settings_file(path)
    assert len(str(caught.value)) < 500


def test_lists_of_many_numbers_are_no_long_keys() -> None:
    numbers = [number + 0.5 for number in range(100)]

    assert parse_assignments([f"weights={numbers}"]) == {"weights": numbers}


class Item(Settings):
    size: int = 1


class Listed(Settings):
    items: tuple[Item, ...] = ()


def test_an_unknown_key_inside_a_list_is_refused_with_its_path() -> None:
    with pytest.raises(ConfigError, match=r"items\.0\.wide: unknown setting"):
        build_settings(Listed, {"items": ({"wide": 2},)})
