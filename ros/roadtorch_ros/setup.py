"""The ament package: an executable that starts roadtorch's own command."""

from setuptools import setup

NAME = "roadtorch_ros"

setup(
    name=NAME,
    version="1.0.0",
    packages=[NAME],
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/launch", ["launch/road.launch.py"]),
        (f"share/{NAME}/config", ["config/nav2.yaml", "config/large_messages.xml"]),
    ],
    install_requires=["setuptools"],
    zip_safe=True,
    description="roadtorch as a node of ROS 2",
    license="Apache-2.0",
    entry_points={"console_scripts": [f"road = {NAME}.road:main"]},
)
