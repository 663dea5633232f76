"""Launch the node on a camera.

ros2 launch roadtorch_ros road.launch.py image:=/front/image_raw height:=1.2
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

TOPICS = {"image": "/camera/image_raw", "camera_info": "/camera/camera_info"}
PARAMETERS = {
    "detector": ("fusion", str),
    "height": ("0.0", float),
    "base_frame": ("base_link", str),
}


def generate_launch_description() -> LaunchDescription:
    """Return the node with its topics and the parameters that most robots set."""
    defaults = {**TOPICS, **{name: default for name, (default, _) in PARAMETERS.items()}}
    image = LaunchConfiguration("image")
    remapped = [(name, LaunchConfiguration(name)) for name in TOPICS]
    remapped.append(("image/compressed", [image, "/compressed"]))
    values = {
        name: ParameterValue(LaunchConfiguration(name), value_type=kind)
        for name, (_, kind) in PARAMETERS.items()
    }
    return LaunchDescription(
        [
            *(DeclareLaunchArgument(name, default_value=text) for name, text in defaults.items()),
            Node(
                package="roadtorch_ros",
                executable="road",
                name="roadtorch",
                parameters=[values],
                remappings=remapped,
            ),
        ]
    )
