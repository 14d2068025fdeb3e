"""Node: a simulated compliant robot follows ``reference_trajectory`` under the ``wrench`` of the cut."""

from __future__ import annotations

import time
from collections.abc import Mapping

import numpy as np
from rcl_interfaces.msg import FloatingPointRange
from rclpy.duration import Duration
from rclpy.timer import Timer

from kr270_milling.base.frames import WORKPIECE
from kr270_milling.base.samples import WrenchSample
from kr270_milling.cell.models import path_of
from kr270_milling.exchange.robot import RobotProtocol
from kr270_milling.live.ros import topics
from kr270_milling.live.ros.node import ERROR, LOST, OK, SILENT, WARN, ManagedNode, Silence
from kr270_milling.live.ros.readiness import Report, read_reports
from kr270_milling.path.trajectory import Trajectory, fingerprint
from kr270_milling.recordings.messages.topics import COMPENSATOR, ROBOT

LOOK = 0.1  # [s] of the wall clock between two checks
#: exchanges from one check that every subscriber has the poses to the next: a fifth of the history of the publisher.
#: A check takes 0 to 20 ms, the time to the next heartbeat of the profile; a subscriber that was killed delays the pass
#: until its lease ends, 20 s
CHECK = 4000


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
        self._given_up = False
        self._late: list = []  # outputs that wait for the wall clock
        self._silence = Silence()
        self.open_outlets(ROBOT)
        self._reference = self.subscribe(topics.REFERENCE_TRAJECTORY, self._on_reference)
        self._wrench = self.subscribe(topics.WRENCH, self._on_wrench)
        self.subscribe(topics.DIAGNOSTICS, self._on_reports, lambda data: {} if self.in_pass else read_reports(data))
        self._exchanges = 0  # since the last check
        self._ready = False  # as the compensator reported last
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
        self._ready = False  # a report of the pass before says nothing of a node that was started again
        self.protocol.stop()
        self.report(OK, "waiting for a reference trajectory and a cutting process")

    def deactivate(self) -> None:
        self.protocol.stop()
        self.stop()

    def _on_reference(self, reference: Trajectory) -> None:
        self.protocol.reference = reference
        self.set_values(reference=f"{fingerprint(reference)} at {reference.start_ns}")

    @property
    def in_pass(self) -> bool:
        return self.protocol.started and not self.protocol.finished

    def _on_reports(self, reports: Mapping[str, Report]) -> None:
        planner = reports.get(self.full_name(COMPENSATOR))
        if planner is not None:
            self._ready = planner.values.get("waiting_for") == ""

    def _is_too_far_ahead(self) -> bool:
        """Return whether a subscriber lacks poses; one that is stopped, or has no room, confirms none."""
        self._exchanges += 1
        if self._exchanges < CHECK:
            return False
        if self.outlets["tool_pose"].wait_for_all_acked(Duration(seconds=LOOK)):
            self._exchanges = 0
            return False
        return True

    def _watch_answer(self) -> None:
        """Start the pass when the graph is ready; give up when no wrench arrives."""
        protocol, silent = self.protocol, self._silence.seconds()
        if not self.active or self._late or (protocol.started and (protocol.finished or self._given_up)):
            return
        cut = self.outlets["tool_pose"].get_subscription_count() and self._wrench.get_publisher_count()
        if not protocol.started:
            # a compensator that publishes the reference decides when a pass may start
            infos = self.get_publishers_info_by_topic(self._reference.topic_name)
            planned = any(info.node_name == COMPENSATOR for info in infos)
            usable = cut and protocol.reference is not None and (self._ready or not planned)
            outputs = self.used("reference_trajectory", protocol.start) if usable else None
            if outputs:
                self._given_up = False
                self._started = time.monotonic()
                self.report(OK, "pass running")
                self._answer(outputs)
            elif usable:
                protocol.reference = None  # a pass cannot follow it
            return
        if not cut or silent > LOST:
            what = "no wrench: its publisher is gone" if not cut else f"no wrench for {LOST:g} s"
            self._given_up = True
            self.report(ERROR, f"{what}; the cutting process is gone and the pass is given up")
        elif self._wrench.get_publisher_count() > 1:
            self.report(WARN, "two nodes publish wrench, and the first answer to a pose counts: stop one of them")
        elif self._silence.is_due(silent):
            self.report(WARN, f"no wrench for {SILENT:g} s from the cutting process")

    def _on_wrench(self, sample: WrenchSample) -> None:
        if not self.active or self._given_up or self.protocol.finished:
            return
        outputs = self.protocol.wrench(sample)
        if not outputs and not self.protocol.finished:
            return  # not the awaited wrench
        self._answer(outputs)
        if self.protocol.finished:
            wall = time.monotonic() - self._started
            values = {"largest_correction_um": f"{self.protocol.correction * 1e6:.6f}", "wall_s": repr(wall)}
            large = self.protocol.large_correction
            but = ", but the corrections are large: shorten exchange.period_ms" if large else ""
            self.report(WARN if large else OK, f"pass complete{but}", **values)

    def _answer(self, outputs) -> None:
        """Publish the outputs; delay the next tool pose to the wall clock of a pace, or for readers that are late."""
        if self._silence.end():
            self.report(OK, "pass running")
        if not self.protocol.finished:
            ahead = LOOK if self._is_too_far_ahead() else 0.0
            if self.pace > 0.0:
                paced = self._started + self.protocol.time_ns * 1e-9 / self.pace - time.monotonic()
                ahead = max(ahead, paced)
            if ahead > 0.005:  # [s] of the wall clock
                self._late, outputs = outputs[:1], outputs[1:]
                self._pace_timer = self.create_timer(ahead, self._ask_late)
        self.send(outputs)

    def _ask_late(self) -> None:
        if self._pace_timer is not None:
            self.destroy_timer(self._pace_timer)
        self._silence.end()
        if self.protocol.started and self._exchanges >= CHECK and self._is_too_far_ahead():
            self._pace_timer = self.create_timer(LOOK, self._ask_late)
            return
        late, self._late = self._late, []
        if self.protocol.started:
            self.send(late)

    def watch(self) -> dict:
        return {"passes": self.protocol.passes, "pass_time_s": f"{self.protocol.time_ns * 1e-9:.6f}"}
