"""Catalogue of detectors by name, for Python and for every command.

A program adds a detector of its own with ``register_detector``; a package through the entry-point
group ``roadtorch.detectors``, each entry point naming an ``Entry`` or a sequence of them.
"""

import fnmatch
from collections.abc import Callable, Iterable, Mapping
from functools import cache
from typing import Any, Never, TypeVar

from torch import nn

from roadtorch.base.compute import check_device, default_to_cpu
from roadtorch.base.errors import ConfigError, unknown_name_error
from roadtorch.base.image import ColourOrder
from roadtorch.base.plugins import load_plugins
from roadtorch.base.settings import merge
from roadtorch.camera.camera import Camera
from roadtorch.detectors import baselines, fusion, illuminant, layout, oneclass, texture, ufl
from roadtorch.detectors.detector import Detector
from roadtorch.detectors.entry import DetectorSettings, Entry
from roadtorch.detectors.rectified import Rectified
from roadtorch.layout.runtimes import REFERENCE, check_runtime

Build = TypeVar("Build", bound=Callable[[Any], nn.Module])

DETECTOR_ENTRY_POINTS = "roadtorch.detectors"

ENTRIES: tuple[Entry, ...] = (
    *fusion.ENTRIES,
    *layout.ENTRIES,
    *texture.ENTRIES,
    *ufl.ENTRIES,
    *illuminant.ENTRIES,
    *baselines.ENTRIES,
    *oneclass.ENTRIES,
)
"""All detectors of roadtorch."""


def load_detector(
    name: str,
    *positional: Never,
    camera: Camera | None = None,
    order: ColourOrder | None = None,
    device: str | None = None,
    runtime: str = REFERENCE,
    **settings: Any,
) -> Detector:
    """Load a detector.

    Args:
        name: of a detector.
        *positional: refused: all other arguments are named.
        camera: camera that takes the images, such as ``Camera.read("camera.toml")``; sets the ego
            car and, where the detector has one, the horizon.
        order: colour order of NumPy arrays: ``"bgr"`` for OpenCV's, else ``"rgb"``.
        device: torch device, such as ``"cuda"``; images are moved there, and results of ``detect``
            stay there. Those of ``stream`` are on the CPU.
        runtime: library that computes the network on the CPU: ``"torch"`` or ``"onnxruntime"``
            (extra ``onnx``). Of the detector's weights when it is loaded, without gradients.
        **settings: changes of the defaults. Nested ones are dictionaries:
            ``load_detector("cpf", texture={"bins": 64})``.

    Raises:
        ConfigError: Unknown name or key, value that is not allowed, or unavailable device; runtime
            that is unknown or not installed, or a detector without a network for it.

    >>> from roadtorch import load_detector
    >>> detector = load_detector("fusion", threshold=0.6)
    >>> detection = detector("street.jpg")
    >>> detection.likelihood.shape  # torch tensors, as is the mask
    torch.Size([240, 320])
    >>> detection.mask.numpy().dtype
    dtype('bool')
    """
    if positional or not isinstance(name, str):
        where, value = ("settings", positional[0]) if positional else ("name", name)
        hint = 'write load_detector("fusion", threshold=0.5), camera=… and order=… likewise'
        raise ConfigError(where, f"got {type(value).__name__} by position", hint)
    entry = detector_entry(name)
    if not isinstance(camera, Camera | None):
        problem, hint = f"is {type(camera).__name__}", 'give Camera.read("camera.toml")'
        raise ConfigError("camera", problem, hint)
    if camera is not None:
        settings = merge(camera.settings_for(entry.settings), settings)
    if device is not None:
        check_device(device, "device")
    check_runtime(runtime, device)
    with default_to_cpu():
        return build_detector(entry, entry.make_settings(settings), order, device, runtime)


def build_detector(
    entry: Entry,
    settings: DetectorSettings,
    order: ColourOrder | None = None,
    device: str | None = None,
    runtime: str = REFERENCE,
) -> Detector:
    """Build the detector of an entry, behind a lens where its settings have one."""
    detector = Detector(entry, settings, order, device, runtime)
    if settings.rectification is not None:
        detector = Rectified(detector)
    return detector.eval()


