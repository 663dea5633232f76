"""A detector and its settings: from options and TOML files, and back to TOML."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from roadtorch.errors import ConfigError
from roadtorch.settings import Settings, parse_assignments, read_settings_file

DEFAULT_DETECTOR = "fusion"


def chosen_detector(
    detector: str | None,
    config: Path | None,
    assignments: Sequence[str],
    threshold: float | None,
) -> tuple[str, dict[str, Any]]:
    """The detector's name and the values of its settings.

    The file's values yield to ``--set``, and those to ``--threshold``. The file may
    name the detector under ``detector``.
    """
    values = read_settings_file(config) if config else {}
    named = values.pop("detector", DEFAULT_DETECTOR)
    if not isinstance(named, str):
        raise ConfigError("detector", f"{named!r} was given", "give a name in quotes")
    values = merge(values, parse_assignments(assignments))
    if threshold is not None:
        values["threshold"] = threshold
    return detector or named, values


def merge(base: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Nested values with changes on top; groups are merged, everything else replaced."""
    merged = dict(base)
    for key, value in changes.items():
        old = merged.get(key)
        both = isinstance(old, Mapping) and isinstance(value, Mapping)
        merged[key] = merge(old, value) if both else value  # type: ignore[arg-type]
    return merged


def as_toml(detector: str, settings: Settings) -> str:
    """A file for ``--config`` that gives this detector with these settings."""
    return "\n".join([f"detector = {json.dumps(detector)}", *_table(settings.model_dump(), "")])


def _table(values: Mapping[str, Any], path: str) -> list[str]:
    """The lines of one table: plain values first, as TOML wants it. None is left out."""
    groups = {key: value for key, value in values.items() if isinstance(value, Mapping)}
    plain = {k: v for k, v in values.items() if k not in groups and v is not None}
    lines = [f"{key} = {_value(value)}" for key, value in plain.items()]
    for key, group in groups.items():
        name = f"{path}.{key}" if path else key
        lines += ["", f"[{name}]", *_table(group, name)]
    return lines


def _value(value: Any) -> str:
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(_value(item) for item in value)}]"
    # JSON's numbers, booleans and strings are TOML's as well.
    return json.dumps(value, ensure_ascii=False)
