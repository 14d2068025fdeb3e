"""Launch file: the four nodes of a cell make one pass, record it and revise the reference.

ros2 launch kr270_milling milling.launch.py cell:=CELL.yaml out:=DIRECTORY
"""

from pathlib import Path

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

PAPER = str(Path(__file__).resolve().parent / "paper.yaml")


def node(name: str, **parameters) -> Node:
    return Node(package="kr270_milling", executable=name, name=name, output="screen", parameters=[parameters])


def generate_launch_description() -> LaunchDescription:
    cell, out = LaunchConfiguration("cell"), LaunchConfiguration("out")
    return LaunchDescription(
        [
            DeclareLaunchArgument("cell", default_value=PAPER, description="file of the cell"),
            DeclareLaunchArgument("out", default_value="one_pass", description="directory of the recording"),
            node("recorder", directory=out, attach=cell),
            node("trajectory_compensator", cell_file=cell),
            node("cutting_process", cell_file=cell, autostart=True),
            node("compliant_robot", cell_file=cell, autostart=True),
        ]
    )
