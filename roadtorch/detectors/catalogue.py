"""Detectors by name: the one door for commands, evaluation and tests.

Other packages add detectors through the entry-point group ``roadtorch.detectors``;
each entry point names an ``Entry`` or a sequence of them.
"""

import fnmatch
from collections.abc import Iterable
from functools import cache
from typing import Any

from roadtorch.detector import Detector, Entry
from roadtorch.detectors import fusion, layout, oneclass, priors, texture, ufl
from roadtorch.errors import ConfigError, unknown_name
from roadtorch.plugins import load_plugins
from roadtorch.settings import build_settings

ENTRY_POINT_GROUP = "roadtorch.detectors"


ENTRIES: tuple[Entry, ...] = (
    *fusion.ENTRIES,
    *layout.ENTRIES,
    *texture.ENTRIES,
    *ufl.ENTRIES,
    *oneclass.ENTRIES,
    *priors.ENTRIES,
)
"""All detectors of this package."""


def load_detector(name: str, **settings: Any) -> Detector:
    """Make a detector; settings that are not given keep their defaults.

    Nested settings are dictionaries: ``load_detector("cpf", texture={"bins": 64})``.
    Raises ConfigError for an unknown name or key and for values that are not allowed.
    """
    entry = detector_entry(name)
    return Detector(entry, build_settings(entry.settings, settings)).eval()


def list_detectors() -> list[str]:
    """The names of all detectors, sorted; those of other packages among them."""
    return sorted(_catalogue())


def detector_entry(name: str) -> Entry:
    """The entry of one detector; ConfigError with the nearest names if there is none."""
    entries = _catalogue()
    if name not in entries:
        raise unknown_detector(name)
    return entries[name]


def detector_groups() -> dict[str, list[Entry]]:
    """Every detector under its own name, those of a grid together under the grid's; sorted."""
    groups: dict[str, list[Entry]] = {}
    for entry in _catalogue().values():
        groups.setdefault(entry.grid.name if entry.grid else entry.name, []).append(entry)
    return dict(sorted(groups.items()))


def is_pattern(name: str) -> bool:
    """Whether a name has wildcards."""
    return any(letter in name for letter in "*?[")


def matching_detectors(pattern: str) -> list[str]:
    """The names of the detectors that a pattern with wildcards (``cpf*``) fits, sorted.

    Those of a grid only where the pattern begins with its family (``oneclass:*:HS``), so
    that ``*`` means what there is to compare, and not hundreds of combinations. Raises
    ConfigError when it fits none.
    """
    fitting = [detector_entry(name) for name in fnmatch.filter(list_detectors(), pattern)]
    found = [one for one in fitting if not one.grid or pattern.startswith(one.grid.family)]
    if not fitting:
        raise unknown_detector(pattern)
    if not found:
        grids = sorted({one.grid.name for one in fitting if one.grid})
        what = f"fits only detectors of {', '.join(grids)}"
        raise ConfigError(pattern, what, "begin it with the name of the family")
    return [one.name for one in found]


def unknown_detector(name: str) -> ConfigError:
    """The error for a name or a pattern that fits no detector: why, or the nearest names."""
    grids = [entry.grid for entry in _catalogue().values() if entry.grid]
    for grid in grids:
        if name in grid.refused:
            return ConfigError(name, grid.refused[name], f"choose another {grid.name}")
    return unknown_name("detector", name, list_detectors(), detector_groups())


def register(entry: Entry) -> None:
    """Add a detector for this process; ConfigError when its name is taken."""
    _add(_catalogue(), entry)


def _add(entries: dict[str, Entry], entry: Entry) -> None:
    if entry.name in entries:
        raise ConfigError(entry.name, "is the name of another detector", "choose a new name")
    if "threshold" not in entry.settings.model_fields:
        raise ConfigError(entry.name, "has settings without a threshold", "add that field")
    entries[entry.name] = entry


@cache
def _catalogue() -> dict[str, Entry]:
    entries: dict[str, Entry] = {}
    for entry in ENTRIES:
        _add(entries, entry)
    load_plugins(ENTRY_POINT_GROUP, "detectors", lambda _, offered: _add_all(entries, offered))
    return entries


def _add_all(entries: dict[str, Entry], offered: object) -> None:
    """Add what an entry point names: an entry, or a sequence of them."""
    if not isinstance(offered, Iterable):
        offered = (offered,)
    for entry in offered:
        if not isinstance(entry, Entry):
            raise ConfigError(repr(entry), "is no Entry", "name an Entry or a sequence of them")
        _add(entries, entry)
