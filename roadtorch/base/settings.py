"""Settings: frozen pydantic models whose mistakes read like sentences."""

import math
import os
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import pydantic
import tomli_w

from roadtorch.base.bounded import read_regular
from roadtorch.base.errors import ConfigError, InputError, shortened, unknown_name

SHOWN = 200  # letters of what was given that a refusal repeats

CONFIGS = Path(__file__).parents[1] / "configs"
"""The configs that come with roadtorch: a link to the repository's ``configs/``, so that they are
found beside the package in a checkout and in a wheel alike."""

THRESHOLDS = "thresholds/"
"""What the names of configs for detectors begin with; the others are for training."""

SUFFIX = ".toml"


class Settings(pydantic.BaseModel):
    """The base of every group of settings: frozen, and unknown keys are refused."""

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
    except pydantic.ValidationError as error:
        raise _first_mistake(kind, error) from None


def _first_mistake(kind: type[Settings], error: pydantic.ValidationError) -> ConfigError:
    mistake = error.errors()[0]
    path = [str(part) for part in mistake["loc"]]
    key = ".".join(path)
    if mistake["type"] == "extra_forbidden":
        known = group_at(kind, path[:-1]).model_fields
        return unknown_name("setting", key, [".".join([*path[:-1], name]) for name in known])
    if mistake["type"] == "missing":
        return ConfigError(key, "is missing", "give it a value")
    given = f"{shortened(repr(mistake['input']), SHOWN)} was given"
    if mistake["type"] == "model_type":
        known = ", ".join(group_at(kind, path).model_fields)
        return ConfigError(key, f"{given} for a group of settings", f"set one of its keys: {known}")
    reasons = getattr(mistake.get("ctx", {}).get("error"), "args", ())
    if reasons and isinstance(reasons[0], ConfigError):  # a validator's own words
        problem = f"{reasons[0].problem} {shortened(repr(mistake['input']), SHOWN)}"
        return ConfigError(key, problem, reasons[0].hint)
    message = mistake["msg"].removeprefix("Value error, ")
    return ConfigError(key, given, message[0].lower() + message[1:])


def group_at(kind: type[Settings], path: Sequence[str]) -> type[Settings]:
    """The innermost group of settings on ``path`` from ``kind``.

    What is no group, as the place in a list or the kind of a union, is passed over.
    """
    for name in path:
        field = kind.model_fields.get(name)
        annotation = field.annotation if field else None
        if isinstance(annotation, type) and issubclass(annotation, Settings):
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
    except (ValueError, RecursionError):
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
    """The nested values of a TOML file; InputError when it cannot be read or parsed.

    A name of a file with a suffix that lies beside it becomes its path: folders can be moved.
    """
    try:
        return _found_beside(path, tomllib.loads(read_regular(path).decode()))
    except OSError as error:
        problem = f"cannot be read: {error.strerror}"
        raise InputError(path, problem, "give a TOML file") from None
    except UnicodeDecodeError:
        raise InputError(path, "is not UTF-8 text", "give a TOML file") from None
    except (ValueError, RecursionError) as error:
        raise ConfigError(path, f"is not TOML: {error}", "mend that line") from None


def _found_beside(path: Path, values: dict[str, Any]) -> dict[str, Any]:
    """Nested values, the names of files in the folder of ``path`` as paths."""

    def beside(value: Any) -> Any:
        if isinstance(value, dict):
            return _found_beside(path, value)
        if not isinstance(value, str) or not Path(value).suffix:
            return value
        file = os.path.join(path.parent, value)
        return file if os.path.isfile(file) else value  # Path.is_file raises for names too long

    return {key: beside(value) for key, value in values.items()}


def to_toml(detector: str, settings: Settings) -> str:
    """The text of a file for ``--config`` that gives this detector with these settings."""
    return tomli_w.dumps({"detector": detector, **settings.model_dump(exclude_none=True)})


# --- shipped configs --------------------------------------------------------------------


def shipped_configs() -> list[str]:
    """Return the sorted names of all shipped configs: paths below ``configs/`` without suffix."""
    found = CONFIGS.rglob(f"*{SUFFIX}")
    return sorted(path.relative_to(CONFIGS).with_suffix("").as_posix() for path in found)


def config_file(text: str) -> Path:
    """Return the file that ``--config`` names: one that exists, or else one that is shipped.

    What ends in ``.toml`` is a file in any case. Raises ConfigError, with the known names, for
    a name that is neither.
    """
    path = Path(text)
    if path.suffix == SUFFIX or path.is_file():
        return path
    if text not in shipped_configs():
        raise unknown_name("config, and no file", text, shipped_configs())
    return CONFIGS / f"{text}{SUFFIX}"
