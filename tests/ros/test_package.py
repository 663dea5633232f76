"""The ament package: names, versions and parameters agree with those of the node."""

import ast
from pathlib import Path
from xml.etree import ElementTree

from roadtorch.base.version import __version__
from roadtorch.ros.parameters import NodeParameters
from roadtorch.run.writers.bag import LABELS_TOPIC, MASK_TOPIC, POINTS_TOPIC
from tests.reference.semantic_layer import NAV2_PARAMETERS

PACKAGE = Path(__file__).resolve().parents[2] / "ros" / "roadtorch_ros"


def keys_of(file: Path, name: str) -> set[str]:
    """Return the keys of the dictionary that a module assigns to a name."""
    (mapping,) = (
        part.value
        for part in ast.parse(file.read_text("utf-8")).body
        if isinstance(part, ast.Assign) and ast.unparse(part.targets[0]) == name
    )
    assert isinstance(mapping, ast.Dict)
    return {ast.literal_eval(key) for key in mapping.keys if key}


def test_names_and_versions_are_one() -> None:
    described = ElementTree.parse(PACKAGE / "package.xml").getroot()
    setup = (PACKAGE / "setup.py").read_text("utf-8")

    assert described.findtext("name") == PACKAGE.name == "roadtorch_ros"
    assert described.findtext("version") == __version__
    assert f'version="{__version__}"' in setup
    assert (PACKAGE / "resource" / PACKAGE.name).is_file()
    assert (PACKAGE / PACKAGE.name / "road.py").is_file()
    for line in (PACKAGE / "setup.cfg").read_text("utf-8").splitlines()[1::2]:
        assert line.endswith(f"lib/{PACKAGE.name}")


def test_what_the_launch_file_sets_are_parameters_of_the_node() -> None:
    launch = PACKAGE / "launch" / "road.launch.py"

    assert keys_of(launch, "PARAMETERS") <= NodeParameters.model_fields.keys()
    assert keys_of(launch, "TOPICS") == {"image", "camera_info"}


def test_nav2_reads_the_topics_of_the_node() -> None:
    topics = [NAV2_PARAMETERS[f"{name}_topic"] for name in ("segmentation", "labels", "pointcloud")]

    assert topics == [MASK_TOPIC, LABELS_TOPIC, POINTS_TOPIC]
    assert "config/nav2.yaml" in (PACKAGE / "setup.py").read_text("utf-8")
