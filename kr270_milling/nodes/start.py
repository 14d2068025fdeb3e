"""Start a node: it obeys a signal from here on, also during the seconds in which its libraries are imported."""

from __future__ import annotations

import importlib
import os
import signal

__all__ = [
    "NODES", "compliant_robot", "cutting_process", "milling_cell", "player", "recorder", "start",
    "trajectory_compensator",
]  # fmt: skip

NODES = ("compliant_robot", "cutting_process", "trajectory_compensator", "recorder", "player", "milling_cell")


def start(name: str) -> int:
    """Import the node of this name and run it as this process; returns or ends with its exit code."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, _end)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, (signal.SIGINT, signal.SIGTERM))  # a runner lets them wait until here
    return importlib.import_module(f"kr270_milling.nodes.{name}").main()


def _end(number, frame) -> None:
    """Nothing is open yet, so there is nothing to close."""
    os._exit(0)


def compliant_robot() -> int:
    return start("compliant_robot")


def cutting_process() -> int:
    return start("cutting_process")


def trajectory_compensator() -> int:
    return start("trajectory_compensator")


def recorder() -> int:
    return start("recorder")


def player() -> int:
    return start("player")


def milling_cell() -> int:
    return start("milling_cell")
