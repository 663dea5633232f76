"""roadtorch ros: run a ROS 2 node."""

import click


@click.command(context_settings={"ignore_unknown_options": True})
@click.argument("words", metavar="[--ros-args …]", nargs=-1, type=click.UNPROCESSED)
def ros_command(words: tuple[str, ...]) -> None:
    """Run a ROS 2 node that finds the road in the images of one or several cameras.

    \b
    in   image (sensor_msgs/Image), image/compressed, camera_info
    out  segmentation/mask, segmentation/confidence     mono8, with the image's stamp and frame
         segmentation/label_info                        latched: names of the mask's values
         segmentation/overlay                           only with a subscriber
         segmentation/grid, segmentation/points         only with camera height and lens
         /diagnostics                                   trust, doubt, rate, age, dropped
    With -p cameras:="['front','rear']" the topics are front/image, front/segmentation/mask, ….
    Give parameters and topic names as for any node:
      roadtorch ros --ros-args -p detector:=fusion -p grid.height:=1.2 -r image:=/front/image_raw
    """
    from roadtorch.base.bounded import reason
    from roadtorch.base.errors import ConfigError
    from roadtorch.base.signals import stop_on_signals
    from roadtorch.ros.messages import import_ros
    from roadtorch.ros.node import spin
    from roadtorch.run.workers import configure_threads

    hint = "give parameters as --ros-args -p NAME:=VALUE, topics as -r NAME:=NAME"
    try:
        unknown = import_ros("rclpy.utilities").remove_ros_args(["roadtorch", *words])[1:]
    except RuntimeError as error:  # RCLError of words that rcl cannot parse
        raise ConfigError("--ros-args", reason(error).partition(". Error:")[0], hint) from None
    if unknown:
        raise ConfigError("ros", f"does not know {' '.join(unknown)}", hint)
    configure_threads()
    with stop_on_signals() as stop:
        spin(words, stop)
        stop.raise_if_requested()
