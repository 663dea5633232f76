"""The bags that ``infer`` and ``grid`` write of footage: their names and time stamps."""

from pathlib import Path

from roadtorch.sources.bags import is_bag
from roadtorch.sources.frame import Frame, Source


def is_from_bag(source: Source) -> bool:
    """Whether the frames of a source are those of a bag."""
    return source.moving and not source.live and is_bag(source.origin)


def bag_ending(source: Source, end: str) -> str:
    """How the name of the bag ends: of ROS 1 where the source is such a bag, else of ROS 2."""
    return f"{end}.bag" if is_from_bag(source) and _is_ros1(Path(source.origin)) else end


def _is_ros1(path: Path) -> bool:
    return path.suffix == ".bag" and path.is_file()


def stamp_of(frame: Frame) -> int:
    """Nanoseconds: the source's own, else since it began, one second a frame without a clock."""
    if frame.stamp is not None:
        return frame.stamp
    return round(1e9 * (frame.number if frame.seconds is None else frame.seconds))
