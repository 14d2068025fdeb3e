"""Run nodes as a process: exit code 0 on SIGINT, SIGTERM and SIGHUP, one sentence and another exit code on failure."""

from __future__ import annotations

import gc
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

from kr270_milling.base.arguments import STOPS, end_process, flush
from kr270_milling.base.errors import MillingError, nearest
from kr270_milling.live.ros.environment import PARENT, keep_to_this_host


def own_arguments() -> list[str]:
    """Return the words of this process's command line that are not for ROS.

    Raises SystemExit with code 2, after a sentence on standard error, where ROS refuses the words that are for ROS.
    """
    try:
        return remove_ros_args(sys.argv)[1:]
    except Exception as error:  # noqa: BLE001 - rclpy raises several exception types for arguments that it refuses
        _print_error(error)
        raise SystemExit(2) from None


def _print_error(error: Exception) -> None:
    """Print one line on standard error."""
    print(f"{os.path.basename(sys.argv[0])}: {' '.join(str(error).split())}", file=sys.stderr)


def run_node(make: Callable, args: list[str] | None = None) -> int:
    """Spin one node, ``make(context=...)``; see ``run_nodes``."""
    return run_nodes([make], args)


def run_nodes(makes: Sequence[Callable], args: list[str] | None = None) -> int:
    """Spin nodes, ``make(context=...)`` each, until a signal arrives, the parent process ends, or a node has finished.

    Exit code: 0 after a signal or at the end, 1 when a node failed, 2 when a node could not be made (bad parameters).
    Without ``args`` the process belongs to the nodes and ends here; otherwise the exit code is returned.
    The handlers replace those of rclpy, which sometimes end with exit code 1; EventsExecutor.spin() does not return on
    a signal.
    """
    signals: list[int] = []
    before = {number: signal.signal(number, lambda caught, _: signals.append(caught)) for number in STOPS}
    code = _run_nodes(makes, args, signals)
    if args is None:
        end_process(code)
    for number, handler in before.items():
        signal.signal(number, handler)
    return code


def _run_nodes(makes: Sequence[Callable], args: list[str] | None, signals: list[int]) -> int:
    context = Context()
    try:
        keep_to_this_host()
        rclpy.init(args=args, context=context, signal_handler_options=SignalHandlerOptions.NO)
    except Exception as error:  # noqa: BLE001 - rclpy raises several exception types for arguments that it refuses
        _print_error(error)
        return 2
    nodes: list = []
    try:
        for make in makes:
            nodes.append(make(context=context))
    except (MillingError, ParameterException) as error:
        _print_error(error)
        return 2
    known = {name for node in nodes for name in node.get_parameters_by_prefix("")}
    # rclpy has no public list of the values that were given; without this one there is no warning
    unknown = sorted({name for node in nodes for name in getattr(node, "_parameter_overrides", ())} - known)
    if unknown:  # ROS ignores these
        more = nearest(unknown[0], known) if len(unknown) == 1 else ""
        nodes[0].get_logger().warning(f"unknown parameters are ignored: {', '.join(unknown)[:300]}{more}")
    if args is None:
        gc.freeze()  # a full collection of the imported modules stops a recorder for 0.1 s
    executor = EventsExecutor(context=context)
    for node in nodes:
        executor.add_node(node)
    code = _spin(nodes, executor, signals)
    _leave_graph(nodes, executor, context)
    return code


def _leave_graph(nodes: list, executor, context: Context) -> None:
    """Destroy the nodes, so that their partners notice at once. All files are closed and all messages are printed.

    Fast DDS sometimes blocks here (eProsima/Fast-DDS#6502) and keeps Python's lock. Then a signal ends the process, or
    the ``run`` that started it.
    """
    flush()
    for number in STOPS:
        signal.signal(number, signal.SIG_DFL)
    executor.shutdown()
    for node in nodes:
        node.destroy_node()
    context.try_shutdown()


def _spin(nodes: list, executor, signals: list[int]) -> int:
    """Spin until the end, close the files, and return the exit code."""
    pause = 0.1  # [s] between two checks for signals and for the parent process
    parent = int(os.environ.get(PARENT, 0))
    while not signals and not any(node.finished for node in nodes):
        lap = Future()  # one lap is many callbacks: returning after each callback took a tenth of an exchange
        for node in nodes:
            node.lap = lap
        executor.spin_until_future_complete(lap, timeout_sec=pause)
        if parent and os.getppid() != parent:
            break
    if not any(node.finished for node in nodes):
        executor.spin_until_future_complete(Future(), timeout_sec=pause)  # messages that were received before the end
    code = 0
    for node in nodes:
        closing_failure = node.close()
        if failure := node.failure or closing_failure:
            print(f"{node.get_name()}: {failure}", file=sys.stderr)
            code = 1
    return code
