"""roadtorch: road detection from a single image, on a CPU, without labels.

The names in ``__all__`` are what most programs need; other public names are in the modules that
the reference documents. Each is imported when it is first used, so that ``import roadtorch`` (and
with it ``roadtorch --help``) does not wait for torch.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from roadtorch.base.version import __version__

if TYPE_CHECKING:
    from roadtorch.base.errors import RoadtorchError
    from roadtorch.base.image import read_image
    from roadtorch.camera.camera import Camera
    from roadtorch.detectors.catalogue import list_detectors, load_detector, register_detector
    from roadtorch.detectors.detection import Detection
    from roadtorch.detectors.entry import DetectorSettings, Entry
    from roadtorch.detectors.stream import detect_stream

__all__ = [
    "Camera",
    "Detection",
    "DetectorSettings",
    "Entry",
    "RoadtorchError",
    "__version__",
    "detect_stream",
    "list_detectors",
    "load_detector",
    "read_image",
    "register_detector",
]

_MODULES = {
    "Camera": "camera.camera",
    "Detection": "detectors.detection",
    "DetectorSettings": "detectors.entry",
    "Entry": "detectors.entry",
    "RoadtorchError": "base.errors",
    "detect_stream": "detectors.stream",
    "list_detectors": "detectors.catalogue",
    "load_detector": "detectors.catalogue",
    "read_image": "base.image",
    "register_detector": "detectors.catalogue",
}


def __getattr__(name: str) -> Any:
    """Import a public name from its module when it is first used (PEP 562)."""
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = value = getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
    return value


def __dir__() -> list[str]:
    """Return the public names."""
    return sorted(_MODULES)
