"""What the nodes of robot and cut do between in and out: records in, (topic, record) out, time from the stamps.

A node hands its messages to such an object, and a recompute the recorded ones: there is no second transcription.
A pose or wrench whose frame or values cannot be used is refused, live and recomputed alike.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from kr270_milling.base.errors import MillingError
from kr270_milling.base.frames import rotation_from_quaternion
from kr270_milling.base.samples import ClockSample, JointSample, PoseSample, StockMap, Text, TwistSample, WrenchSample
from kr270_milling.cutting import Cut, Stock
from kr270_milling.simulation.dynamics import ArmModel
from kr270_milling.simulation.exchange import Clock
from kr270_milling.simulation.sides import CuttingSide, ExchangeError, RobotSide
from kr270_milling.trajectory.trajectory import Trajectory

__all__ = [
    "JOINT_NAMES", "TOOL", "WORKPIECE", "CutProtocol", "MessageError", "NoWorkpiece", "Output", "RobotModels",
    "RobotProtocol", "checked_pose", "checked_wrench", "in_workpiece_axes",
]  # fmt: skip

JOINT_NAMES = tuple(f"joint_a{i}" for i in range(1, 7))
Output = tuple[str, object]  #: topic, record

TOOL = "tool0"
WORKPIECE = "workpiece"
MAP_STEP = 0.2e-3  # [m], of the published workpiece map
UNIT_LENGTH = 1e-3  #: allowed difference of a quaternion's length from 1: a quaternion of 32-bit floats is far below it


class MessageError(MillingError):
    """A message that cannot be used; it is reported and dropped."""


def checked_pose(sample: PoseSample) -> PoseSample:
    """The sample itself; raises MessageError where it is no finite pose of tool0 in the workpiece frame."""
    if sample.frame != WORKPIECE:
        raise MessageError(f"tool_pose: the frame is {sample.frame!r}, but must be {WORKPIECE}")
    quaternion = sample.quaternion.tolist()
    _expect_finite(sample.position.tolist() + quaternion, "tool_pose")
    if not abs(math.hypot(*quaternion) - 1.0) <= UNIT_LENGTH:
        raise MessageError("tool_pose: the quaternion is not of length 1")
    return sample


def checked_wrench(sample: WrenchSample) -> WrenchSample:
    """The sample itself; raises MessageError where its frame or a value cannot be used."""
    if sample.frame not in (WORKPIECE, TOOL):
        raise MessageError(f"wrench: the frame is {sample.frame!r}, but must be {WORKPIECE} or {TOOL}")
    _expect_finite(sample.wrench.tolist(), "wrench")
    return sample


def in_workpiece_axes(sample: WrenchSample, quaternion: np.ndarray) -> np.ndarray:
    """The wrench (6,) in workpiece axes; a force sensor may give it in those of tool0, whose quaternion (4,) is given.

    F_workpiece = R F_tool and M_workpiece = R M_tool: both are taken at the tool tip.
    """
    wrench = sample.wrench
    if sample.frame == WORKPIECE:
        return wrench
    rotation_tool_to_workpiece = rotation_from_quaternion(quaternion)
    return np.concatenate([rotation_tool_to_workpiece @ wrench[:3], rotation_tool_to_workpiece @ wrench[3:]])


def _expect_finite(values: list[float], topic: str) -> None:
    if not math.isfinite(sum(values)) and not all(map(math.isfinite, values)):  # finite ones may have an infinite sum
        raise MessageError(f"{topic}: holds a value that is not finite")


class NoWorkpiece(MillingError):
    """The cutting process is not configured."""

    def __init__(self):
        super().__init__("no workpiece yet: configure first")


@dataclass(frozen=True, eq=False)
class RobotModels:
    """What the robot's protocol needs of its cell."""

    clock: Clock
    iterations: int  #: exchanges a period
    deflection_every: int  #: exchange periods from one to the next
    joints_every: int
    clock_every: int
    arm_model: Callable[[Trajectory], ArmModel]
    course: Callable[[Trajectory, int], Trajectory]  #: reference, number of the pass -> where the motors take the tool
    joints_along: Callable[[Trajectory, np.ndarray], np.ndarray]  #: reference, stamps (n,) [ns] -> (n, 6) [rad]
    description: str  #: URDF
    warn_correction: float  #: share of the feed per tooth above which a correction is large
    tooth_rate: float  #: teeth that pass in a second [1/s]


