"""roadtorch ros: a node of ROS 2."""

import click


@click.command(context_settings={"ignore_unknown_options": True})
@click.argument("words", metavar="[--ros-args …]", nargs=-1, type=click.UNPROCESSED)
def ros(words: tuple[str, ...]) -> None:
    """Run a node of ROS 2 that finds the road in the newest image.

    \b
    in   image (sensor_msgs/Image), image/compressed, camera_info
    out  /segmentation/mask, /segmentation/confidence   mono8, with the image's stamp and frame
         /segmentation/label_info                       latched names of the mask's numbers
         /segmentation/overlay                          while somebody listens
         /segmentation/grid                             where height and lens are known
         /diagnostics                                   trust, doubt, rate, age, dropped
    Parameters and names are given as to every node:
      roadtorch ros --ros-args -p detector:=fusion -p height:=1.2 -r image:=/front/image_raw
    """
    from roadtorch.base.errors import ConfigError
    from roadtorch.base.signals import stop_on_signals
    from roadtorch.ros.messages import ros_module
    from roadtorch.ros.node import spin
    from roadtorch.run.workers import settle

    others = ros_module("rclpy.utilities").remove_ros_args(["roadtorch", *words])[1:]
    if others:
        hint = "parameters are given as --ros-args -p NAME:=VALUE"
        raise ConfigError("ros", f"does not know {' '.join(others)}", hint)
    settle(threads=1)
    with stop_on_signals() as stop:
        spin(words, stop)
        stop.interrupt()
