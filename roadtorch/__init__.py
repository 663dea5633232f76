"""roadtorch: find the road in a single picture, on a CPU, without labels.

The public names are loaded when they are first used, so that ``import roadtorch``
(and with it ``roadtorch --help``) does not wait for torch.
"""

import importlib
from typing import TYPE_CHECKING

from roadtorch.version import __version__

if TYPE_CHECKING:
    from roadtorch.detector import Detection, Detector
    from roadtorch.detectors.catalogue import list_detectors, load_detector
    from roadtorch.image import read_image

_HOMES = {
    "Detection": "roadtorch.detector",
    "Detector": "roadtorch.detector",
    "list_detectors": "roadtorch.detectors.catalogue",
    "load_detector": "roadtorch.detectors.catalogue",
    "read_image": "roadtorch.image",
}

__all__ = [
    "Detection",
    "Detector",
    "__version__",
    "list_detectors",
    "load_detector",
    "read_image",
]


def __getattr__(name: str) -> object:
    """Import the module of a public name on its first use."""
    if name not in _HOMES:
        raise AttributeError(f"module 'roadtorch' has no attribute {name!r}")
    return getattr(importlib.import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return __all__
