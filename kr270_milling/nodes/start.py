"""Start a node, or several in one process: they obey a signal from here on, also while their libraries are imported.

Several go by one executor. Parameters and remapping go to a node by its name, as with a component container:
``-p compliant_robot:pace:=1.0``, ``-r cutting_process:wrench:=force``, sections of a parameter file. Without a name
they go to all.
"""

from __future__ import annotations

import argparse
import importlib
import os
import signal
import sys
from pathlib import Path

__all__ = ["NODES", "start"]

#: node -> class in the module of the same name
CLASSES = {
    "compliant_robot": "CompliantRobot",
    "cutting_process": "CuttingProcess",
    "trajectory_compensator": "TrajectoryCompensator",
    "recorder": "Recorder",
}
NODES = (*CLASSES, "player", "milling_cell")


def start(name: str | None = None) -> int:
    """Run the program of this name (default: as it was called) as this process; returns or ends with its exit code."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, _end)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, (signal.SIGINT, signal.SIGTERM))  # a runner lets them wait until here
    name = name or Path(sys.argv[0]).stem
    if name == "player":
        from kr270_milling.nodes.player import main

        return main()
    from kr270_milling.ros.spin import run_nodes

    return run_nodes([_node_class(node) for node in (_several() if name == "milling_cell" else [name])])


def _end(number, frame) -> None:
    """Nothing is open yet, so there is nothing to close."""
    os._exit(0)


def _node_class(name: str) -> type:
    return getattr(importlib.import_module(f"kr270_milling.nodes.{name}"), CLASSES[name])


def _several() -> list[str]:
    """The nodes that the command line of ``milling_cell`` names."""
    from kr270_milling.ros.spin import own_arguments

    parser = argparse.ArgumentParser(prog="milling_cell", description="Run several nodes in one process.")
    parser.add_argument(
        "nodes", metavar="NODE", nargs="*", default=["compliant_robot", "cutting_process"], help=", ".join(CLASSES)
    )
    names = parser.parse_args(own_arguments()).nodes
    unknown = [name for name in names if name not in CLASSES]
    if unknown or len(set(names)) < len(names):
        parser.error(f"{unknown[0]!r} is none of {', '.join(CLASSES)}" if unknown else "each node may be named once")
    return names
