"""The node of the runner: requests lifecycle transitions, sets parameters, receives the reports in /diagnostics."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping

import rclpy
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.srv import SetParameters
from rclpy.client import Client
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions

from kr270_milling.live.graph.processes import RunError
from kr270_milling.live.ros import topics
from kr270_milling.live.ros.node import ERROR, Silence
from kr270_milling.live.ros.readiness import Report, read_reports

__all__ = ["Driver"]


class Driver:
    """A node in a separate context. ``check`` is called some 50 times a second while the node waits, and may raise."""

    def __init__(self, namespace: str, check: Callable[[], None]):
        self.check = check
        self.reports: dict[str, Report] = {}  #: last report by node
        self.arrivals: dict[str, float] = {}  #: node -> arrival of its last report [s of the monotonic clock]
        self.silences: dict[str, Silence] = {}  #: node -> its silence
        self.error: tuple[str, str] | None = None  #: (node, message) of the first ERROR
        self.foreign = ""  #: name of a node that another process also uses; reports of that process are ignored
        self._context = Context()
        rclpy.init(args=[], context=self._context, signal_handler_options=SignalHandlerOptions.NO)
        self.node = Node(
            "milling_run",
            namespace=namespace,
            context=self._context,
            use_global_arguments=False,
            start_parameter_services=False,
            enable_rosout=False,
        )
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._clients: dict[str, Client] = {}
        self._processes: dict[str, int] = {}  # node -> id of its process
        self.namespace = self.node.get_namespace()
        kind, name, qos = topics.DIAGNOSTICS
        self.node.create_subscription(kind, name, self._on_reports, qos, raw=True)

    def name_of(self, node: str) -> str:
        """Return the fully qualified name of a node or topic."""
        return f"{self.namespace.rstrip('/')}/{node}"

    def expect(self, node: str, pid: int) -> None:
        """Take the reports of this process under the name of the node from now on."""
        self.silences[node] = Silence()
        self._processes[node] = pid

    def _on_reports(self, data: bytes) -> None:
        try:
            reports = read_reports(data)
        except Exception:  # noqa: BLE001 - bytes of another node may be anything
            return
        for node, pid in self._processes.items():
            report = reports.get(self.name_of(node))
            if report is None or "process" not in report.values:
                continue
            if report.values["process"] != str(pid):
                self.foreign = self.name_of(node)
                continue
            self.reports[node], self.arrivals[node] = report, time.monotonic()
            self.silences[node].end()
            if report.level == ERROR[0] and self.error is None:
                self.error = node, report.message

    def value(self, node: str, key: str) -> str | None:
        """Return a value of the last report of a node; None without a report or without the value."""
        report = self.reports.get(node)
        return None if report is None else report.values.get(key)

    def until(self, condition: Callable[[], object], what: str, deadline: float, node: str = "graph"):
        """Wait for a condition and return its value; raises RunError after the deadline [s]."""
        end = time.monotonic() + deadline
        while not (value := condition()):
            self.check()
            if time.monotonic() > end:
                raise RunError(node, f"{what} took more than {deadline:g} s")
            self.spin()
        return value

    def spin(self) -> None:
        self._executor.spin_once(timeout_sec=0.02)  # then the processes are checked

    def _call(self, node: str, kind: type, service: str, request, what: str, deadline: float) -> Callable:
        """Call a service of a node; return a function that waits for the response and returns it.

        what: words for the call, for the error after the deadline [s].
        """
        name = f"{self.name_of(node)}/{service}"
        if name not in self._clients:
            self._clients[name] = self.node.create_client(kind, name)
        client = self._clients[name]
        self.until(client.service_is_ready, f"discovery of the service {service}", deadline, node)
        future = client.call_async(request)

        def response():
            self.until(future.done, what, deadline, node)
            return future.result()

        return response

    def transition(self, name: str, *nodes: str, deadline: float) -> None:
        """Request a lifecycle transition of several nodes at once; raises RunError where it fails."""
        change = Transition(id=getattr(Transition, f"TRANSITION_{name.upper()}"), label=name)
        request = ChangeState.Request(transition=change)
        responses = {node: self._call(node, ChangeState, "change_state", request, name, deadline) for node in nodes}
        for node, response in responses.items():
            if not response().success:
                self.until(lambda: self.error, f"the reason for the failed {name}", 1.0, node)
                self.check()

    def set_parameters(self, node: str, values: Mapping[str, object], deadline: float) -> None:
        """Set parameters of a node, one after another; raises RunError where the node refuses a value."""
        parameters = [Parameter(name, value=value).to_parameter_msg() for name, value in values.items()]
        request = SetParameters.Request(parameters=parameters)
        what = f"setting {', '.join(values)}"
        for result in self._call(node, SetParameters, "set_parameters", request, what, deadline)().results:
            if not result.successful:
                raise RunError(node, result.reason)

    def nodes(self) -> set[str]:
        """Return the fully qualified names of the nodes in this ROS domain."""
        return {f"{space.rstrip('/')}/{name}" for name, space in self.node.get_node_names_and_namespaces()}
