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
from kr270_milling.base.process import end_process
from kr270_milling.ros.environment import PARENT, keep_to_this_host
from kr270_milling.ros.leaving import leaving

__all__ = ["run_node"]

LEAVE = 3.0  # [s] of the wall to leave the graph
STOPS = (signal.SIGINT, signal.SIGTERM)


def run_node(make, args: list[str] | None = None, drained: bool = False) -> int:
    """Spin ``make(context=...)`` until a signal, until its parent is gone, or until it sets ``failure`` or ``done``.

    Exit code: 0 after a signal or when done, 1 when the node failed, 2 when it could not be made (bad parameters).
    Without ``args`` the process is the node's own and ends here; else the exit code is returned.
    drained: the node takes its messages itself, by ``drain``, which EventsExecutor would do in its place.
    rclpy's own signal handlers now and then end with 1, and EventsExecutor.spin() does not return on a signal.
    """
    stop: list[int] = []
    before = {number: signal.signal(number, lambda caught, _: stop.append(caught)) for number in STOPS}
    code = _run_node(make, args, drained, stop)
    if args is None:
        end_process(code)
    for number, handler in before.items():
        signal.signal(number, handler)
    return code


def _run_node(make, args: list[str] | None, drained: bool, stop: list[int]) -> int:
    keep_to_this_host()
    context = Context()
    program = os.path.basename(sys.argv[0])
    try:
        rclpy.init(args=args, context=context, signal_handler_options=SignalHandlerOptions.NO)
    except Exception as error:  # noqa: BLE001 - rclpy raises several of its own for arguments that it refuses
        print(f"{program}: {' '.join(str(error).split())}", file=sys.stderr)
        return 2
    try:
        node = make(context=context)
    except (MillingError, ParameterException) as error:
        print(f"{program}: {' '.join(str(error).split())}", file=sys.stderr)
        with leaving(2, LEAVE):
            context.try_shutdown()
        return 2
    executor = (SingleThreadedExecutor if drained else EventsExecutor)(context=context)
    executor.add_node(node)
    code = _spin(node, executor, stop)
    with leaving(code, LEAVE):
        executor.shutdown()
        node.destroy_node()
        context.try_shutdown()
    return code


def _spin(node, executor, stop: list[int]) -> int:
    """The exit code, when all that the node has to write is written."""
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
    return 1 if failure else 0
