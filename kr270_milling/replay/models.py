"""The nodes' work between in and out, on recorded messages: the same step classes, no ROS."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from kr270_milling.bag.gaps import Passes
from kr270_milling.base.frames import rotation_from_quaternion
from kr270_milling.cell.cell import MOST_STEPS, Cell
from kr270_milling.messages import encode
from kr270_milling.replay.compare import Channel
from kr270_milling.replay.inputs import TOOL, Sample, trajectory_of
from kr270_milling.simulation.sides import CuttingSide, RobotSide

__all__ = ["CutModel", "JOINT_NAMES", "MOST_AHEAD", "RobotModel", "WORKPIECE"]

JOINT_NAMES = [f"joint_a{i}" for i in range(1, 7)]
WORKPIECE = "workpiece"
MAP_STEP = 0.2e-3  # [m], of the workpiece map
MOST_AHEAD = 10  # exchange periods that a message may stand before its cause in the file

Stop = Callable[[int, str], None]  # (stamp [ns], reason)


class RobotModel:
    """reference_trajectory and wrench in; tool_pose, deflection, joint_states and clock out."""

    def __init__(self, cell: Cell, outputs: dict[str, Channel], stop: Stop):
        self.cell, self._out, self._stop = cell, outputs, stop
        self.reference: bytes | None = None  #: the latest recorded reference trajectory
        self._passes, self._side, self._stopped = Passes(), None, False
        self._held: list[Sample] = []

    @property
    def done(self) -> bool:
        """Whether the latest pass ran to its end."""
        return self._side is not None and self._side.done

    def wrench(self, heard: Sample) -> None:
        """The next wrench. Where the exchange is iterated, those of one stamp wait until they are all there: the
        robot drops the second answer to a question that it asked twice, which repeats the one before."""
        if self._held and self._held[0].stamp != heard.stamp:
            self.finish()
        self._held.append(heard)
        if self.cell.exchange.iterations == 1:
            self.finish()

    def finish(self) -> None:
        """No more of the present stamp will come."""
        held, self._held = self._held, []
        surplus = len(held) - self.cell.exchange.iterations
        for i, heard in enumerate(held):
            if surplus > 0 and i and heard == held[i - 1]:
                surplus -= 1
            else:
                self._take(heard)

    def _take(self, heard: Sample) -> None:
        if self._passes.begins(heard.stamp) or (self._side is None and not self._stopped):
            self._begin(heard.stamp)
        side = self._side
        if self._stopped or side.done or heard.frame not in (WORKPIECE, TOOL) or not heard.finite:
            return
        values = np.array(heard.values)
        if heard.frame == TOOL:
            turn = rotation_from_quaternion(side.orientation_now)
            values = np.concatenate([turn @ values[:3], turn @ values[3:]])
        if heard.stamp > side.awaited_ns:
            self._stopped = True
            self._stop(side.awaited_ns, "the wrench of this time is not in the recording")
        elif heard.stamp == side.awaited_ns:
            self._answer(side, heard.stamp, values)

    def _begin(self, stamp: int) -> None:
        self._stopped = self.reference is None or stamp != 0
        if self.reference is None:
            self._stop(stamp, "no reference trajectory is in the recording")
        elif stamp != 0:
            self._stop(stamp, "the recording begins in the middle of a pass, whose state is not known")
        if self._stopped:
            return
        reference = trajectory_of(self.reference)
        if self.cell.clock.steps(reference.duration_ns) > MOST_STEPS:
            raise ValueError(f"the reference trajectory takes {reference.duration_ns * 1e-9:g} s")
        model = self.cell.arm_model(reference)
        self._side = side = RobotSide(model, self.cell.clock, reference, self.cell.exchange.iterations)
        self._thinned, self._step = self.cell.thinned_steps(), 0
        self._joints = self.cell.joints_at(side.course[:: self._thinned], side.orientation[:: self._thinned])
        self._publish_pose(side)

    def _answer(self, side: RobotSide, stamp: int, wrench: np.ndarray) -> None:
        deflection = side.answer(stamp, wrench)
        if deflection is not None:
            self._publish("deflection", stamp, encode.vectors_bytes(stamp, WORKPIECE, deflection))
            if self._step % self._thinned == 0:
                joints = self._joints[self._step // self._thinned]
                self._publish("joint_states", stamp, encode.joint_state_bytes(stamp, JOINT_NAMES, joints))
                self._publish("clock", stamp, encode.clock_bytes(stamp))
            self._step += 1
        if not side.done:
            self._publish_pose(side)

    def _publish_pose(self, side: RobotSide) -> None:
        stamp = side.awaited_ns
        self._publish("tool_pose", stamp, encode.pose_bytes(stamp, WORKPIECE, side.tool, side.orientation_now))

    def _publish(self, name: str, stamp: int, message: encode.Encoded) -> None:
        if name in self._out:
            self._out[name].made(stamp, message)


class CutModel:
    """tool_pose in; wrench and workpiece out."""

    def __init__(self, cell: Cell, outputs: dict[str, Channel], stop: Stop):
        self.cell, self._out, self._stop = cell, outputs, stop
        self._passes, self._side, self._stamp, self._stopped = Passes(), None, -1, False
        self._maps: list[tuple[int, bytes]] = []

    def pose(self, heard: Sample) -> None:
        if self._passes.begins(heard.stamp) or self._side is None:
            self._side, self._stopped = CuttingSide(self.cell.cut(), self.cell.clock), False
        side, step = self._side, self.cell.clock.step(heard.stamp)
        if self._stopped or heard.frame != WORKPIECE or not heard.finite or step < 0:
            return
        if step > side.step + 1:
            self._stopped, at = True, int(self.cell.clock.stamp(side.step + 1))
            begun = "the tool pose of this time is not in the recording"
            self._stop(at, begun if side.step >= 0 else "the recording begins in the middle of a pass")
        elif step >= side.step:
            wrench = side.answer(heard.stamp, np.array(heard.values[:3]))
            self._stamp = heard.stamp
            if "wrench" in self._out:
                message = encode.vectors_bytes(heard.stamp, WORKPIECE, wrench)
                self._out["wrench"].made(heard.stamp, message)
            self._compare_maps()

    def workpiece(self, stamp: int, data: bytes) -> None:
        """A recorded map; it shows the part as it was behind the last pose that was answered.

        It may stand a little before that pose in the file. One from far ahead is latched from the pass before.
        """
        ahead = stamp - self._stamp
        if self._stamp >= 0 and 0 <= ahead <= MOST_AHEAD * self.cell.exchange.period * 1e9:
            self._maps.append((stamp, data))
            self._compare_maps()
        else:
            self._out["workpiece"].take(data)

    def _compare_maps(self) -> None:
        while self._maps and self._maps[0][0] <= self._stamp:
            stamp, data = self._maps.pop(0)
            if stamp == self._stamp and not self._stopped:
                self._out["workpiece"].made(stamp, self._map(stamp))
                self._out["workpiece"].heard(stamp, data)
            else:
                self._out["workpiece"].take(data)

    def finish(self) -> None:
        for _, data in self._maps:
            self._out["workpiece"].take(data)

    def _map(self, stamp: int) -> encode.Encoded:
        cut, stock = self._side.cut, self.cell.stock
        thinning = max(1, round(MAP_STEP / stock.grid_step))
        _, _, surface = cut.heights(thinning=thinning)
        removed = (stock.max[2] - surface) / (stock.max[2] - stock.min[2])
        cells = np.rint(100 * (1 - removed)).astype(np.int8)
        return encode.map_bytes(stamp, WORKPIECE, thinning * stock.grid_step, stock.min, cells)
