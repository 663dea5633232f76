"""Detectors by name: the one door for commands, evaluation and tests.

Other packages add detectors through the entry-point group ``roadtorch.detectors``;
each entry point names an ``Entry`` or a sequence of them.
"""

import fnmatch
import os
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import Any

from roadtorch.base.compute import check_device
from roadtorch.base.errors import ConfigError, unknown_name
from roadtorch.base.image import Order
from roadtorch.base.plugins import load_plugins
from roadtorch.base.settings import merge, read_settings_file
from roadtorch.camera.camera import Camera
from roadtorch.detectors import baselines, fusion, layout, oneclass, texture, ufl
from roadtorch.detectors.detector import Detector, DetectorSettings, Entry

ENTRY_POINT_GROUP = "roadtorch.detectors"

CONFIG = "detector.toml"
"""In a folder that holds a detector: its name, its settings, and the name of its weights' file."""

ENTRIES: tuple[Entry, ...] = (
    *fusion.ENTRIES,
    *layout.ENTRIES,
    *texture.ENTRIES,
    *ufl.ENTRIES,
    *baselines.ENTRIES,
    *oneclass.ENTRIES,
)
"""All detectors of this package."""


def load_detector(
    name: str,
    *,
    camera: Camera | None = None,
    order: Order | None = None,
    device: str | None = None,
    **settings: Any,
) -> Detector:
    """Make a detector; settings that are not given keep their defaults.

    name: of a detector, or a folder that ``roadtorch export --format hub`` wrote.
    Nested settings are dictionaries: ``load_detector("cpf", texture={"bins": 64})``.
    camera: the one whose images it will see, such as ``Camera.read("camera.toml")``; it sets
    the ego car and, where the detector has one, the horizon, unless they are given.
    order: of the colours of the NumPy arrays it will see: ``"bgr"`` of OpenCV's, else ``"rgb"``.
    device: of torch, ``"cuda"``: images are moved there, and what is detected stays there.
    Raises ConfigError for an unknown name or key, for values that are not allowed, and for a device
    that this machine lacks.

        >>> from roadtorch import load_detector
        >>> detector = load_detector("fusion", threshold=0.6)
        >>> detector("street.jpg").mask.shape
        torch.Size([240, 320])
    """
    if name not in _catalogue() and os.path.isdir(name):
        stored = read_settings_file(Path(name, CONFIG))
        name, settings = str(stored.pop("detector", "")), merge(stored, settings)
    entry = detector_entry(name)
    if camera is not None:
        settings = merge(camera.settings_for(entry.settings), settings)
    if device is not None:
        check_device(device, "device")
    return Detector(entry, entry.configured(settings), order, device).eval()


def list_detectors(pattern: str | None = None) -> list[str]:
    """What there is to compare, sorted: every detector, and of a grid of hundreds its name alone.

    With a pattern (``cpf*``) the detectors that it fits: those of a grid only where it begins
    with their family (``oneclass:*:HS``) and ends with their preset (``oneclass:*:paper``), so
    that ``*`` does not mean hundreds of combinations.
    Detectors of other packages are among them. Raises ConfigError for a pattern that fits none.

        >>> from roadtorch import list_detectors
        >>> list_detectors("prior:t*")
        ['prior:triangle']
    """
    if pattern is None:
        return list(detector_groups())
    fitting = [detector_entry(name) for name in fnmatch.filter(sorted(_catalogue()), pattern)]
    if not fitting:
        raise unknown_detector(pattern)
    names = [entry.name for entry in fitting if not entry.grid or entry.grid.fits(pattern)]
    if not names:
        grids = sorted({entry.grid.name for entry in fitting if entry.grid})
        problem = f"fits only detectors of {', '.join(grids)}"
        raise ConfigError(pattern, problem, "begin it with the name of the family")
    return names


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


def unknown_detector(name: str) -> ConfigError:
    """The error for a name or a pattern that fits no detector: why, or the nearest names."""
    grids = {entry.grid.name: entry.grid for entry in _catalogue().values() if entry.grid}
    for grid in grids.values():
        if name in grid.refused:
            return ConfigError(name, grid.refused[name], f"choose another {grid.name}")
    if name in grids:
        hint = f"name one; '{grids[name].wildcard}' lists them"
        return ConfigError(name, "stands for many detectors", hint)
    return unknown_name("detector", name, _catalogue(), detector_groups())


def register(entry: object, entries: dict[str, Entry] | None = None) -> None:
    """Add a detector to the entries of this process; ConfigError when its name is taken."""
    entries = _catalogue() if entries is None else entries
    if not isinstance(entry, Entry):
        raise ConfigError(repr(entry), "is no Entry", "name an Entry or a sequence of them")
    if entry.name in entries:
        raise ConfigError(entry.name, "is the name of another detector", "choose a new name")
    if not issubclass(entry.settings, DetectorSettings):
        problem = f"has settings ({entry.settings.__name__}) that are no DetectorSettings"
        raise ConfigError(entry.name, problem, "derive them from roadtorch.DetectorSettings")
    entries[entry.name] = entry


@cache
def _catalogue() -> dict[str, Entry]:
    entries: dict[str, Entry] = {}

    for entry in ENTRIES:
        register(entry, entries)

    def add(_: str, offered: object) -> None:
        for entry in offered if isinstance(offered, Iterable) else (offered,):
            register(entry, entries)

    load_plugins(ENTRY_POINT_GROUP, "detectors", add)
    return entries
