"""The ament package: what colcon and launch read of it agrees with itself and with the node."""

import ast
from pathlib import Path
from xml.etree import ElementTree

from roadtorch.base.version import __version__
from roadtorch.ros.node import NodeParameters

PACKAGE = Path(__file__).resolve().parents[2] / "ros" / "roadtorch_ros"


def constant(file: Path, name: str) -> dict[str, object]:
    """What a module assigns to a name, its keys alone being read."""
    for part in ast.parse(file.read_text("utf-8")).body:
        if isinstance(part, ast.Assign) and ast.unparse(part.targets[0]) == name:
            assert isinstance(part.value, ast.Dict)
            return {
                ast.literal_eval(key): value
                for key, value in zip(part.value.keys, part.value.values, strict=True)
                if key
            }
    raise AssertionError(f"{file.name} assigns no {name}")


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

    assert constant(launch, "PARAMETERS").keys() <= NodeParameters.model_fields.keys()
    assert constant(launch, "TOPICS").keys() == {"image", "camera_info"}
