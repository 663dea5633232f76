"""roadtorch: find the road in a single picture, on a CPU, without labels.

The names in ``__all__`` are what programs may rely on; so are ``roadtorch.testing``, the
one-class classifiers of ``roadtorch.oneclass`` and the steps of the papers by the names that
the documents give. They are loaded when they are first used, so that ``import roadtorch``
(and with it ``roadtorch --help``) does not wait for torch.
"""

import importlib
from typing import TYPE_CHECKING

from roadtorch.version import __version__

if TYPE_CHECKING:
    from roadtorch.camera.calibration import read_camera_info
    from roadtorch.camera.camera import Camera
    from roadtorch.camera.footage import camera_of, still_ego
    from roadtorch.camera.ground import GroundCamera, Lens, lens_of_view, mounted
    from roadtorch.camera.ground_grid import Grid, GridSettings, ground_grid
    from roadtorch.data.catalogue import list_datasets, open_dataset
    from roadtorch.data.dataset import Dataset, Item, Kind, Truth
    from roadtorch.data.labels import ColourLabels, NumberLabels
    from roadtorch.detector import Detection, Detector, DetectorSettings, Entry
    from roadtorch.detectors.catalogue import list_detectors, load_detector
    from roadtorch.errors import (
        ConfigError,
        DatasetError,
        InputError,
        RoadtorchError,
        WeightsError,
    )
    from roadtorch.evaluation.evaluate import evaluate
    from roadtorch.evaluation.measure import Measure
    from roadtorch.evaluation.result import Evaluation
    from roadtorch.io.image import read_image
    from roadtorch.layout.labeller import label_layout
    from roadtorch.sinks.grid import write_grid
    from roadtorch.sources.frame import Frame, Selection, Source
    from roadtorch.stream import detect_stream

_HOMES = {
    "Camera": "roadtorch.camera.camera",
    "ColourLabels": "roadtorch.data.labels",
    "ConfigError": "roadtorch.errors",
    "Dataset": "roadtorch.data.dataset",
    "DatasetError": "roadtorch.errors",
    "Detection": "roadtorch.detector",
    "Detector": "roadtorch.detector",
    "DetectorSettings": "roadtorch.detector",
    "Entry": "roadtorch.detector",
    "Evaluation": "roadtorch.evaluation.result",
    "Frame": "roadtorch.sources.frame",
    "Grid": "roadtorch.camera.ground_grid",
    "GridSettings": "roadtorch.camera.ground_grid",
    "GroundCamera": "roadtorch.camera.ground",
    "InputError": "roadtorch.errors",
    "Item": "roadtorch.data.dataset",
    "Kind": "roadtorch.data.dataset",
    "Lens": "roadtorch.camera.ground",
    "Measure": "roadtorch.evaluation.measure",
    "NumberLabels": "roadtorch.data.labels",
    "RoadtorchError": "roadtorch.errors",
    "Selection": "roadtorch.sources.frame",
    "Source": "roadtorch.sources.frame",
    "Truth": "roadtorch.data.dataset",
    "WeightsError": "roadtorch.errors",
    "camera_of": "roadtorch.camera.footage",
    "detect_stream": "roadtorch.stream",
    "evaluate": "roadtorch.evaluation.evaluate",
    "ground_grid": "roadtorch.camera.ground_grid",
    "label_layout": "roadtorch.layout.labeller",
    "lens_of_view": "roadtorch.camera.ground",
    "list_datasets": "roadtorch.data.catalogue",
    "list_detectors": "roadtorch.detectors.catalogue",
    "load_detector": "roadtorch.detectors.catalogue",
    "mounted": "roadtorch.camera.ground",
    "open_dataset": "roadtorch.data.catalogue",
    "read_camera_info": "roadtorch.camera.calibration",
    "read_image": "roadtorch.io.image",
    "still_ego": "roadtorch.camera.footage",
    "write_grid": "roadtorch.sinks.grid",
}

__all__ = [
    "Camera",
    "ColourLabels",
    "ConfigError",
    "Dataset",
    "DatasetError",
    "Detection",
    "Detector",
    "DetectorSettings",
    "Entry",
    "Evaluation",
    "Frame",
    "Grid",
    "GridSettings",
    "GroundCamera",
    "InputError",
    "Item",
    "Kind",
    "Lens",
    "Measure",
    "NumberLabels",
    "RoadtorchError",
    "Selection",
    "Source",
    "Truth",
    "WeightsError",
    "__version__",
    "camera_of",
    "detect_stream",
    "evaluate",
    "ground_grid",
    "label_layout",
    "lens_of_view",
    "list_datasets",
    "list_detectors",
    "load_detector",
    "mounted",
    "open_dataset",
    "read_camera_info",
    "read_image",
    "still_ego",
    "write_grid",
]


def __getattr__(name: str) -> object:
    """Import the module of a public name on its first use."""
    if name not in _HOMES:
        raise AttributeError(f"module 'roadtorch' has no attribute {name!r}")
    return getattr(importlib.import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return __all__
