"""Settings: frozen pydantic models whose mistakes read like sentences."""

import json
import math
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar, TypeVar

import pydantic

from roadtorch.errors import ConfigError, InputError, unknown_name


class Settings(pydantic.BaseModel):
    """The base of every group of settings: frozen, and unknown keys are refused."""

    renamed: ClassVar[Mapping[str, str]] = {}
    """Keys of this group that had other names: old and new, for the refusal of the old ones."""

    model_config = pydantic.ConfigDict(
        frozen=True, extra="forbid", strict=True, validate_default=True, allow_inf_nan=False
    )


AnySettings = TypeVar("AnySettings", bound=Settings)


def build_settings(kind: type[AnySettings], values: Mapping[str, Any]) -> AnySettings:
    """Make settings of one kind from nested values.

    Raises ConfigError naming the full key (``texture.bins``), what was given and
    what is allowed.
    """
    try:
        return kind.model_validate(dict(values))
    except pydantic.ValidationError as problem:
        raise _first_mistake(kind, problem) from None


def _first_mistake(kind: type[Settings], problem: pydantic.ValidationError) -> ConfigError:
    error = problem.errors()[0]
    path = [str(part) for part in error["loc"]]
    key = ".".join(path)
    if error["type"] == "extra_forbidden":
        return _unknown_key(group_at(kind, path[:-1]), path)
    if error["type"] == "missing":
        return ConfigError(key, "is missing", "give it a value")
    given = f"{error['input']!r} was given"
    if error["type"] == "model_type":
        known = ", ".join(group_at(kind, path).model_fields)
        return ConfigError(key, f"{given} for a group of settings", f"set one of its keys: {known}")
    told = getattr(error.get("ctx", {}).get("error"), "args", ())
    if told and isinstance(told[0], ConfigError):  # a validator's own words
        return ConfigError(key, f"{told[0].what} {error['input']!r}", told[0].remedy)
    message = error["msg"].removeprefix("Value error, ")
    return ConfigError(key, given, message[0].lower() + message[1:])


def _unknown_key(group: type[Settings], path: list[str]) -> ConfigError:
    key, siblings = ".".join(path), path[:-1]
    if new := group.renamed.get(path[-1]):
        return ConfigError(key, "has another name now", f"write {'.'.join([*siblings, new])}")
    known = [".".join([*siblings, name]) for name in group.model_fields]
    return unknown_name("setting", key, known)


def group_at(kind: type[Settings], path: Sequence[str]) -> type[Settings]:
    """The group of settings found by following ``path`` from ``kind``."""
    for name in path:
        annotation = kind.model_fields[name].annotation
        assert isinstance(annotation, type)
        assert issubclass(annotation, Settings)
        kind = annotation
    return kind


def parse_assignments(assignments: Iterable[str]) -> dict[str, Any]:
    """Turn ``["texture.bins=64"]`` into ``{"texture": {"bins": 64}}``.

    A value is read as TOML (numbers, true/false, quoted strings, lists); what is
    not TOML is a plain string. Raises ConfigError for an item without ``=``.
    """
    tree: dict[str, Any] = {}
    for item in assignments:
        key, equals, text = item.partition("=")
        names = key.strip().split(".")
        if not equals or not all(names):
            raise ConfigError(
                item, "is not a setting", "write key=value, for example texture.bins=64"
            )
        branch = tree
        for name in names[:-1]:
            branch = branch.setdefault(name, {})
            if not isinstance(branch, dict):
                raise ConfigError(key, f"{name} is already set to a value", "give each key once")
        if isinstance(branch.get(names[-1]), dict):
            raise ConfigError(key, "is a group of settings", "set one key inside it")
        branch[names[-1]] = _toml_value(text.strip())
    return tree


def _toml_value(text: str) -> Any:
    try:
        value = tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text
    return text if isinstance(value, float) and not math.isfinite(value) else value


def merge(base: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Nested values with changes on top; groups are merged, everything else replaced."""
    merged = dict(base)
    for key, value in changes.items():
        old = merged.get(key)
        both = isinstance(old, Mapping) and isinstance(value, Mapping)
        merged[key] = merge(old, value) if both else value  # type: ignore[arg-type]
    return merged


def read_settings_file(path: Path) -> dict[str, Any]:
    """The nested values of a TOML file; InputError when it cannot be read or parsed."""
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as problem:
        what = f"cannot be read: {problem.strerror}"
        raise InputError(path, what, "give a TOML file") from None
    except UnicodeDecodeError:
        raise InputError(path, "is not UTF-8 text", "give a TOML file") from None
    except tomllib.TOMLDecodeError as problem:
        raise ConfigError(path, f"is not TOML: {problem}", "mend that line") from None


def toml_lines(values: Mapping[str, Any], path: str = "") -> list[str]:
    """The lines of a TOML table: plain values first, groups as tables below. None is left out."""
    groups = {key: value for key, value in values.items() if isinstance(value, Mapping)}
    plain = {k: v for k, v in values.items() if k not in groups and v is not None}
    lines = [f"{key} = {_toml_text(value)}" for key, value in plain.items()]
    for key, group in groups.items():
        name = f"{path}.{key}" if path else key
        lines += ["", f"[{name}]", *toml_lines(group, name)]
    return lines


def _toml_text(value: Any) -> str:
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(_toml_text(item) for item in value)}]"
    # JSON's numbers, booleans and strings are TOML's as well.
    return json.dumps(value, ensure_ascii=False)
