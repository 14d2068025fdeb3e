"""Node: the cutting process answers every ``tool_pose`` with the mean ``wrench`` of the movement to this pose."""

from __future__ import annotations

import numpy as np

from kr270_milling.base.samples import PoseSample
from kr270_milling.cell.models import cut_of
from kr270_milling.exchange.cut import CutProtocol
from kr270_milling.live.ros import topics
from kr270_milling.live.ros.node import ERROR, OK, SILENT, WARN, ManagedNode, Silence
from kr270_milling.path.trajectory import Trajectory, fingerprint
from kr270_milling.recordings.messages.topics import CUT

LOOK = 0.1  # [s] of the wall clock between two checks of the robot


class CuttingProcess(ManagedNode):
    """Receive the tool pose, publish the process wrench; ``CutProtocol`` computes."""

    def __init__(self, **kwargs):
        super().__init__("cutting_process", **kwargs)
        self.cell = self.declared_cell()
        self.protocol = CutProtocol(self.cell)
        self._robots = 0
        self._silence = Silence()
        self._mapped = True  # the published map shows the present part
        self.open_outlets(CUT)
        self._pose = self.subscribe(topics.TOOL_POSE, self._on_pose)
        self.subscribe(topics.REFERENCE_TRAJECTORY, self._on_reference)
        self.serve("~/publish_workpiece", self._publish_map)
        self.create_timer(LOOK, self._watch_robot)
        self.set_values(reference="")
        self.report(OK, "unconfigured")

    @property
    def in_pass(self) -> bool:
        return self.protocol.under_way

    def configure(self) -> None:
        above = np.array([0.0, 0.0, float(self.cell.stock.max[2]) + 1.0])
        cut_of(self.cell).sweep(above, above, 0, 1)  # compiles before the pass
        self.send(self.protocol.configure())
        self._mapped = True
        self.report(OK, "configured: fresh workpiece")

    def activate(self) -> None:
        self._robots = 0  # not counted yet
        self.report(OK, "waiting for the tool")

    def deactivate(self) -> None:
        if not self._mapped:
            self._publish_map()
        self.stop()

    def cleanup(self) -> None:
        self.protocol.release()
        self.report(OK, "unconfigured")

    def _on_pose(self, sample: PoseSample) -> None:
        if not self.active:
            return
        answer = self.protocol.pose(sample)
        again = self._silence.end()
        self.send(answer)
        self._mapped = False
        if self._robots == 0 and self.protocol.step == 1:
            self._robots = self._pose.get_publisher_count()
            self.report(OK, "cutting")
        elif again:
            self.report(OK, "cutting again")

    def _on_reference(self, reference: Trajectory) -> None:
        self.protocol.reference(reference)
        self.set_values(reference=f"{fingerprint(reference)} at {reference.start_ns}")

    def _watch_robot(self) -> None:
        silent = self._silence.seconds()
        if self.active and not self._mapped and self.protocol.at_end and silent > LOOK:
            self._publish_map()  # of a pass by hand; a run deactivates the cut at once
        if not self.active or not self.protocol.under_way:
            return
        robots = self._pose.get_publisher_count()
        if not robots:
            self.report(ERROR, "the robot is gone in mid-pass: tool_pose has no publisher")
        elif self._robots and robots > self._robots:
            self.report(ERROR, "a second robot publishes in mid-pass: was compliant_robot restarted? Begin a new pass")
        elif self._silence.is_due(silent):
            self.report(WARN, f"no tool_pose for {SILENT:g} s in mid-pass: is the robot gone?")

    def _publish_map(self) -> str:
        self.send([("workpiece", self.protocol.map_of_part())])
        self._mapped = True
        return "workpiece published"

    def watch(self) -> dict:
        volume = self.protocol.removed_volume
        return {
            "pass_time_s": f"{max(self.protocol.stamp_ns - self.protocol.start_ns, 0) * 1e-9:.6f}",
            "removed_volume_m3": "" if volume is None else repr(volume),
        }
