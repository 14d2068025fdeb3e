"""Base classes of all nodes: reports in /diagnostics, guarded timers, guarded lifecycle transitions."""

from __future__ import annotations

import functools
import math
import os
import time
from collections.abc import Callable

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import ReliabilityPolicy
from rclpy.subscription import Subscription
from rclpy.task import Future
from std_srvs.srv import Trigger

from kr270_milling.base.errors import InputError, MessageError, MillingError, one_line
from kr270_milling.base.parameter_file import find_file
from kr270_milling.base.units import SECOND
from kr270_milling.cell.cell import Cell
from kr270_milling.cell.cell_file import read_cell
from kr270_milling.exchange.inputs import ExchangeError
from kr270_milling.live.ros import topics
from kr270_milling.live.ros.readiness import SUBSCRIBERS, Report, joined
from kr270_milling.recordings.messages.codec import from_bytes, to_bytes
from kr270_milling.recordings.messages.topics import published_by

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR
SILENT = 2.6  # [s] of the wall clock without a message, after which a node warns; a stop of 2 s gives no warning
NOT_COMPLETE = "its recording is not complete"
LOST = 4.0  # [s] of the wall clock without an answer, after which a node or a run gives up


def stamp_from_ns(ns: int) -> Time:
    return Time(sec=ns // SECOND, nanosec=ns % SECOND)


class Silence:
    """Time since the last message of a partner, without the time in which this process was stopped."""

    def __init__(self):
        self._reported = False
        self.end()

    def end(self) -> bool:
        """Note a message of the partner; return whether it ends a reported silence."""
        self._last = self._checked = time.monotonic()
        was_reported, self._reported = self._reported, False
        return was_reported

    def seconds(self) -> float:
        """Return the silence [s of the wall clock]; call this several times a second."""
        now = time.monotonic()
        if now - self._checked > 0.5:  # this process itself was stopped
            self._last = now
        self._checked = now
        return now - self._last

    def is_due(self, silent: float, limit: float = SILENT) -> bool:
        """Return True once for each silence [s] that exceeds the limit [s]."""
        before, self._reported = self._reported, self._reported or silent > limit
        return self._reported and not before


class ReportingNode(Node):
    """A node with one report, published in /diagnostics five times a second and at every change.

    The node may end its process (``spin.run_nodes``).
    """

    state = ""  #: lifecycle state of a managed node
    finished = False  #: the node has nothing more to do
    failure: str | None = None  #: sentence of a failed node; the exit code is then 1
    lap: Future | None = None  #: the executor returns when this future is done

    def __init__(self, name: str, **kwargs):
        super().__init__(name, **kwargs)
        self.refused = 0  #: messages and requests that could not be used
        self.unusable: dict[str, tuple[int, str, float]] = {}  #: source -> count, last reason, last report [s]
        self.outlets: dict[str, Publisher] = {}  #: name of a topic -> its publisher
        self._level, self.message = OK, "starting"
        self._values: dict[str, object] = {"process": os.getpid()}
        self._report_publisher = self.create_publisher(*topics.DIAGNOSTICS)
        self._report_timer = self.create_timer(0.2, self._report)  # [s] of the wall clock

    @property
    def in_pass(self) -> bool:
        """Return whether a pass is under way; its reports are short: the subscribers took 8 % of an exchange."""
        return False

    def end(self, failure: str | None = None) -> None:
        """End the process after the current callback."""
        self.finished, self.failure = True, failure or self.failure
        if self.lap is not None:
            self.lap.set_result(None)

    def close(self) -> str | None:
        """Close files before the process ends; return a sentence if that failed."""
        return None

    def create_timer(self, timer_period_sec: float, callback, *args, **kwargs):
        """Create a timer on the monotonic clock, which continues when the wall clock is set back.

        An error of the callback is reported in /diagnostics; any but a MillingError ends the node with exit code 1.
        """

        def guarded() -> None:
            try:
                callback()
            except Exception as error:  # noqa: BLE001 - every error is reported
                self.refused += isinstance(error, MillingError)
                self.fail(error, callback.__name__)

        kwargs = {"clock": Clock(clock_type=ClockType.STEADY_TIME), **kwargs}
        return super().create_timer(timer_period_sec, guarded, *args, **kwargs)

    def declared(self, name: str, default, about: str, read_only: bool = True, **fields):
        """Declare a parameter of the node itself and return its value; fields: of its descriptor."""
        descriptor = ParameterDescriptor(description=about, read_only=read_only, **fields)
        return self.declare_parameter(name, default, descriptor).value

    def declared_cell(self) -> Cell:
        """Declare the parameter ``cell_file`` and return the cell of this file. Raises InputError, ConfigError."""
        name = self.declared("cell_file", "", "parameter file of the cell; a shipped file may go by its name")
        if not name:
            where = f"parameters of {self.get_fully_qualified_name()}"
            raise InputError(where, "cell_file is missing: -p cell_file:=CELL.yaml")
        return read_cell(find_file(name))

    def subscribe(self, topic: topics.RosTopic, use: Callable, read: Callable | None = None):
        """Subscribe to a topic; ``use`` receives the record of each message, see ``used``.

        read: bytes -> record, default: as the table of topics states.
        """
        package, name = topic.type.__module__.partition(".")[0], topic.name.strip("/")
        read = read or functools.partial(from_bytes, f"{package}/msg/{topic.type.__name__}")

        def record(data: bytes):
            try:
                return read(data)
            except MillingError as error:
                raise MessageError(str(error)) from None
            except Exception as error:  # noqa: BLE001 - bytes of another node may be anything
                raise MessageError(f"{name}: cannot be read as {topic.type.__name__}: {error}") from None

        def take(data: bytes) -> None:
            self.used(name, lambda: use(record(data)))

        return self.create_subscription(topic.type, topic.name, take, topic.qos, raw=True)

    def used(self, source: str, use: Callable, *args):
        """Return ``use(*args)`` for a message or request of another node; return None after an error.

        The error is counted under ``source``, the topic or service, and reported: as a warning where the message cannot
        be used, as an error where the computation failed.
        """
        try:
            return use(*args)
        except Exception as error:  # noqa: BLE001 - no message of another node ends this node
            what = "" if isinstance(error, MillingError) else f"{source}: {type(error).__name__}: "
            self._refuse(source, one_line(f"{what}{error}")[:300], isinstance(error, (MessageError, ExchangeError)))
        return None

    def serve(self, name: str, use: Callable[[], str]) -> None:
        """Create a Trigger service; its response is the text of ``use()``, or the reason of its refusal."""

        def answer(_, response):
            text = self.used(name, use)
            response.success, response.message = text is not None, self.unusable[name][1] if text is None else text
            return response

        self.create_service(Trigger, name, answer)

    def _refuse(self, source: str, sentence: str, message: bool) -> None:
        """Count what cannot be used; message: the reason is the content of the message."""
        self.refused += 1
        count, before, reported = self.unusable.get(source, (0, "", -math.inf))
        now = time.monotonic()
        say = not message or (sentence != before and now - reported > 1.0)
        self.unusable[source] = count + 1, sentence, now if say else reported
        if not message:
            self.report(ERROR, sentence)
        elif say:  # once; the state of the node remains
            state = self._level, self.message
            self.report(WARN, sentence)
            self._level, self.message = state

    def open_outlets(self, node: str) -> None:
        """Create the publishers that the table of topics has for a node, by the names of the topics."""
        self.outlets = {topic.name: self.create_publisher(*topics.BY_NAME[topic.key]) for topic in published_by(node)}

    def send(self, outputs) -> None:
        """Publish the outputs of a protocol."""
        for name, record in outputs:
            self.outlets[name].publish(to_bytes(record))

    def report(self, level, message: str, **values) -> None:
        """Set the node's report; log and publish a new message at once."""
        changed = (level, message) != (self._level, self.message)
        self._level, self.message = level, message
        self._values.update(values)
        if changed:
            logger = self.get_logger()  # rclpy ties a severity to the calling line
            if level == OK:
                logger.info(message)
            elif level == WARN:
                logger.warning(message)
            else:
                logger.error(message)
            self.publish_report()

    def fail(self, error: Exception, where: str) -> None:
        """Report an error; an error other than a MillingError ends the node."""
        if isinstance(error, MillingError):
            self.report(ERROR, str(error))
        else:
            self.end(f"{type(error).__name__} in {where}: {error}")
            self.report(ERROR, str(self.failure))

    def set_values(self, **values) -> None:
        """Set values of the next report and leave its message unchanged."""
        self._values.update(values)

    def watch(self) -> dict[str, object]:
        """Return further values of the report; a node overrides this."""
        return {}

    def incompatible(self, subscription: Subscription) -> list[str]:
        """Return the nodes that publish on the topic of a subscription with best effort where it is reliable."""
        takes = subscription.qos_profile.reliability
        if takes == ReliabilityPolicy.BEST_EFFORT or (
            self.count_publishers(subscription.topic_name) <= subscription.get_publisher_count()
        ):
            return []
        infos = self.get_publishers_info_by_topic(subscription.topic_name)
        return [i.node_name for i in infos if i.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT]

    def _report(self) -> None:
        """Publish the report, with the publishers whose messages this node does not receive."""
        for subscription in self.subscriptions:
            names = self.incompatible(subscription)
            if names and subscription.topic_name not in self.unusable:
                where = subscription.topic_name
                self._refuse(where, f"{', '.join(names)} must publish reliably on {where}, not with best effort", True)
        self.publish_report()

    def full_name(self, node: str) -> str:
        """Return the full name of a node whose name is relative to the namespace of this node."""
        return f"{self.get_namespace().rstrip('/')}/{node.rstrip('?')}"

    def own_report(self) -> Report:
        """Return the present report."""
        known = {
            SUBSCRIBERS + outlet.topic_name: joined(
                f"{info.node_namespace.rstrip('/')}/{info.node_name}"
                for info in self.get_subscriptions_info_by_topic(outlet.topic_name)
            )
            for outlet in (() if self.in_pass else self.outlets.values())
        }
        refused = {f"refused {name}": f"{count}, the last: {text}" for name, (count, text, _) in self.unusable.items()}
        reads = joined({subscription.topic_name for subscription in self.subscriptions})
        own = {**self._values, **self.watch(), "state": self.state}
        values = {**own, "reads": reads, **known, "refused": self.refused, **refused}
        return Report(self._level[0], self.message, {key: str(value) for key, value in values.items()})

    def publish_report(self) -> None:
        diagnostic = DiagnosticStatus(
            level=self._level,
            name=self.get_fully_qualified_name(),
            hardware_id="simulated robot cell",  # no node of this package represents a machine
            message=self.message,
            values=[KeyValue(key=key, value=value) for key, value in self.own_report().values.items()],
        )
        array = DiagnosticArray(status=[diagnostic])
        array.header.stamp = self.get_clock().now().to_msg()
        self._report_publisher.publish(array)


class ManagedNode(ReportingNode, LifecycleNode):
    """A lifecycle node that reports why a transition failed.

    A child may have ``configure``, ``activate``, ``deactivate`` and ``cleanup``; with the parameter ``autostart`` the
    node configures and activates itself.
    """

    def __init__(self, name: str, autostart: bool = False, **kwargs):
        super().__init__(name, **kwargs)
        self.state = "unconfigured"
        for service in self.services:
            if service.service_name.endswith("/change_state"):
                service.callback = functools.partial(self._change_state, service.callback)
        about = "configure and activate without a request; for a node that is started by hand"
        self.autostart = self.declared("autostart", autostart, about)
        self._start_timer = self.create_timer(0.01, self._start_alone) if self.autostart else None

    @property
    def active(self) -> bool:
        return self.state == "active"

    def destroy_node(self) -> None:
        """Destroy the state machine too: rclpy keeps it, and with it the participant of the node."""
        super().destroy_node()
        self._state_machine = None

    def _change_state(self, change: Callable, request, response):
        """Refuse an impossible transition, for which rclpy raises an error that ends the process."""
        try:
            return change(request, response)
        except RuntimeError:
            wanted = request.transition.label or request.transition.id
            self.get_logger().warning(f"transition {wanted} is not possible in state {self.state}")
            response.success = False
            return response

    def _start_alone(self) -> None:
        """Configure and activate; a node that cannot start ends."""
        if self._start_timer is not None:
            self._start_timer.cancel()
        started = self.trigger_configure() == TransitionCallbackReturn.SUCCESS
        if not (started and self.trigger_activate() == TransitionCallbackReturn.SUCCESS):
            self.end(self.message)

    def stop(self) -> None:
        """Report the end of a pass when every subscriber has its messages; this node keeps them so long."""
        catch_up = Duration(seconds=5)  # for a subscriber to request the messages that it missed
        received = all(outlet.wait_for_all_acked(catch_up) for outlet in self.outlets.values())
        lacking = "" if received else f"; a subscriber has not received the end of the pass; {NOT_COMPLETE}"
        self.report(OK if received else WARN, f"stopped{lacking}")

    def _transition(self, name: str, state: str, _) -> TransitionCallbackReturn:
        """Run a method of the child, if it has one; the node is in the new state meanwhile."""
        before, self.state = self.state, state
        try:
            getattr(self, name, lambda: None)()
        except Exception as error:  # noqa: BLE001 - every error is reported
            self.state = before
            self.fail(error, name)
            return TransitionCallbackReturn.FAILURE
        return TransitionCallbackReturn.SUCCESS

    on_configure = functools.partialmethod(_transition, "configure", "inactive")
    on_activate = functools.partialmethod(_transition, "activate", "active")
    on_deactivate = functools.partialmethod(_transition, "deactivate", "inactive")
    on_cleanup = functools.partialmethod(_transition, "cleanup", "unconfigured")

    def on_shutdown(self, state):
        self.state = "finalized"
        return TransitionCallbackReturn.SUCCESS
