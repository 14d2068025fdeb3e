"""Run one node as a process: clean exit 0 on SIGINT and SIGTERM, one sentence and another code on failure."""

from __future__ import annotations

import signal
import sys

import rclpy
from rclpy.context import Context
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.signals import SignalHandlerOptions

from kr270_milling.errors import MillingError

__all__ = ["run_node"]


def run_node(make, args: list[str] | None = None) -> int:
    """Spin ``make(context=...)`` until a signal, or until the node sets ``failure`` or ``done``.

    Exit code: 0 after a signal or when done, 1 when the node failed, 2 when it could not be made (bad parameters).
    rclpy's own signal handlers now and then end with 1, and EventsExecutor.spin() does not return on a signal.
    """
    stop: list[int] = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda caught, _: stop.append(caught))
    context = Context()
    try:
        rclpy.init(args=args, context=context, signal_handler_options=SignalHandlerOptions.NO)
    except Exception as error:
        print(f"{sys.argv[0]}: {' '.join(str(error).split())}", file=sys.stderr)
        return 2
    try:
        try:
            node = make(context=context)
        except MillingError as error:
            print(f"{sys.argv[0].rsplit('/', 1)[-1]}: {error}", file=sys.stderr)
            return 2
        executor = EventsExecutor(context=context)
        executor.add_node(node)
        while not stop and node.failure is None and not getattr(node, "done", False):
            executor.spin_once(timeout_sec=0.1)
        for _ in range(20):  # what has arrived before the signal is still taken
            if getattr(node, "settled", lambda: True)():
                break
            executor.spin_once(timeout_sec=0.05)
        closed = getattr(node, "close", lambda: None)()
        failure = node.failure or closed
        if failure:
            print(f"{node.get_name()}: {failure}", file=sys.stderr)
        executor.shutdown()
        node.destroy_node()
        return 1 if failure else 0
    finally:
        context.try_shutdown()
