"""Launch the node on a camera, or on several.

ros2 launch roadtorch_ros road.launch.py image:=/front/image_raw grid.height:=1.2
ros2 launch roadtorch_ros road.launch.py cameras:=front,rear params_file:=cameras.yaml

Cameras started in the same launch, after this file, use its profile for large messages too.
"""

from pathlib import Path

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction, SetEnvironmentVariable
from launch.substitutions import EnvironmentVariable, LaunchConfiguration
from launch_ros.actions import Node

TOPICS = {"image": "/camera/image_raw", "camera_info": "/camera/camera_info"}
PARAMETERS = {
    "detector": ("fusion", str),
    "grid.height": ("", float),
    "grid.frame": ("", str),
}
FILES = {"cameras": "", "params_file": ""}
PROFILE = Path(__file__).resolve().parents[1] / "config" / "large_messages.xml"
PROFILE_VARIABLES = ("FASTDDS_DEFAULT_PROFILES_FILE", "FASTRTPS_DEFAULT_PROFILES_FILE")


def remap(cameras: list[str], topics: dict[str, str]) -> list[tuple[str, str]]:
    """Return the topics of the node and of the cameras, ``/front/image_raw`` of a ``front``."""
    pairs = [(name, topics[name]) for name in TOPICS]
    for camera in cameras:
        pairs += [(f"{camera}/{name}", f"/{camera}/{Path(TOPICS[name]).name}") for name in TOPICS]
    images = [(name, topic) for name, topic in pairs if name.endswith("image")]
    return pairs + [(f"{name}/compressed", f"{topic}/compressed") for name, topic in images]


def describe_node(context: LaunchContext) -> list[Node]:
    """Return the node with its topics and the parameters that most robots set."""
    names = (*TOPICS, *PARAMETERS, *FILES)
    texts = {name: LaunchConfiguration(name).perform(context) for name in names}
    cameras = [name for name in texts["cameras"].split(",") if name]
    values = {name: kind(texts[name]) for name, (_, kind) in PARAMETERS.items() if texts[name]}
    several = [{"cameras": cameras}] if cameras else []
    files = [texts["params_file"]] if texts["params_file"] else []
    return [
        Node(
            package="roadtorch_ros",
            executable="road",
            name="roadtorch",
            parameters=[values, *several, *files],
            remappings=remap(cameras, texts),
        )
    ]


def generate_launch_description() -> LaunchDescription:
    """Return arguments, the middleware's profile unless the user has another, and the node."""
    defaults = {**TOPICS, **{name: text for name, (text, _) in PARAMETERS.items()}, **FILES}
    return LaunchDescription(
        [
            *(DeclareLaunchArgument(name, default_value=text) for name, text in defaults.items()),
            *(
                SetEnvironmentVariable(name, EnvironmentVariable(name, default_value=str(PROFILE)))
                for name in PROFILE_VARIABLES
            ),
            OpaqueFunction(function=describe_node),
        ]
    )
