"""``python -m kr270_milling.live.nodes NAME``: start a node, or several in one process; so do the console scripts.

Signals end the process from here on, also during the imports.

Several nodes share one executor. Parameters and remapping with a node name concern this node, as in a component
container: ``-p compliant_robot:pace:=1.0``, ``-r cutting_process:wrench:=force``, sections of a parameter file.
Without a name they concern all nodes.
"""

from __future__ import annotations

import argparse
import importlib
import os
import signal
import sys
from pathlib import Path

from kr270_milling.base.arguments import STOPS
from kr270_milling.base.errors import MillingError
from kr270_milling.live.ros.environment import keep_to_this_host, require_ros

#: node -> class in the module of the same name
CLASSES = {
    "compliant_robot": "CompliantRobot",
    "cutting_process": "CuttingProcess",
    "trajectory_compensator": "TrajectoryCompensator",
    "recorder": "Recorder",
}
NODES = (*CLASSES, "player", "milling_cell")


def start(name: str | None = None) -> int:
    """Run the program ``name`` (default: as called) as this process; return its exit code, or end with it."""
    name = name or Path(sys.argv[0]).stem
    try:
        require_ros(name)
        keep_to_this_host()  # before the imports, which take seconds on a busy machine
    except MillingError as error:
        print(error, file=sys.stderr)
        return 2
    for number in STOPS:
        signal.signal(number, lambda *_: os._exit(0))  # no file is open yet
    signal.pthread_sigmask(signal.SIG_UNBLOCK, STOPS)  # blocked by ``run`` until here
    if name == "player":
        from kr270_milling.live.nodes.player import player_main

        return player_main()
    from kr270_milling.live.ros.spin import run_nodes

    if name == "milling_cell":
        return run_nodes([_node_class(node) for node in _chosen_nodes()])
    if {"-h", "--help"} & set(sys.argv[1:]):
        parser = argparse.ArgumentParser(
            prog=name,
            usage=f"{name} --ros-args -p cell_file:=CELL.yaml [-p NAME:=VALUE] [-r NAME:=NAME]",
            description=(_node_class(name).__doc__ or "").split("\n\n")[0],
            epilog="ros2 param describe lists the parameters of a running node. The cell is read once.",
        )
        parser.print_help()
        return 0
    return run_nodes([_node_class(name)])


def _node_class(name: str) -> type:
    return getattr(importlib.import_module(f"kr270_milling.live.nodes.{name}"), CLASSES[name])


def _chosen_nodes() -> list[str]:
    """Return the nodes on the command line of ``milling_cell``."""
    from kr270_milling.live.ros.spin import own_arguments

    parser = argparse.ArgumentParser(prog="milling_cell", description="Run several nodes in one process.")
    parser.add_argument(
        "nodes", metavar="NODE", nargs="*", default=["compliant_robot", "cutting_process"], help=", ".join(CLASSES)
    )
    names = parser.parse_args(own_arguments()).nodes
    unknown = [name for name in names if name not in CLASSES]
    if unknown or len(set(names)) < len(names):
        parser.error(f"{unknown[0]!r} is not one of {', '.join(CLASSES)}" if unknown else "each node may be named once")
    return names


if __name__ == "__main__":
    if len(sys.argv) < 2 or sys.argv[1] not in NODES:
        sys.exit(f"python -m kr270_milling.live.nodes NAME, one of {', '.join(NODES)}")
    del sys.argv[0]
    raise SystemExit(start(sys.argv[0]))
