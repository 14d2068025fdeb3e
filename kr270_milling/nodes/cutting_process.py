"""Node: the cutting process answers every ``tool_pose`` with the mean ``wrench`` of the way to it."""

from __future__ import annotations

import numpy as np
from std_srvs.srv import Trigger

from kr270_milling.cell import Cell
from kr270_milling.ros import messages, topics
from kr270_milling.ros.node import OK, WARN, ManagedNode, guarded
from kr270_milling.ros.parameters import declare
from kr270_milling.ros.spin import run_node
from kr270_milling.simulation.sides import CuttingSide

__all__ = ["CuttingProcess", "main"]

MAP_STEP = 0.2e-3  # [m], of the published workpiece map


class CuttingProcess(ManagedNode):
    """Tool pose in, process wrench out; the physics lives in ``cutting``."""

    def __init__(self, **kwargs):
        super().__init__("cutting_process", **kwargs)
        self.cell = declare(self, Cell)
        self._side = None
        self._wrench = self.create_publisher(*topics.WRENCH)
        self._map = self.create_publisher(*topics.WORKPIECE)
        pose = topics.TOOL_POSE
        self._pose = self.create_subscription(pose.type, pose.name, self._on_pose, pose.qos)
        self.create_service(Trigger, "publish_workpiece", self._on_request)
        self.report(OK, "unconfigured")

    def configure(self) -> None:
        self._compile()
        self._side = CuttingSide(self.cell.cut(), self.cell.clock)
        self.report(OK, "configured: fresh workpiece")

    def _compile(self) -> None:
        """The first sweep of a process compiles or loads the compiled code: not in the pass."""
        above = np.array([0.0, 0.0, float(self.cell.stock.max[2]) + 1.0])
        self.cell.cut().sweep(above, above, 0, 1)

    def activate(self) -> None:
        self.report(OK, "waiting for the tool")

    def deactivate(self) -> None:
        self._publish_map()
        self.report(OK, "stopped")

    def cleanup(self) -> None:
        self._side = None

    @guarded
    def _on_pose(self, msg) -> None:
        if not self.active:
            return
        stamp_ns, tool, _ = messages.pose_from_msg(msg)
        wrench = self._side.answer(stamp_ns, tool)
        self._wrench.publish(messages.wrench_to_msg(stamp_ns, wrench))
        self.stamp_ns = stamp_ns
        if self._side.step == 1:
            self.report(OK, "cutting")

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
            "listeners": f"{self._wrench.topic_name}={self._wrench.get_subscription_count()}",
            "pass_time_s": f"{self.stamp_ns * 1e-9:.6f}",
            "removed_area_mm2": f"{cut.removed_area * 1e6:.6f}" if cut else "",
        }


def main(args: list[str] | None = None) -> int:
    """Console script ``cutting_process``."""
    return run_node(CuttingProcess, args)


if __name__ == "__main__":
    raise SystemExit(main())
