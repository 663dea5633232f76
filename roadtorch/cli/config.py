"""A detector and its settings: from options and TOML files, and back to TOML."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from roadtorch.errors import ConfigError
from roadtorch.settings import (
    Settings,
    merge,
    parse_assignments,
    read_settings_file,
    toml_lines,
)

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


def as_toml(detector: str, settings: Settings) -> str:
    """A file for ``--config`` that gives this detector with these settings."""
    return "\n".join([f"detector = {json.dumps(detector)}", *toml_lines(settings.model_dump())])