def list_detectors(pattern: str | None = None) -> list[str]:
    """Return the names of all detectors, sorted, those of other packages included.

    A grid of hundreds of detectors is listed by its own name, and ``*`` does not expand it.

    Args:
        pattern: wildcards (``cpf*``). Detectors of a grid match only if it begins with their
            family (``oneclass:*:HS``) and ends with their preset (``oneclass:*:paper``).

    Raises:
        ConfigError: No detector matches.

    >>> from roadtorch import list_detectors
    >>> list_detectors("prior:t*")
    ['prior:triangle']
    """
    if pattern is None:
        return list(detector_groups())
    entries = [detector_entry(name) for name in fnmatch.filter(sorted(_catalogue()), pattern)]
    if not entries:
        raise unknown_detector_error(pattern)
    names = [entry.name for entry in entries if not entry.grid or entry.grid.matches(pattern)]
    if not names:
        grids = sorted({entry.grid.name for entry in entries if entry.grid})
        problem = f"matches only detectors of {', '.join(grids)}"
        raise ConfigError(pattern, problem, "begin it with the name of the family")
    return names


def detector_entry(name: str) -> Entry:
    """Return the entry of a detector; ConfigError with the nearest names if there is none."""
    entries = _catalogue()
    if name not in entries:
        raise unknown_detector_error(name)
    return entries[name]


def detector_groups() -> dict[str, list[Entry]]:
    """Return the entries sorted by name, those of a grid under the grid's."""
    groups: dict[str, list[Entry]] = {}
    for entry in _catalogue().values():
        groups.setdefault(entry.grid.name if entry.grid else entry.name, []).append(entry)
    return dict(sorted(groups.items()))


def is_pattern(name: str) -> bool:
    """Return whether a name has wildcards."""
    return any(letter in name for letter in "*?[")


def unknown_detector_error(name: str) -> ConfigError:
    """Return the error for a name without a detector, with the reason or the nearest names."""
    grids = {entry.grid.name: entry.grid for entry in _catalogue().values() if entry.grid}
    for grid in grids.values():
        if name in grid.invalid:
            return ConfigError(name, grid.invalid[name], f"choose another {grid.name}")
    if name in grids:
        hint = f"name one; '{grids[name].wildcard}' lists them"
        return ConfigError(name, "is a grid of many detectors", hint)
    return unknown_name_error("detector", name, _catalogue(), detector_groups())


def register_detector(
    name: str,
    settings: type[DetectorSettings] = DetectorSettings,
    *,
    summary: str = "",
    defaults: Mapping[str, object] | None = None,
) -> Callable[[Build], Build]:
    """Register a detector in this process: decorator of the class (or function) that builds it.

    See ``Entry`` for the class; the entry points of packages name an entry instead.

    Args:
        name: ``family[:option[:option]]``.
        settings: class of its settings.
        summary: one line for lists; if empty, the first line of the docstring.
        defaults: values that differ from those of the settings, nested.

    Raises:
        ConfigError: The name is taken, or the settings are not derived from DetectorSettings.

    >>> from roadtorch import load_detector, register_detector
    >>> from torch import nn
    >>> @register_detector("bright")
    ... class Bright(nn.Module):
    ...     '''Brighter is more road.'''
    ...     def __init__(self, settings):
    ...         super().__init__()
    ...     def forward(self, image):
    ...         return {"likelihood": image.mean(0)}
    >>> load_detector("bright", threshold=0.4)
    <Detector bright, threshold=0.4>
    """
    if not isinstance(name, str):
        hint = 'write @register_detector("name", YourSettings) above the class'
        raise ConfigError("name", f"is {getattr(name, '__name__', name)}", hint)

    def decorate(build: Build) -> Build:
        text = summary or (build.__doc__ or "").strip().partition("\n")[0].rstrip(".")
        _add(Entry(name, text, settings, build, defaults=defaults or {}), _catalogue())
        return build

    return decorate


def _add(entry: object, entries: dict[str, Entry]) -> None:
    """Add an entry; ConfigError if it is none, its name is taken or its settings do not fit."""
    if not isinstance(entry, Entry):
        raise ConfigError(repr(entry), "is not an Entry", "name an Entry or a sequence of them")
    if entry.name in entries:
        raise ConfigError(entry.name, "is already the name of a detector", "choose another name")
    if not issubclass(entry.settings, DetectorSettings):
        problem = f"has settings ({entry.settings.__name__}) that are not DetectorSettings"
        raise ConfigError(entry.name, problem, "derive them from roadtorch.DetectorSettings")
    entries[entry.name] = entry


@cache
def _catalogue() -> dict[str, Entry]:
    entries: dict[str, Entry] = {}

    for entry in ENTRIES:
        _add(entry, entries)

    def add(_: str, offered: object) -> None:
        for entry in offered if isinstance(offered, Iterable) else (offered,):
            _add(entry, entries)

    load_plugins(DETECTOR_ENTRY_POINTS, add)
    return entries
