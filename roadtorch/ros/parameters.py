"""Parameters of the node, and those of each of its cameras."""

import math
from array import array
from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import Field

from roadtorch.base.errors import ConfigError
from roadtorch.base.settings import Settings, build_settings
from roadtorch.ros.messages import import_ros

CAMERA_PARAMETERS = ("camera", "height", "pitch", "roll", "fov", "base_frame")
"""Parameters that cameras may have of their own, such as ``front.height``."""

PARAMETER_EXAMPLES = """-p height:=1.2 -p smoothing:=false -p cameras:="['front','rear']\""""

TopicName = Annotated[str, Field(pattern=r"^[A-Za-z]\w*(/[A-Za-z]\w*)*$")]


class NodeParameters(Settings):
    """Parameters of the node; 0, NaN and "" stand for unset, as ROS has no null."""

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
    height: float = Field(
        default=0.0, ge=0, description="height of the camera above the ground, metres; 0: no grid"
    )
    pitch: float = Field(
        default=math.nan,
        allow_inf_nan=True,
        description="pitch of the camera, degrees; NaN: from the images",
    )
    roll: float = Field(default=0.0, description="roll of the camera, degrees")
    fov: float = Field(
        default=0.0,
        ge=0,
        description="horizontal field of view, degrees; 0: lens of the camera file or camera_info",
    )
    resolution: float = Field(default=0.1, description="metres per cell of the grid")
    range: float = Field(default=30.0, description="extent of the grid ahead, metres")
    side: float = Field(default=15.0, description="extent of the grid to either side, metres")
    base_frame: str = Field(default="base_link", description="frame of the grid")


def declare_parameters(node: Any) -> Mapping[str, NodeParameters]:
    """Declare all parameters, and return their values by camera, "" without names of cameras."""
    values: dict[str, Any] = {}
    # Any type, as ROS takes 1 for an integer: the settings check it. They are read once.
    descriptor = import_ros("rcl_interfaces.msg").ParameterDescriptor
    options = {"dynamic_typing": True, "read_only": True}
    for name, field in NodeParameters.model_fields.items():
        is_list = isinstance(field.default, tuple)  # rclpy cannot tell the type of an empty list
        default = [""] if is_list else field.default
        value = node.declare_parameter(name, default, descriptor(**options)).value
        values[name] = [*filter(None, value)] if isinstance(value, list | array) else value
    parameters = _build_parameters(values)
    by_camera = {"": parameters}
    for camera in dict.fromkeys(parameters.cameras):
        by_camera.pop("", None)
        for name in CAMERA_PARAMETERS:
            default = getattr(parameters, name)
            key = f"{camera}.{name}"
            values[name] = node.declare_parameter(key, default, descriptor(**options)).value
        by_camera[camera] = _build_parameters(values)
    return by_camera


def _build_parameters(values: Mapping[str, Any]) -> NodeParameters:
    """Build the parameters; ConfigError with an example for a wrong value."""
    try:
        return build_settings(NodeParameters, values)
    except ConfigError as error:
        hint = f"{error.hint}; examples: {PARAMETER_EXAMPLES}"
        raise ConfigError(error.where, error.problem, hint) from None
