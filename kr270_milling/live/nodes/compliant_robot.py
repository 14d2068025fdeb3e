"""Node: a simulated compliant robot follows ``reference_trajectory`` under the ``wrench`` of the cut."""

from __future__ import annotations

import time

import numpy as np
from rcl_interfaces.msg import FloatingPointRange
from rclpy.timer import Timer

from kr270_milling.base.frames import WORKPIECE
from kr270_milling.base.samples import Text, WrenchSample
from kr270_milling.cell.models import path_of
from kr270_milling.exchange.robot import RobotProtocol
from kr270_milling.live.ros import topics
from kr270_milling.live.ros.node import ERROR, LOST, OK, SILENT, WARN, ManagedNode, Silence, guarded
from kr270_milling.live.ros.status import Status, status_topic
from kr270_milling.path.trajectory import Trajectory, fingerprint
from kr270_milling.recordings.messages.topics import COMPENSATOR, CUT, RECORDER, ROBOT

__all__ = ["CompliantRobot"]

LOOK = 0.1  # [s] of the wall clock between two checks
AHEAD = 0.005  # [s] of the wall clock that a paced pass may be ahead
MOST_EXCHANGES = 8000  # that the pass may be ahead of compensator or recorder, whose queues have 20,000 messages
FRESH = 1.0  # [s] of the wall clock; the pass does not wait for a node whose last status is older


