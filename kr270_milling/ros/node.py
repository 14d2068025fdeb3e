"""What all nodes share: diagnostics, guarded callbacks, guarded lifecycle transitions."""

from __future__ import annotations

import functools
import os
import time

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.clock import Clock, ClockType
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.task import Future

from kr270_milling.base.errors import MillingError
from kr270_milling.base.units import SECOND
from kr270_milling.messages.codec import to_bytes
from kr270_milling.messages.topics import published_by
from kr270_milling.ros import topics
from kr270_milling.ros.drain import is_aside

__all__ = ["LOST", "SILENT", "ManagedNode", "ReportingNode", "Silence", "guarded", "stamp_from_ns"]

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR
REPORT_PERIOD = 0.2  # [s] of the wall; a partner's death must be told within 3 s
SILENT = 2.6  # [s] of the wall after which a silence is told; a partner that is held up for 2 s is only waited for
LOST = 4.0  # [s] of the wall after which one that must answer is given up; a busy machine takes long to go on
HELD_UP = 0.5  # [s] between two looks after which it was us who did not listen
HARDWARE = "simulated robot cell"  # of every status: no node of this package speaks for a machine
OWN = ("/rosout", "/parameter_events")  # topics that every node has for itself


def stamp_from_ns(ns: int) -> Time:
    return Time(sec=ns // SECOND, nanosec=ns % SECOND)


def guarded(callback):
    """A callback whose errors are reported: ours to /diagnostics, any other ends the node with exit code 1."""

    @functools.wraps(callback)
    def wrapped(self, *args):
        try:
            return callback(self, *args)
        except Exception as error:  # noqa: BLE001 - whatever it is, it is reported
            self.refused += isinstance(error, MillingError)
            self.fail(error, callback.__name__)
        return None

    return wrapped


class Silence:
    """Since when a partner has not been heard; a time in which this process did not listen does not count."""

    def __init__(self):
        self._told = False
        self.heard()

    def heard(self) -> bool:
        """Whether a silence that was told is over now."""
        self._last = self._looked = time.monotonic()
        over, self._told = self._told, False
        return over

    def look(self) -> float:
        """[s] of the wall; to be called several times a second."""
        now = time.monotonic()
        if now - self._looked > HELD_UP:
            self._last = now
        self._looked = now
        return now - self._last

    def is_to_be_told(self, silent: float) -> bool:
        """Whether a silence [s] has become so long; once for each."""
        before, self._told = self._told, self._told or silent > SILENT
        return self._told and not before


class Ending:
    """Mixin: a node that may end its process (``spin.run_nodes``)."""

    done = False  #: whether it is at its end
    failure: str | None = None  #: the sentence with which it ends, where something failed; the exit code is 1 then
    lap: Future | None = None  #: of the executor, which comes back when it is done

    def end(self, failure: str | None = None) -> None:
        """End, behind the callback that runs now."""
        self.done, self.failure = True, failure or self.failure
        if self.lap is not None:
            self.lap.set_result(None)


class Reporting(Ending, Node):
    """Mixin: one diagnostic status of the node, published five times a second and at once when it changes."""

    def start_reporting(self) -> None:
        self.refused = 0  #: messages and requests that could not be used
        self.sent: dict[str, int] = {}  #: stamp of the last message of each outlet [ns]
        self.outlets: dict[str, Publisher] = {}  #: by the names of their topics
        self.stamp_ns = 0  #: time of the pass, the stamp of whatever the node publishes next without one of its own
        self._level, self.message, self._said = OK, "starting", ""
        self._values: dict[str, object] = {}
        self._report_publisher = self.create_publisher(*topics.DIAGNOSTICS)
        self._report_timer = self.create_timer(REPORT_PERIOD, self.publish_report)

    def create_timer(self, timer_period_sec: float, callback, *args, **kwargs):
        """On the monotonic clock: one on the node's own would stand still when the wall clock is set back."""
        kwargs = {"clock": Clock(clock_type=ClockType.STEADY_TIME), **kwargs}
        return super().create_timer(timer_period_sec, callback, *args, **kwargs)

    def declared(self, name: str, default, about: str, read_only: bool = True, **how):
        """Declare a parameter of the node itself; returns its value."""
        return self.declare_parameter(
            name, default, ParameterDescriptor(description=about, read_only=read_only, **how)
        ).value

    def hear(self, topic: topics.Topic, callback):
        """Subscribe to the bytes of a topic."""
        return self.create_subscription(topic.type, topic.name, callback, topic.qos, raw=True)

    def open_outlets(self, node: str) -> None:
        """Create the publishers that the table of topics has for a node, by the names of the topics."""
        self.outlets = {topic.name: self.create_publisher(*topics.BY_NAME[topic.key]) for topic in published_by(node)}

    def send(self, outputs) -> None:
        """Publish what a protocol gives."""
        for name, record in outputs:
            self.outlets[name].publish(to_bytes(record))
            self.sent[name] = getattr(record, "stamp", 0)

    def report(self, level, message: str, **values) -> None:
        """Set the node's status; a new message is also logged and published at once."""
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
        """Report an error; one that is not ours ends the node."""
        if isinstance(error, MillingError):
            self.report(ERROR, str(error))
        else:
            self.end(f"{type(error).__name__} in {where}: {error}")
            self.report(ERROR, str(self.failure))

    def tell(self, **values) -> None:
        """Values for the next report, without another message."""
        self._values.update(values)

    def watch(self) -> dict[str, object]:
        """Values to publish beside those of ``report``; a node overrides it."""
        return {}

    @property
    def subscriptions(self):
        """Those that an executor serves; not those that the node drains itself, which EventsExecutor would take."""
        return (s for s in super().subscriptions if not is_aside(s))

    def _ends(self) -> dict[str, object]:
        """Who has been found: a pass must not start before both ends of every topic have."""
        listeners = {p.topic_name: p.get_subscription_count() for p in self.publishers}
        heard = {s.topic_name: s.get_publisher_count() for s in super().subscriptions}
        ends = {"listeners": listeners, "heard": heard}
        return {k: " ".join(f"{t}={n}" for t, n in v.items() if t not in OWN) for k, v in ends.items()}

    def publish_report(self) -> None:
        sent = " ".join(f"{self.outlets[name].topic_name}={ns}" for name, ns in self.sent.items() if ns)
        values = {"pid": os.getpid(), **self._values, **self.watch(), **self._ends(), "sent_ns": sent}
        values["refused"] = self.refused
        status = DiagnosticStatus(
            level=self._level,
            name=self.get_fully_qualified_name(),
            hardware_id=HARDWARE,
            message=self.message,
            values=[KeyValue(key=k, value=str(v)) for k, v in values.items()],
        )
        array = DiagnosticArray(status=[status])
        array.header.stamp = stamp_from_ns(self.stamp_ns)
        self._report_publisher.publish(array)


class ReportingNode(Reporting, Node):
    """A plain node with diagnostics."""

    def __init__(self, name: str, **kwargs):
        Node.__init__(self, name, **kwargs)
        self.start_reporting()


class ManagedNode(Reporting, LifecycleNode):
    """A lifecycle node that survives invalid transitions and tells why a transition failed.

    A child implements ``configure``, ``activate``, ``deactivate`` and ``cleanup``; with the parameter ``autostart``
    the node configures and activates itself.
    """

    def __init__(self, name: str, **kwargs):
        LifecycleNode.__init__(self, name, **kwargs)
        self.start_reporting()
        self.active = False
        about = "configure and activate without being told to; for a node that is started by hand"
        self._autostart = self.declared("autostart", False, about)
        self._start_timer = self.create_timer(0.01, self._start_alone) if self._autostart else None

    def _start_alone(self) -> None:
        if self._start_timer is not None:
            self._start_timer.cancel()
        if self.trigger_configure() == TransitionCallbackReturn.SUCCESS:
            self.trigger_activate()

    def destroy_node(self) -> None:
        """With the state machine, which rclpy forgets: it keeps the node, and with it the participant, alive."""
        super().destroy_node()
        self._state_machine.destroy_when_not_in_use()

    @property
    def state(self) -> str:
        """Of the lifecycle."""
        return self._state_machine.current_state[1]

    def configure(self) -> None: ...

    def activate(self) -> None: ...

    def deactivate(self) -> None: ...

    def cleanup(self) -> None: ...

    def _transition(self, step, name: str) -> TransitionCallbackReturn:
        try:
            step()
        except Exception as error:  # noqa: BLE001 - whatever it is, it is reported
            self.fail(error, name)
            return TransitionCallbackReturn.FAILURE
        return TransitionCallbackReturn.SUCCESS

    def on_configure(self, state):
        return self._transition(self.configure, "configure")

    def on_activate(self, state):
        self.active = True
        result = self._transition(self.activate, "activate")
        self.active = result == TransitionCallbackReturn.SUCCESS
        return result

    def on_deactivate(self, state):
        self.active = False
        return self._transition(self.deactivate, "deactivate")

    def on_cleanup(self, state):
        return self._transition(self.cleanup, "cleanup")

    def on_shutdown(self, state):
        self.active = False
        return TransitionCallbackReturn.SUCCESS

    def _LifecycleNodeMixin__on_change_state(self, request, response):
        """An invalid transition raises in rclpy and would kill the node: refuse it instead."""
        try:
            change = LifecycleNode._LifecycleNodeMixin__on_change_state  # type: ignore[attr-defined]  # noqa: SLF001
            return change(self, request, response)
        except rclpy_implementation.RCLError:
            wanted = request.transition.label or request.transition.id
            self.get_logger().warning(f"transition {wanted} is not possible in state {self.state}")
            response.success = False
            return response
