"""Run nodes as a process: clean exit 0 on SIGINT and SIGTERM, one sentence and another code on failure."""

from __future__ import annotations

import contextlib
import os
import signal
import sys
from collections.abc import Callable, Sequence

import rclpy
from rclpy.context import Context
from rclpy.exceptions import ParameterException
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future
from rclpy.utilities import remove_ros_args

from kr270_milling.base.errors import MillingError
from kr270_milling.base.process import end_process
from kr270_milling.ros.environment import PARENT, keep_to_this_host
from kr270_milling.ros.leaving import leaving
from kr270_milling.ros.litter import remove_litter

__all__ = ["own_arguments", "run_node", "run_nodes"]

LEAVE = 3.0  # [s] of the wall to leave the graph
LAP = 0.1  # [s] between two looks for signals and for the parent
STOPS = (signal.SIGINT, signal.SIGTERM)


def own_arguments() -> list[str]:
    """The words of this process's command line that are not for ROS.

    Raises SystemExit with code 2, behind a sentence, where ROS refuses those that are for it.
    """
    try:
        return remove_ros_args(sys.argv)[1:]
    except Exception as error:  # noqa: BLE001 - as below
        _tell(error)
        raise SystemExit(2) from None


def _tell(error: Exception) -> None:
    """One line on standard error."""
    print(f"{os.path.basename(sys.argv[0])}: {' '.join(str(error).split())}", file=sys.stderr)


def run_node(make: Callable, args: list[str] | None = None) -> int:
    """Spin one node, ``make(context=...)``; see ``run_nodes``."""
    return run_nodes([make], args)


def run_nodes(makes: Sequence[Callable], args: list[str] | None = None) -> int:
    """Spin nodes by one executor until a signal, until the parent is gone, or until one is done.

    Exit code: 0 after a signal or when done, 1 when a node failed, 2 when one could not be made (bad parameters).
    Without ``args`` the process is that of the nodes and ends here; else the exit code is returned.
    rclpy's own signal handlers now and then end with 1, and EventsExecutor.spin() does not return on a signal.
    """
    stop: list[int] = []
    before = {number: signal.signal(number, lambda caught, _: stop.append(caught)) for number in STOPS}
    if args is None:
        give_way()
    code = _run_nodes(makes, args, stop)
    if args is None:
        end_process(code)
    for number, handler in before.items():
        signal.signal(number, handler)
    return code


def give_way() -> None:
    """SCHED_BATCH, where the kernel has it: whoever is woken does not interrupt the one that woke it.

    An exchange wakes every listener of its messages, and on two cores each of them would take the place of the robot
    or the cut, whose work is what all wait for.
    """
    with contextlib.suppress(OSError, AttributeError):
        os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))


def _run_nodes(makes: Sequence[Callable], args: list[str] | None, stop: list[int]) -> int:
    keep_to_this_host()
    if PARENT not in os.environ:
        remove_litter()  # a runner did it
    context = Context()
    try:
        rclpy.init(args=args, context=context, signal_handler_options=SignalHandlerOptions.NO)
    except Exception as error:  # noqa: BLE001 - rclpy raises several of its own for arguments that it refuses
        _tell(error)
        return 2
    nodes: list = []
    try:
        for make in makes:
            nodes.append(make(context=context))
    except (MillingError, ParameterException) as error:
        _tell(error)
        with leaving(2, LEAVE):
            context.try_shutdown()
        return 2
    executor = EventsExecutor(context=context)
    for node in nodes:
        executor.add_node(node)
    code = _spin(nodes, executor, stop)
    with leaving(code, LEAVE):
        executor.shutdown()
        for node in nodes:
            node.destroy_node()
        context.try_shutdown()
    return code


def _spin(nodes: list, executor, stop: list[int]) -> int:
    """The exit code, when all that the nodes have to write is written."""
    parent = int(os.environ.get(PARENT, 0))
    while not stop and not any(node.done for node in nodes):
        lap = Future()  # one lap is many callbacks: to come back behind each took a tenth of an exchange
        for node in nodes:
            node.lap = lap
        executor.spin_until_future_complete(lap, timeout_sec=LAP)
        if parent and os.getppid() != parent:
            break
    for _ in range(20):  # what has arrived before the signal is still taken
        settled = [getattr(node, "settled", lambda: True)() for node in nodes]  # each of them has a look
        if all(settled):
            break
        executor.spin_once(timeout_sec=0.05)
    code = 0
    for node in nodes:
        closed = getattr(node, "close", lambda: None)()
        if failure := node.failure or closed:
            print(f"{node.get_name()}: {failure}", file=sys.stderr)
            code = 1
    return code
