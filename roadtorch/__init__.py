"""roadtorch: find the road in a single picture, on a CPU, without labels.

The names in ``__all__`` are what most programs need; what else they may rely on is in the modules
that the reference documents. Each is loaded when it is first used, so that ``import roadtorch``
(and with it ``roadtorch --help``) does not wait for torch.
"""

from typing import TYPE_CHECKING

import lazy_loader

from roadtorch.base.version import __version__

if TYPE_CHECKING:
    from roadtorch.base.errors import RoadtorchError
    from roadtorch.base.image import read_image
    from roadtorch.camera.camera import Camera
    from roadtorch.detectors.catalogue import list_detectors, load_detector
    from roadtorch.detectors.detection import Detection
    from roadtorch.detectors.detector import DetectorSettings
    from roadtorch.run.loop import detect_stream

__all__ = [
    "Camera",
    "Detection",
    "DetectorSettings",
    "RoadtorchError",
    "__version__",
    "detect_stream",
    "list_detectors",
    "load_detector",
    "read_image",
]

__getattr__, __dir__, _ = lazy_loader.attach(
    __name__,
    submod_attrs={
        "base.errors": ["RoadtorchError"],
        "base.image": ["read_image"],
        "camera.camera": ["Camera"],
        "detectors.detection": ["Detection"],
        "detectors.detector": ["DetectorSettings"],
        "detectors.catalogue": ["list_detectors", "load_detector"],
        "run.loop": ["detect_stream"],
    },
)
