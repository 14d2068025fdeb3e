"""Several nodes in one process, by one executor: robot and cut, or any others of the five.

Parameters and remapping go to a node by its name, as with a component container: ``-p compliant_robot:pace:=1.0``,
``-r cutting_process:wrench:=force``, sections of a parameter file; without a name they go to all of them.
"""

from __future__ import annotations

import argparse
import importlib
import sys

from rclpy.utilities import remove_ros_args

from kr270_milling.ros.spin import run_nodes

__all__ = ["CLASSES", "main"]

#: node -> class in the module of the same name
CLASSES = {
    "compliant_robot": "CompliantRobot",
    "cutting_process": "CuttingProcess",
    "trajectory_compensator": "TrajectoryCompensator",
    "recorder": "Recorder",
}


def node_class(name: str) -> type:
    """The class of a node; imported only when it is wanted."""
    return getattr(importlib.import_module(f"kr270_milling.nodes.{name}"), CLASSES[name])


def main(args: list[str] | None = None) -> int:
    """Console script ``milling_cell``."""
    words = sys.argv if args is None else ["milling_cell", *args]
    parser = argparse.ArgumentParser(prog="milling_cell", description="Run several nodes in one process.")
    parser.add_argument(
        "nodes", metavar="NODE", nargs="*", default=["compliant_robot", "cutting_process"], help=", ".join(CLASSES)
    )
    names = parser.parse_args(remove_ros_args(words)[1:]).nodes
    unknown = [name for name in names if name not in CLASSES]
    if unknown or len(set(names)) < len(names):
        parser.error(f"{unknown[0]!r} is none of {', '.join(CLASSES)}" if unknown else "each node may be named once")
    return run_nodes([node_class(name) for name in names], args)


if __name__ == "__main__":
    raise SystemExit(main())
