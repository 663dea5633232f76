"""The exported file of `fusion:large`, made once, as tracing it takes long."""

import pytest

from roadtorch.detectors.catalogue import load_detector
from roadtorch.export.export import ExportResult, export_detector

NAME = "fusion:large"


@pytest.fixture(scope="session")
def fusion(tmp_path_factory: pytest.TempPathFactory) -> ExportResult:
    """Export the detector, with the parity check."""
    return export_detector(load_detector(NAME), tmp_path_factory.mktemp("fusion") / "road.onnx")
