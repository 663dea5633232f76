"""Parameters of the node, and those of each of its cameras."""

import math
from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import Field

from roadtorch.base.settings import Settings, build_settings

CAMERA_PARAMETERS = ("camera", "height", "pitch", "roll", "fov", "base_frame")
"""Parameters that cameras may have of their own, such as ``front.height``."""

TopicName = Annotated[str, Field(pattern=r"^[A-Za-z]\w*(/[A-Za-z]\w*)*$")]


class NodeParameters(Settings):
    """Parameters of the node; 0, NaN and "" stand for unset, as ROS has no null."""

    detector: str = Field(default="fusion", description="name of the detector")
    settings: tuple[str, ...] = Field(
        default=(), strict=False, description="settings of the detector, KEY=VALUE"
    )
    runtime: str = Field(
        default="torch", description="library for the network: torch, onnxruntime or openvino"
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
    for name, field in NodeParameters.model_fields.items():
        is_list = isinstance(field.default, tuple)  # rclpy cannot tell the type of an empty list
        value = node.declare_parameter(name, [""] if is_list else field.default).value
        values[name] = tuple(filter(None, value)) if is_list else value
    parameters = build_settings(NodeParameters, values)
    by_camera = {"": parameters}
    for camera in dict.fromkeys(parameters.cameras):
        by_camera.pop("", None)
        for name in CAMERA_PARAMETERS:
            default = getattr(parameters, name)
            values[name] = node.declare_parameter(f"{camera}.{name}", default).value
        by_camera[camera] = build_settings(NodeParameters, values)
    return by_camera
