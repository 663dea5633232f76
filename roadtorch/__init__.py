"""roadtorch: find the road in a single picture, on a CPU, without labels.

The names in ``__all__`` are what most programs need. What else they may rely on is in the modules
that the reference documents; what earlier versions had here can still be imported from here.
All is loaded when it is first used, so that ``import roadtorch`` (and with it ``roadtorch --help``)
does not wait for torch.
"""

import importlib
from typing import TYPE_CHECKING

from roadtorch.version import __version__

if TYPE_CHECKING:
    from roadtorch.camera.calibration import read_camera_info as read_camera_info
    from roadtorch.camera.camera import Camera as Camera
    from roadtorch.camera.footage import camera_of as camera_of
    from roadtorch.camera.footage import still_ego as still_ego
    from roadtorch.camera.ground import GroundCamera as GroundCamera
    from roadtorch.camera.ground import Lens as Lens
    from roadtorch.camera.ground import lens_of_view as lens_of_view
    from roadtorch.camera.ground import mounted as mounted
    from roadtorch.camera.ground_grid import Grid as Grid
    from roadtorch.camera.ground_grid import GridSettings as GridSettings
    from roadtorch.camera.ground_grid import ground_grid as ground_grid
    from roadtorch.data.catalogue import list_datasets as list_datasets
    from roadtorch.data.catalogue import open_dataset as open_dataset
    from roadtorch.data.dataset import Dataset as Dataset
    from roadtorch.data.dataset import Item as Item
    from roadtorch.data.dataset import Kind as Kind
    from roadtorch.data.dataset import Truth as Truth
    from roadtorch.data.labels import ColourLabels as ColourLabels
    from roadtorch.data.labels import NumberLabels as NumberLabels
    from roadtorch.detection import Detection
    from roadtorch.detector import Detector as Detector
    from roadtorch.detector import DetectorSettings as DetectorSettings
    from roadtorch.detector import Entry as Entry
    from roadtorch.detectors.catalogue import list_detectors, load_detector
    from roadtorch.errors import ConfigError as ConfigError
    from roadtorch.errors import DatasetError as DatasetError
    from roadtorch.errors import InputError as InputError
    from roadtorch.errors import RoadtorchError as RoadtorchError
    from roadtorch.errors import WeightsError as WeightsError
    from roadtorch.evaluation.evaluate import evaluate as evaluate
    from roadtorch.evaluation.measure import Measure as Measure
    from roadtorch.evaluation.result import Evaluation as Evaluation
    from roadtorch.io.image import read_image
    from roadtorch.layout.labeller import label_layout as label_layout
    from roadtorch.sinks.grid import write_grid as write_grid
    from roadtorch.sources.frame import Frame as Frame
    from roadtorch.sources.frame import Selection as Selection
    from roadtorch.sources.frame import Source as Source
    from roadtorch.stream import detect_stream

_HOMES = {
    "Camera": "roadtorch.camera.camera",
    "ColourLabels": "roadtorch.data.labels",
    "ConfigError": "roadtorch.errors",
    "Dataset": "roadtorch.data.dataset",
    "DatasetError": "roadtorch.errors",
    "Detection": "roadtorch.detection",
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
    "Detection",
    "__version__",
    "detect_stream",
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
