"""The exported file of fusion, made once: tracing it takes half a minute."""

import pytest

from roadtorch.detectors.catalogue import load_detector
from roadtorch.export.export import Exported, export_detector


@pytest.fixture(scope="session")
def fusion(tmp_path_factory: pytest.TempPathFactory) -> Exported:
    return export_detector(load_detector("fusion"), tmp_path_factory.mktemp("fusion") / "road.onnx")
