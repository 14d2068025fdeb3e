"""Node: the cutting process answers every ``tool_pose`` with the mean ``wrench`` of the way to it."""

from __future__ import annotations

import numpy as np
from std_srvs.srv import Trigger

from kr270_milling.ros import messages, raw, topics
from kr270_milling.ros.node import ERROR, OK, SILENT, WARN, ManagedNode, Silence, guarded
from kr270_milling.ros.parameters import declare_cell
from kr270_milling.ros.spin import run_node
from kr270_milling.simulation.sides import CuttingSide

__all__ = ["CuttingProcess", "main"]

MAP_STEP = 0.2e-3  # [m], of the published workpiece map
LOOK = 0.1  # [s] of the wall between two looks whether the robot is there


class CuttingProcess(ManagedNode):
    """Tool pose in, process wrench out; the physics lives in ``cutting``."""

    def __init__(self, **kwargs):
        super().__init__("cutting_process", **kwargs)
        self.cell = declare_cell(self)
        self._side, self._robots, self._end_ns = None, 0, 0  # end of the reference trajectory, if one was heard
        self._silence, self._waiting = Silence(), False
        self._wrench = self.create_publisher(*topics.WRENCH)
        self._map = self.create_publisher(*topics.WORKPIECE)
        pose, reference = topics.TOOL_POSE, topics.REFERENCE_TRAJECTORY
        self._pose = self.create_subscription(pose.type, pose.name, self._on_pose, pose.qos, raw=True)
        self.create_subscription(reference.type, reference.name, self._on_reference, reference.qos, raw=True)
        self.create_service(Trigger, "publish_workpiece", self._on_request)
        self.create_timer(LOOK, self._watch_robot)
        self.report(OK, "unconfigured")

    def configure(self) -> None:
        self._compile()
        self._side, self.stamp_ns = CuttingSide(self.cell.cut(), self.cell.clock), 0
        self._publish_map()  # so that nobody who comes now takes the last part for this one
        self.report(OK, "configured: fresh workpiece")

    def _compile(self) -> None:
        """The first sweep of a process compiles or loads the compiled code: not in the pass."""
        above = np.array([0.0, 0.0, float(self.cell.stock.max[2]) + 1.0])
        self.cell.cut().sweep(above, above, 0, 1)

    def activate(self) -> None:
        self._robots = 0  # not counted yet
        self.report(OK, "waiting for the tool")

    def deactivate(self) -> None:
        self._publish_map()
        self.report(OK, "stopped")

    def cleanup(self) -> None:
        self._side = None
        self.report(OK, "unconfigured")

    @guarded
    def _on_pose(self, data: bytes) -> None:
        if not self.active:
            return
        self._silence.heard()
        stamp_ns, tool, _ = raw.pose_from_bytes(data)
        wrench = self._side.answer(stamp_ns, tool)
        self._wrench.publish(raw.wrench_to_bytes(stamp_ns, wrench))
        self.stamp_ns = stamp_ns
        if self._side.step == 1 and self._robots == 0:
            self._robots = self._pose.get_publisher_count()
            self.report(OK, "cutting")
        elif self._waiting:
            self._waiting = False
            self.report(OK, "cutting again")

    @guarded
    def _on_reference(self, data: bytes) -> None:
        self._end_ns = messages.duration_from_bytes(data)

    @guarded
    def _watch_robot(self) -> None:
        silent = self._silence.look()
        under_way = self.active and self._side is not None and self._side.step >= 0 and self.stamp_ns < self._end_ns
        if not under_way:
            return
        robots = self._pose.get_publisher_count()
        if not robots:
            self.report(ERROR, "the robot is gone in mid-pass: nobody publishes tool_pose any more")
        elif self._robots and robots > self._robots:
            self.report(ERROR, "another robot has come in mid-pass: was compliant_robot restarted? Begin a new pass")
        elif silent > SILENT and not self._waiting:
            self._waiting = True
            self.report(WARN, f"no tool_pose for {SILENT:g} s in mid-pass: is the robot gone?")

    @guarded
    def _publish_map(self) -> bool:
        if self._side is None:
            self.report(WARN, "no workpiece yet: configure first")
            return False
        cut, stock = self._side.cut, self.cell.stock
        thinning = max(1, round(MAP_STEP / stock.grid_step))
        _, _, surface = cut.heights(thinning=thinning)
        removed = (stock.max[2] - surface) / (stock.max[2] - stock.min[2])
        self._map.publish(messages.workpiece_to_msg(self.stamp_ns, removed, stock.min, thinning * stock.grid_step))
        return True

    def _on_request(self, _, response):
        response.success = bool(self._publish_map())
        response.message = "" if response.success else "no workpiece yet: configure first"
        return response

    def watch(self) -> dict:
        cut = self._side.cut if self._side else None
        return {
            "state": self._state_machine.current_state[1],
            "pass_time_s": f"{self.stamp_ns * 1e-9:.6f}",
            "removed_volume_m3": repr(float(cut.removed_volume)) if cut else "",
        }


def main(args: list[str] | None = None) -> int:
    """Console script ``cutting_process``."""
    return run_node(CuttingProcess, args)


if __name__ == "__main__":
    raise SystemExit(main())