class RobotProtocol:
    """Reference trajectory and wrench in; tool_pose, deflection, joint_states and clock out."""

    def __init__(self, models: RobotModels):
        self.models = models
        self.reference: Trajectory | None = None  #: that the next pass runs
        self.side: RobotSide | None = None  #: of the pass under way, or of the last one
        self.passes = 0  #: that ran to their end
        self._asked = 0  # questions since the last answer
        self._stale = 0  # answers to come for questions that were asked twice

    def describe(self) -> list[Output]:
        """The robot for viewers."""
        return [("robot_description", Text(self.models.description))]

    def start(self) -> list[Output]:
        """Begin a pass along ``reference``."""
        models, reference = self.models, self.reference
        if reference is None:
            raise ExchangeError(0, "a pass needs a reference trajectory")
        course = models.course(reference, self.passes)
        side = RobotSide(models.arm_model(reference), models.clock, course, models.iterations)
        stamps = side.stamps[:: models.joints_every]  # the encoders stand on the motors' side
        self._joints = models.joints_along(reference, stamps)
        self.side = side
        self._step = 0
        self._asked = 0
        self._stale = 0
        return [self._question()]

    def stop(self) -> None:
        """End the pass."""
        self.side = None

    @property
    def done(self) -> bool:
        """Whether the last pass ran to its end."""
        return self.side is not None and self.side.done

    @property
    def large_correction(self) -> bool:
        """Whether the pass corrected its predictions by more than the stated share of the feed per tooth."""
        side, reference = self.side, self.reference
        if side is None or reference is None:
            return False
        feed = float(np.max(reference.feed(reference.time_ns)))
        return side.correction > self.models.warn_correction * feed / self.models.tooth_rate

    def repeat(self) -> list[Output]:
        """The last tool_pose once more; only one of the answers to it will be taken."""
        return [self._question()]

    def wrench(self, sample: WrenchSample) -> list[Output]:
        """Take an answer. One with another stamp than the awaited one is ignored; raises MessageError."""
        side = self.side
        if side is None or side.done:
            return []
        checked_wrench(sample)
        stamp_ns = sample.stamp
        if stamp_ns != side.awaited_ns:
            return []
        if self._stale:
            self._stale -= 1
            return []
        self._stale = self._asked - 1
        self._asked = 0
        deflection = side.answer(stamp_ns, in_workpiece_axes(sample, side.orientation_now))
        if side.done:
            self.passes += 1
            return self._state(stamp_ns, deflection)
        if side.awaited_ns != stamp_ns:
            self._stale = 0
        outputs = [self._question()]  # first, so that the cut works while the rest is published
        return outputs if deflection is None else outputs + self._state(stamp_ns, deflection)

    def of_pass(self) -> RobotSide:
        """The robot of the pass under way, or of the last one. Raises ExchangeError before the first."""
        if self.side is None:
            raise ExchangeError(0, "no pass has begun")
        return self.side

    def _question(self) -> Output:
        side = self.of_pass()
        self._asked += 1
        return "tool_pose", PoseSample(side.awaited_ns, WORKPIECE, side.tool, side.orientation_now)

    def _state(self, stamp_ns: int, deflection: np.ndarray) -> list[Output]:
        outputs: list[Output] = []
        step, models = self._step, self.models
        if step % models.deflection_every == 0:
            outputs.append(("deflection", TwistSample(stamp_ns, WORKPIECE, deflection)))
        if step % models.joints_every == 0:
            outputs.append(
                ("joint_states", JointSample(stamp_ns, JOINT_NAMES, self._joints[step // models.joints_every]))
            )
        if step % models.clock_every == 0:
            outputs.append(("clock", ClockSample(stamp_ns)))
        self._step += 1
        return outputs


class CutProtocol:
    """tool_pose in; wrench and workpiece out. A pass needs a fresh workpiece: ``configure``."""

    def __init__(self, clock: Clock, stock: Stock, fresh: Callable[[], Cut]):
        self._clock = clock
        self._stock = stock
        self._fresh = fresh
        self.side: CuttingSide | None = None
        self.stamp_ns = 0  #: of the last answer
        self.end_ns = 0  #: of the reference trajectory, if one is known

    def configure(self) -> list[Output]:
        """A fresh workpiece; its map, so that nobody who comes now takes the last part for this one."""
        cut = self._fresh()
        cut.touch()
        self.side = CuttingSide(cut, self._clock)
        self.stamp_ns = 0
        return self.workpiece()

    def release(self) -> None:
        """The workpiece goes."""
        self.side = None

    @property
    def step(self) -> int:
        """The last exchange that was answered; -1 before the first one."""
        return -1 if self.side is None else self.side.step

    @property
    def under_way(self) -> bool:
        """Whether a pass has begun and has not come to the end of the reference trajectory."""
        return self.side is not None and self.side.step >= 0 and self.stamp_ns < self.end_ns

    @property
    def at_end(self) -> bool:
        """Whether the pass has come to the end of the reference trajectory."""
        return self.side is not None and self.side.step > 0 and not self.under_way

    def pose(self, sample: PoseSample) -> list[Output]:
        """Answer a tool_pose; raises MessageError, ExchangeError, NoWorkpiece where it is refused."""
        checked_pose(sample)
        if self.side is None:
            raise NoWorkpiece
        wrench = self.side.answer(sample.stamp, sample.position)
        self.stamp_ns = sample.stamp
        return [("wrench", WrenchSample(sample.stamp, WORKPIECE, wrench))]

    def workpiece(self) -> list[Output]:
        """The map of the part as it is behind the last answer; raises NoWorkpiece."""
        if self.side is None:
            raise NoWorkpiece
        stock = self._stock
        thinning = max(1, round(MAP_STEP / stock.grid_step))
        _, _, surface = self.side.cut.heights(thinning=thinning)
        removed = (stock.max[2] - surface) / (stock.max[2] - stock.min[2])
        left = np.rint(100 * (1 - removed)).astype(np.int8)
        resolution = float(np.float32(thinning * stock.grid_step))  # the message has 32 bits for it
        return [("workpiece", StockMap(self.stamp_ns, WORKPIECE, resolution, stock.min, left))]
