"""Settings: frozen pydantic models, their TOML files and ``--set`` assignments."""

import math
import os
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar, get_args

import pydantic
import tomli_w

from roadtorch.base.bounded import read_regular
from roadtorch.base.errors import ConfigError, InputError, truncate_middle, unknown_name_error

MAX_VALUE_LENGTH = 200  # characters of a wrong value that an error repeats

CONFIGS = Path(__file__).parents[1] / "configs"
"""Folder of the shipped configs: a link to the repository's ``configs/``, so that a checkout and a
wheel both have them in the package."""

THRESHOLDS_PREFIX = "thresholds/"
"""Prefix of the names of configs for detectors; the others are for training."""

CONFIG_SUFFIX = ".toml"
INFER_CONFIG = "config.toml"  # settings that ``infer`` writes beside its results


class Settings(pydantic.BaseModel):
    """Base of every group of settings: frozen, strict, and without unknown keys."""

    model_config = pydantic.ConfigDict(
        frozen=True, extra="forbid", strict=True, validate_default=True, allow_inf_nan=False
    )


AnySettings = TypeVar("AnySettings", bound=Settings)


def build_settings(settings_class: type[AnySettings], values: Mapping[str, object]) -> AnySettings:
    """Build settings from values by key, a mapping for a group; missing keys get their defaults.

    Raises:
        ConfigError: a wrong key or value; names the full key (``texture.bins``), the value and
            what is allowed.
    """
    try:
        return settings_class.model_validate(dict(values))
    except pydantic.ValidationError as error:
        raise _config_error(settings_class, error) from None


def _config_error(settings_class: type[Settings], error: pydantic.ValidationError) -> ConfigError:
    details = error.errors()[0]
    path = [str(part) for part in details["loc"]]
    key = ".".join(path)
    if details["type"] == "extra_forbidden":
        names = find_settings_group(settings_class, path[:-1]).model_fields
        return unknown_name_error("setting", key, [".".join([*path[:-1], name]) for name in names])
    if details["type"] == "missing":
        return ConfigError(key, "is missing", "give it a value")
    value = truncate_middle(repr(details["input"]), MAX_VALUE_LENGTH)
    if details["type"] == "model_type":
        names = ", ".join(find_settings_group(settings_class, path).model_fields)
        problem = f"{value} was given for a group of settings"
        return ConfigError(key, problem, f"set one of its keys: {names}")
    arguments = getattr(details.get("ctx", {}).get("error"), "args", ())
    if arguments and isinstance(arguments[0], ConfigError):  # raised by a validator
        return ConfigError(key, f"{arguments[0].problem} {value}", arguments[0].hint)
    message = details["msg"].removeprefix("Value error, ")
    return ConfigError(key, f"{value} was given", message[0].lower() + message[1:])


def find_settings_group(settings_class: type[Settings], path: Sequence[str]) -> type[Settings]:
    """Return the class of the innermost group of settings on a path of keys.

    Keys that are no group, such as positions in a list or the kind of a union, are skipped.
    """
    for name in path:
        field = settings_class.model_fields.get(name)
        annotation = field.annotation if field else None
        for group in (annotation, *get_args(annotation)):  # an optional group is a union
            if isinstance(group, type) and issubclass(group, Settings):
                settings_class = group
    return settings_class


def parse_assignments(assignments: Iterable[str]) -> dict[str, Any]:
    """Turn ``["texture.bins=64"]`` into ``{"texture": {"bins": 64}}``.

    Args:
        assignments: ``key=value`` each. A value is read as TOML (numbers, true/false, quoted
            strings, lists); what is not TOML is a plain string.

    Raises:
        ConfigError: an assignment without ``=``, or a key given twice.
    """
    tree: dict[str, Any] = {}
    for item in assignments:
        key, equals, text = item.partition("=")
        names = key.strip().split(".")
        if not equals or not all(names):
            hint = "write key=value, for example texture.bins=64"
            raise ConfigError(item, "is not a setting", hint)
        branch = tree
        for name in names[:-1]:
            branch = branch.setdefault(name, {})
            if not isinstance(branch, dict):
                raise ConfigError(key, f"{name} is already set to a value", "give each key once")
        if names[-1] in branch:
            raise ConfigError(key, "is a group of settings, or is given twice", "set each key once")
        branch[names[-1]] = _toml_value(text.strip())
    return tree


def _toml_value(text: str) -> object:
    try:
        value = tomllib.loads(f"value = {text}")["value"]
    except (ValueError, RecursionError):
        return text
    return text if isinstance(value, float) and not math.isfinite(value) else value


def merge(base: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return nested values with changes: groups are merged, other values replaced."""
    merged = dict(base)
    for key, value in changes.items():
        old = merged.get(key)
        are_groups = isinstance(old, Mapping) and isinstance(value, Mapping)
        merged[key] = merge(old, value) if are_groups else value  # type: ignore[arg-type]
    return merged


def read_settings_file(path: Path) -> dict[str, Any]:
    """Read the nested values of a TOML file.

    A string that names an existing file with a suffix in the same folder becomes its path, so that
    the folder can be moved. Raises InputError for an unreadable file, ConfigError for one that is
    not TOML.
    """
    try:
        return _resolve_files(path, tomllib.loads(read_regular(path).decode("utf-8-sig")))
    except OSError as error:
        raise InputError(path, f"cannot be read: {error.strerror}", "give a TOML file") from None
    except UnicodeDecodeError:
        raise InputError(path, "is not UTF-8 text", "give a TOML file") from None
    except (ValueError, RecursionError) as error:
        raise ConfigError(path, f"is not TOML: {error}", "fix that line") from None


def _resolve_files(path: Path, values: dict[str, Any]) -> dict[str, Any]:
    """Replace the names of files in the folder of ``path`` by their paths."""

    def resolve(value: object) -> object:
        if isinstance(value, dict):
            return _resolve_files(path, value)
        if not isinstance(value, str) or not Path(value).suffix:
            return value
        file = os.path.join(path.parent, value)
        return file if os.path.isfile(file) else value  # Path.is_file raises for names too long

    return {key: resolve(value) for key, value in values.items()}


def to_toml(detector: str, settings: Settings) -> str:
    """Return a detector with its settings as TOML for ``--config``, without the last line end."""
    values = {"detector": detector, **settings.model_dump(exclude_none=True)}
    return tomli_w.dumps(values).removesuffix("\n")


# --- shipped files ----------------------------------------------------------------------


def list_shipped(folder: Path, suffix: str) -> list[str]:
    """Return the sorted names of shipped files: paths below a folder, without suffix."""
    files = folder.rglob(f"*{suffix}")
    return sorted(path.relative_to(folder).with_suffix("").as_posix() for path in files)


def resolve_name(text: str, kind: str, folder: Path, suffix: str) -> Path:
    """Return the file that a text names: the shipped one of that name, or else a path.

    A path has a suffix, or a separator and exists. ConfigError, with the nearest names, otherwise.
    """
    names = list_shipped(folder, suffix)
    if text in names:
        return folder / f"{text}{suffix}"
    path = Path(text)
    if path.suffix or (not {"/", os.sep}.isdisjoint(text) and os.path.exists(text)):
        return path
    raise unknown_name_error(f"{kind}, and no path such as ./NAME{suffix}", text, names)


def list_shipped_configs() -> list[str]:
    """Return the sorted names of all shipped configs."""
    return list_shipped(CONFIGS, CONFIG_SUFFIX)


def find_config(text: str) -> Path:
    """Return the file that ``--config`` names; raises as ``resolve_name``."""
    return resolve_name(text, "config", CONFIGS, CONFIG_SUFFIX)
