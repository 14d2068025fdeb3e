"""The node of the runner: requests lifecycle transitions, sets parameters, receives diagnostics."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import rclpy
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.srv import SetParameters
from rclpy.client import Client
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSCompatibility, qos_check_compatible
from rclpy.signals import SignalHandlerOptions

from kr270_milling.live.graph.processes import RunError
from kr270_milling.live.ros import topics

__all__ = ["Driver", "Status", "compatible"]

ERROR = b"\x02"
LOOK = 0.02  # [s] between two checks of the processes while waiting


@dataclass(frozen=True)
class Status:
    """Last diagnostic status of a node, and its arrival time [s of the monotonic clock]."""

    level: bytes
    message: str
    values: dict[str, str]
    at: float


class Driver:
    """A node in a separate context. ``check`` is called some 50 times a second while the node waits, and may raise."""

    def __init__(self, namespace: str, check: Callable[[], None]):
        self.check = check
        self.statuses: dict[str, Status] = {}  #: by fully qualified node name
        self.errors: list[tuple[str, str]] = []  #: (node, message) of every new ERROR
        self.pids: dict[str, str] = {}  #: expected process id by fully qualified node name
        self.foreign: set[str] = set()  #: node names that another process also uses; its reports are ignored
        self._context = Context()
        rclpy.init(args=[], context=self._context, signal_handler_options=SignalHandlerOptions.NO)
        self.node = Node(
            "milling_run", namespace=namespace, context=self._context, use_global_arguments=False,
            start_parameter_services=False, enable_rosout=False,
        )  # fmt: skip
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        topic = topics.DIAGNOSTICS
        self.node.create_subscription(topic.type, topic.name, self._on_diagnostics, topic.qos)
        self._clients: dict[str, Client] = {}
        self.namespace = self.node.get_namespace()

    def name_of(self, node: str) -> str:
        """Return the fully qualified name of a node or topic."""
        return f"{self.namespace.rstrip('/')}/{node}"

    def status(self, node: str) -> Status | None:
        return self.statuses.get(self.name_of(node))

    def expect(self, node: str, pid: int) -> None:
        """Ignore the reports of other processes under the name of this node from now on."""
        name = self.name_of(node)
        self.statuses.pop(name, None)
        self.pids[name] = str(pid)

    def value(self, node: str, key: str) -> str:
        """Return a value of the last report of a node; empty without a report."""
        status = self.status(node)
        return "" if status is None else status.values.get(key, "")

    def counts(self, node: str, key: str) -> dict[str, int]:
        """Return a value of the form ``topic=number topic=number ...``: ``listeners``, ``sources``, stamps [ns]."""
        pairs = (text.rpartition("=") for text in self.value(node, key).split())
        return {topic: int(count) for topic, _, count in pairs}

    def silence(self, node: str, now: float) -> float:
        """Return the time since the last report of a node [s], 0 without a report; now: [s] of the monotonic clock."""
        status = self.status(node)
        return 0.0 if status is None else now - status.at

    def _on_diagnostics(self, msg) -> None:
        for status in msg.status:
            before = self.statuses.get(status.name)
            values = {pair.key: pair.value for pair in status.values}
            ours = self.pids.get(status.name)
            if ours is not None and values.get("pid", ours) != ours:
                self.foreign.add(status.name)
                continue
            self.statuses[status.name] = Status(status.level, status.message, values, time.monotonic())
            known = before is not None and (before.level, before.message) == (status.level, status.message)
            if status.level == ERROR and not known:
                self.errors.append((status.name, status.message))

    def until(self, condition: Callable[[], object], what: str, deadline: float, node: str = "graph"):
        """Wait for a condition and return its value; raises RunError after the deadline [s]."""
        end = time.monotonic() + deadline
        while not (value := condition()):
            self.check()
            if time.monotonic() > end:
                raise RunError(node, f"{what} took more than {deadline:g} s")
            self._executor.spin_once(timeout_sec=LOOK)
        return value

    def spin(self) -> None:
        self._executor.spin_once(timeout_sec=LOOK)

    def _ask(self, node: str, kind: type, service: str, request, deadline: float) -> tuple:
        name = f"{self.name_of(node)}/{service}"
        if name not in self._clients:
            self._clients[name] = self.node.create_client(kind, name)
        client = self._clients[name]
        self.until(client.service_is_ready, f"discovery of the service {service}", deadline, node)
        return node, client, client.call_async(request)

    def _finish(self, asked: tuple, what: str, deadline: float):
        node, client, future = asked
        try:
            self.until(future.done, what, deadline, node)
        finally:
            client.remove_pending_request(future)
        return future.result()

    def transition(self, node: str, name: str, deadline: float) -> None:
        """Request a lifecycle transition of a node; raises RunError where it fails."""
        self.transitions([(node, name)], deadline)

    def transitions(self, steps: list[tuple[str, str]], deadline: float) -> None:
        """Request transitions (node, name) of several nodes at the same time."""
        asked = []
        for node, name in steps:
            change = Transition(id=getattr(Transition, f"TRANSITION_{name.upper()}"), label=name)
            request = ChangeState.Request(transition=change)
            asked.append(self._ask(node, ChangeState, "change_state", request, deadline))
        for (node, name), question in zip(steps, asked, strict=True):
            if not self._finish(question, name, deadline).success:
                self.until(lambda: self.errors, f"the reason for the failed {name}", 1.0, node)
                self.check()
                raise RunError(node, f"{name} failed")

    def set_parameters(self, node: str, values: Mapping[str, object], deadline: float) -> None:
        """Set parameters of a node, one after another; raises RunError where the node refuses a value."""
        parameters = [Parameter(name, value=value).to_parameter_msg() for name, value in values.items()]
        request = SetParameters.Request(parameters=parameters)
        asked = self._ask(node, SetParameters, "set_parameters", request, deadline)
        for result in self._finish(asked, f"setting {', '.join(values)}", deadline).results:
            if not result.successful:
                raise RunError(node, result.reason)

    def ends(self, topic: str) -> tuple[list, list]:
        """Return publishers and subscriptions of a fully qualified topic."""
        return self.node.get_publishers_info_by_topic(topic), self.node.get_subscriptions_info_by_topic(topic)

    def nodes(self) -> set[str]:
        """Return the fully qualified names of the nodes in this ROS domain."""
        return {f"{space.rstrip('/')}/{name}" for name, space in self.node.get_node_names_and_namespaces()}

    def close(self) -> None:
        """Leave the graph."""
        self._executor.shutdown()
        self.node.destroy_node()
        self._context.try_shutdown()


def compatible(publisher, subscription) -> bool:
    """Return whether the middleware matches a publisher and a subscription."""
    compatibility, _ = qos_check_compatible(publisher.qos_profile, subscription.qos_profile)
    return compatibility != QoSCompatibility.ERROR
