"""Parameters of the node, and those of each of its cameras."""

from array import array
from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import Field

from roadtorch.base.errors import ConfigError
from roadtorch.base.settings import Settings, build_settings, merge
from roadtorch.camera.ground_grid import GridSettings
from roadtorch.ros.messages import import_ros

PARAMETER_EXAMPLES = """-p grid.height:=1.2 -p smoothing:=false -p cameras:="['front','rear']\""""

TopicName = Annotated[str, Field(pattern=r"(?i)^([a-z](_?[a-z0-9])*_?/)*[a-z](_?[a-z0-9])*_?$")]


class NodeParameters(Settings):
    """Parameters of the node, and of its cameras, which may have ``camera`` and ``grid`` alone."""

    detector: str = Field(default="fusion", description="name of the detector")
    settings: tuple[str, ...] = Field(
        default=(), strict=False, description="settings of the detector, KEY=VALUE"
    )
    runtime: str = Field(
        default="torch", description="library for the network: torch or onnxruntime"
    )
    cameras: tuple[TopicName, ...] = Field(
        default=(), strict=False, description="names of several cameras, prefixes of their topics"
    )
    camera: str = Field(default="", description="camera file written by roadtorch camera")
    smoothing: bool = Field(default=True, description="temporal smoothing of the likelihood")
    grid: GridSettings = Field(
        default=GridSettings(),
        description="the camera over the ground, and its grid; no grid without a height",
    )


def declare_parameters(node: Any) -> Mapping[str, NodeParameters]:
    """Declare all parameters, and return their values by camera, "" without names of cameras."""
    # Any type, as ROS takes 1 for an integer: the settings check it. They are read once.
    descriptor = import_ros("rcl_interfaces.msg").ParameterDescriptor
    options = {"dynamic_typing": True, "read_only": True}

    def declare(name: str, default: Any) -> Any:
        is_list = isinstance(default, tuple)  # rclpy cannot tell the type of an empty list
        value = node.declare_parameter(name, [""] if is_list else default, descriptor(**options))
        value = value.value
        return [*filter(None, value)] if isinstance(value, list | array) else value

    def declare_grid(prefix: str) -> dict[str, object]:
        """Declare the settings of the grid without defaults; return those that are set."""
        names = GridSettings.model_fields
        values = {name: declare(f"{prefix}grid.{name}", None) for name in names}
        return {name: value for name, value in values.items() if value is not None}

    defaults = {name: field.default for name, field in NodeParameters.model_fields.items()}
    del defaults["grid"]
    values = {name: declare(name, default) for name, default in defaults.items()}
    values["grid"] = declare_grid("")
    parameters = _build_parameters(values)
    by_camera = {"": parameters}
    for camera in dict.fromkeys(parameters.cameras):
        by_camera.pop("", None)
        changes = {
            "camera": declare(f"{camera}.camera", parameters.camera),
            "grid": declare_grid(f"{camera}."),
        }
        by_camera[camera] = _build_parameters(merge(values, changes))
    return by_camera


def _build_parameters(values: Mapping[str, object]) -> NodeParameters:
    """Build the parameters; ConfigError with an example for a wrong value."""
    try:
        return build_settings(NodeParameters, values)
    except ConfigError as error:
        hint = f"{error.hint}; examples: {PARAMETER_EXAMPLES}"
        raise ConfigError(error.where, error.problem, hint) from None