class CompliantRobot(ManagedNode):
    """Receive the wrench, publish tool pose and deflection; ``RobotProtocol`` computes, the node starts and paces."""

    def __init__(self, **kwargs):
        super().__init__("compliant_robot", **kwargs)
        self.cell = self.declared_cell()
        self.protocol = RobotProtocol(self.cell)
        about = "seconds of the pass in a second of the wall clock; 0: as fast as possible"
        limits = [FloatingPointRange(from_value=0.0, to_value=1e6)]
        self.pace = self.declared("pace", 0.0, about, floating_point_range=limits)
        self._pace_timer: Timer | None = None
        self._most_ahead = round(MOST_EXCHANGES * path_of(self.cell).clock.period * 1e9)  # [ns]
        self._given_up = False
        self._late: list = []  # outputs that wait for the wall clock
        self._silence = Silence()
        self.open_outlets(ROBOT)
        self.subscribe(topics.REFERENCE_TRAJECTORY, self._on_reference)
        self._wrench = self.subscribe(topics.WRENCH, self._on_wrench)
        self._planner = self.subscribe(status_topic(COMPENSATOR), self._on_planner)
        self._cut = self.subscribe(status_topic(CUT), self._on_cut)
        self.subscribe(status_topic(RECORDER), self._on_recorder)
        self._readers: dict[str, tuple[float, int]] = {}  # node: arrival of its status [s], stamp of its last pose [ns]
        self._ready = False  # as the compensator reported last
        self._cut_active = False  # as the cutting process reported last
        self.create_timer(LOOK, self._watch_answer)
        self.set_values(reference="")
        self.report(OK, "unconfigured")

    def configure(self) -> None:
        trial = RobotProtocol(self.cell)  # compiles before the pass
        trial.reference = path_of(self.cell).target
        trial.start()
        trial.wrench(WrenchSample(0, WORKPIECE, np.zeros(6)))
        self.send(self.protocol.describe())
        self.protocol.stop()
        self.report(OK, "configured")

    def activate(self) -> None:
        self.protocol.stop()
        self.report(OK, "waiting for a reference trajectory and a cutting process")

    def deactivate(self) -> None:
        self.protocol.stop()
        self.report(OK, "stopped")

    def _on_reference(self, reference: Trajectory) -> None:
        self.protocol.reference = reference
        self.set_values(reference=f"{fingerprint(reference)} at {reference.start_ns}")

    def _on_planner(self, text: Text) -> None:
        status = Status.from_text(text.text)
        self._ready = not status.values.get("waiting_for")
        self._note_reader(COMPENSATOR, status)

    def _on_cut(self, text: Text) -> None:
        self._cut_active = bool(Status.from_text(text.text).values.get("active"))

    def _on_recorder(self, text: Text) -> None:
        self._note_reader(RECORDER, Status.from_text(text.text))

    def _note_reader(self, node: str, status: Status) -> None:
        """Note the last pose that a node has read."""
        stamp = status.stamps_ns.get(self.outlets["tool_pose"].topic_name, -1)
        self._readers[node] = time.monotonic(), stamp

    def _is_too_far_ahead(self) -> bool:
        """Return whether compensator or recorder are so far behind in this pass that they would lose messages."""
        start, late = self.protocol.start_ns, self.protocol.awaited_ns - self._most_ahead
        since = time.monotonic() - FRESH
        return any(start <= stamp < late and arrival > since for arrival, stamp in self._readers.values())

    @guarded
    def _watch_answer(self) -> None:
        """Start the pass when the graph is ready; give up when no wrench arrives."""
        protocol, silent = self.protocol, self._silence.seconds()
        if not self.active or self._late or (protocol.started and (protocol.done or self._given_up)):
            return
        cut = self.outlets["tool_pose"].get_subscription_count() and self._wrench.get_publisher_count()
        if not protocol.started:
            ready = self._ready or not self._planner.get_publisher_count()
            active = self._cut_active or not self._cut.get_publisher_count()
            usable = cut and ready and active and protocol.reference is not None
            if usable and not self.used("reference_trajectory", self._start):
                protocol.reference = None  # a pass cannot follow it
            return
        if not cut or silent > LOST:
            what = "no wrench: its publisher is gone" if not cut else f"no wrench for {LOST:g} s"
            self._given_up = True
            self.report(ERROR, f"{what}; the cutting process is gone and the pass is given up")
        elif self._silence.is_due(silent):
            self.report(WARN, f"no wrench for {SILENT:g} s from the cutting process")

    def _start(self) -> bool:
        outputs = self.protocol.start()
        self._given_up = False
        self._started = time.monotonic()
        self.report(OK, "pass running")
        self._answer(outputs)
        return True

    def _on_wrench(self, sample: WrenchSample) -> None:
        if not self.active or self._given_up or self.protocol.done:
            return
        outputs = self.protocol.wrench(sample)
        if not outputs and not self.protocol.done:
            return  # not the awaited wrench
        self.stamp_ns = sample.stamp
        self._answer(outputs)
        if self.protocol.done:
            self._finish()

    def _answer(self, outputs) -> None:
        """Publish the outputs; delay the next tool pose to the wall clock of a pace, or for readers that are late."""
        if self._silence.end():
            self.report(OK, "pass running")
        if not self.protocol.done:
            ahead = LOOK if self._is_too_far_ahead() else 0.0
            if self.pace > 0.0:
                paced = self._started + self.protocol.time_ns * 1e-9 / self.pace - time.monotonic()
                ahead = max(ahead, paced)
            if ahead > AHEAD:
                self._late, outputs = outputs[:1], outputs[1:]
                self._pace_timer = self.create_timer(ahead, self._ask_late)
        self.send(outputs)

    @guarded
    def _ask_late(self) -> None:
        if self._pace_timer is not None:
            self.destroy_timer(self._pace_timer)
        self._silence.end()
        late, self._late = self._late, []
        if self.protocol.started:
            self.send(late)

    def _finish(self) -> None:
        wall = time.monotonic() - self._started
        values = {"largest_correction_um": f"{self.protocol.correction * 1e6:.6f}", "wall_s": repr(wall)}
        if self.protocol.large_correction:
            self.report(WARN, "pass complete, but the corrections are large: shorten exchange.period_ms", **values)
        else:
            self.report(OK, "pass complete", **values)

    def watch(self) -> dict:
        return {
            "state": self.state,
            "passes": self.protocol.passes,
            "pass_time_s": f"{self.protocol.time_ns * 1e-9:.6f}",
        }
