"""``ros2 run roadtorch_ros road``: what ``roadtorch ros`` runs."""

import sys

from roadtorch.cli import main as roadtorch


def main() -> None:
    """Run the node with this process's arguments."""
    roadtorch(["ros", *sys.argv[1:]])
