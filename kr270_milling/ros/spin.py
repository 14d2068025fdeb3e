"""Run one node as a process: clean exit 0 on SIGINT and SIGTERM, one sentence and another code on failure."""

from __future__ import annotations

import os
import signal
import sys

import rclpy
from rclpy.context import Context
from rclpy.exceptions import ParameterException
from rclpy.executors import SingleThreadedExecutor
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.signals import SignalHandlerOptions

from kr270_milling.base.errors import MillingError
from kr270_milling.ros.environment import PARENT, keep_to_this_host

__all__ = ["run_node"]

LEAVE = 3  # [s] of the wall to leave the graph


def run_node(make, args: list[str] | None = None, drained: bool = False) -> int:
    """Spin ``make(context=...)`` until a signal, until its parent is gone, or until it sets ``failure`` or ``done``.

    Exit code: 0 after a signal or when done, 1 when the node failed, 2 when it could not be made (bad parameters).
    drained: the node takes its messages itself, by ``drain``, which EventsExecutor would do in its place.
    rclpy's own signal handlers now and then end with 1, and EventsExecutor.spin() does not return on a signal.
    """
    stop: list[int] = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda caught, _: stop.append(caught))
    keep_to_this_host()
    context = Context()
    program = os.path.basename(sys.argv[0])
    try:
        rclpy.init(args=args, context=context, signal_handler_options=SignalHandlerOptions.NO)
    except Exception as error:  # noqa: BLE001 - rclpy raises several of its own for arguments that it refuses
        print(f"{program}: {' '.join(str(error).split())}", file=sys.stderr)
        return 2
    try:
        try:
            node = make(context=context)
        except (MillingError, ParameterException) as error:
            print(f"{program}: {' '.join(str(error).split())}", file=sys.stderr)
            return 2
        return _spin(node, (SingleThreadedExecutor if drained else EventsExecutor)(context=context), stop)
    finally:
        context.try_shutdown()


def _spin(node, executor, stop: list[int]) -> int:
    executor.add_node(node)
    parent = int(os.environ.get(PARENT, 0))
    while not stop and node.failure is None and not getattr(node, "done", False):
        executor.spin_once(timeout_sec=0.1)
        if parent and os.getppid() != parent:
            break
    for _ in range(20):  # what has arrived before the signal is still taken
        if getattr(node, "settled", lambda: True)():
            break
        executor.spin_once(timeout_sec=0.05)
    closed = getattr(node, "close", lambda: None)()
    failure = node.failure or closed
    if failure:
        print(f"{node.get_name()}: {failure}", file=sys.stderr)
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGALRM):
        signal.signal(number, signal.SIG_DFL)
    signal.alarm(LEAVE)  # Fast DDS may block for ever now, and Python with it (eProsima/Fast-DDS#6502)
    executor.shutdown()
    node.destroy_node()
    signal.alarm(0)
    return 1 if failure else 0
