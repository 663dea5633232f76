"""The ament package: names, versions and parameters agree with those of the node."""

import runpy
import sys
from functools import partial
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any, cast
from xml.etree import ElementTree

import pytest

from roadtorch.base.version import __version__
from roadtorch.ros.parameters import NodeParameters
from roadtorch.run.writers.bag import LABELS_TOPIC, MASK_TOPIC, POINTS_TOPIC
from tests.reference.semantic_layer import NAV2_PARAMETERS

PACKAGE = Path(__file__).resolve().parents[2] / "ros" / "roadtorch_ros"


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


class Recorded:
    """A stand-in for every class of launch and launch_ros: its kind and arguments."""

    def __init__(self, kind: str, /, *values: Any, **options: Any) -> None:
        self.kind, self.values, self.options = kind, values, options

    def perform(self, context: dict[str, str]) -> str:
        return context[self.values[0]]


@pytest.fixture
def launch(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """Return the names of the launch file, executed without ROS."""
    classes = {
        "launch": ("LaunchContext", "LaunchDescription"),
        "launch.actions": ("DeclareLaunchArgument", "OpaqueFunction", "SetEnvironmentVariable"),
        "launch.substitutions": ("EnvironmentVariable", "LaunchConfiguration"),
        "launch_ros": (),
        "launch_ros.actions": ("Node",),
    }
    for module, names in classes.items():
        stand_ins = {name: partial(Recorded, name) for name in names}
        monkeypatch.setitem(sys.modules, module, cast("ModuleType", SimpleNamespace(**stand_ins)))
    return runpy.run_path(str(PACKAGE / "launch" / "road.launch.py"))


@pytest.mark.parametrize(
    ("words", "parameters", "remappings"),
    [
        (
            {"image": "/usb", "grid.height": "1"},
            {"grid.height": 1.0},
            {"image/compressed": "/usb/compressed"},
        ),
        ({"cameras": "a,b"}, {"cameras": ["a", "b"]}, {"b/image": "/b/image_raw"}),
    ],
)
def test_the_launch_file_starts_the_node_on_its_cameras(
    launch: dict[str, Any], words: Any, parameters: dict[str, Any], remappings: dict[str, str]
) -> None:
    arguments, actions = {}, launch["generate_launch_description"]().values[0]
    for action in actions:
        if action.kind == "DeclareLaunchArgument":
            arguments[action.values[0]] = action.options["default_value"]
    assert words.keys() <= arguments.keys()

    (node,) = actions[-1].options["function"](arguments | words | {"params_file": "cameras.yaml"})

    *settings, file = node.options["parameters"]
    values = {name: value for group in settings for name, value in group.items()}
    assert (file, values) == ("cameras.yaml", values | parameters)
    assert {name.split(".")[0] for name in values} <= NodeParameters.model_fields.keys()
    assert remappings.items() <= dict(node.options["remappings"]).items()


def test_the_launch_file_lets_large_messages_through_unless_told_otherwise(
    launch: dict[str, Any],
) -> None:
    actions = launch["generate_launch_description"]().values[0]
    variables = [action for action in actions if action.kind == "SetEnvironmentVariable"]
    profile = ElementTree.parse(launch["PROFILE"]).getroot()
    (size,) = (int(part.text or 0) for part in profile.iter() if part.tag.endswith("segment_size"))

    assert "FASTDDS_DEFAULT_PROFILES_FILE" in {action.values[0] for action in variables}
    assert {action.values[1].options["default_value"] for action in variables} == {
        str(PACKAGE / "config" / "large_messages.xml")
    }
    assert variables[-1] is not actions[-1]  # set before the node starts
    assert size > 4 * 1920 * 1080 * 3
    assert "config/large_messages.xml" in (PACKAGE / "setup.py").read_text("utf-8")


def test_nav2_reads_the_topics_of_the_node() -> None:
    topics = [NAV2_PARAMETERS[f"{name}_topic"] for name in ("segmentation", "labels", "pointcloud")]

    assert topics == [MASK_TOPIC, LABELS_TOPIC, POINTS_TOPIC]
    assert "config/nav2.yaml" in (PACKAGE / "setup.py").read_text("utf-8")
