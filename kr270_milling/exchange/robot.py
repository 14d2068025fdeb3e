"""Protocol of the compliant robot: it predicts the tool pose, receives a wrench, corrects.

The robot node hands its messages to this object, and a recompute the recorded ones.
"""

from __future__ import annotations

import math

import numpy as np

from kr270_milling.base.frames import TOOL, WORKPIECE, Pose, rotation_from_quaternion
from kr270_milling.base.samples import ClockSample, JointSample, PoseSample, Text, TwistSample, WrenchSample
from kr270_milling.cell.cell import Cell
from kr270_milling.cell.models import arm_of, path_of
from kr270_milling.cell.plant import imperfect_arm, imperfect_course
from kr270_milling.exchange.inputs import ExchangeError, Output, checked_length, checked_wrench
from kr270_milling.path.trajectory import Trajectory
from kr270_milling.physics.motion.milling_pass import CompliantArm
from kr270_milling.physics.robot.sensor import moved_wrench
from kr270_milling.physics.robot.urdf import urdf


class RobotProtocol:
    """Reference trajectory and wrench in; tool_pose, deflection, joint_states and, on request, clock out."""

    def __init__(self, cell: Cell):
        self.cell = cell
        self.reference: Trajectory | None = None  #: reference of the next pass
        self.passes = 0  #: completed passes
        self.started = False  #: a pass runs, or has run to its end
        self.finished = False  #: the pass has run to its end
        self.steps = 0  #: exchange periods of the pass
        self.start_ns = 0  #: stamp of the first exchange of the pass, as the reference states it
        self.awaited_ns = 0  #: stamp of the next wrench
        self.correction = 0.0  #: [m], largest distance between corrected and predicted tool centre in this pass
        self._iterations = cell.exchange.iterations
        self._every = cell.publish.steps(cell.exchange)
        self._clock_every = cell.exchange.steps_of(0.01)  # [s] of the pass, at least

    def describe(self) -> list[Output]:
        """Return the URDF for viewers."""
        cell = self.cell
        text = urdf(cell.arm, cell.mount, cell.tool.radius, cell.workpiece.pose, cell.joint_names)
        return [("robot_description", Text(text))]

    def start(self) -> list[Output]:
        """Begin a pass along ``reference``. Raises ExchangeError where there is none."""
        cell, reference = self.cell, self.reference
        if reference is None:
            raise ExchangeError(0, "a pass needs a reference trajectory")
        checked_length(reference, path_of(cell).clock)
        planned = imperfect_course(cell, reference, self.passes)
        model = imperfect_arm(cell, reference)
        self.steps = path_of(cell).clock.steps(planned.duration_ns)
        stamps = path_of(cell).clock.stamp(np.arange(self.steps + 1))
        self.start_ns = reference.start_ns
        # a list gives an item in a tenth of the time of an array
        self._stamps: list[int] = (stamps + self.start_ns).tolist()
        self._unloaded = planned.sample(stamps)  # [m], (steps + 1, 3)
        self._orientation = planned.sample_orientation(stamps)  # (steps + 1, 4)
        # the encoders are at the motors
        self._joints = arm_of(cell).joints_along(reference, stamps[:: self._every])
        self._arm = CompliantArm(model, model.push(planned, stamps))
        self._tool = self._unloaded[0]  # predicted tool centre [m], (3,)
        self._step = 0  # whose wrench is awaited
        self._iteration = 0
        self.awaited_ns = self.start_ns
        self.correction = 0.0
        self.started, self.finished = True, False
        return [self._question()]

    def stop(self) -> None:
        """End the pass."""
        self.started = self.finished = False

    @property
    def large_correction(self) -> bool:
        """Return whether the largest correction exceeds its limit, a share of the feed per tooth."""
        if not self.started or self.reference is None:
            return False
        feed = float(np.max(self.reference.feed(self.reference.time_ns)))
        tooth_rate = self.cell.tool.spindle_speed / (2 * math.pi) * self.cell.tool.teeth
        return self.correction > self.cell.exchange.warn_correction * feed / tooth_rate

    @property
    def time_ns(self) -> int:
        """Time of the awaited wrench, counted from the start of the pass; 0 before the first wrench."""
        return self.awaited_ns - self.start_ns

    def wrench(self, sample: WrenchSample) -> list[Output]:
        """Take an answer. An answer with another stamp than the awaited one is ignored; raises MessageError."""
        if not self.started or self.finished:
            return []
        checked_wrench(sample)
        if sample.stamp != self.awaited_ns:
            return []
        wrench = sample.wrench
        if sample.frame == TOOL:
            rotation = rotation_from_quaternion(self._orientation[self._step])
            wrench = moved_wrench(wrench, Pose(np.zeros(3), rotation))
        if self._step > 0 and self._iteration + 1 < self._iterations:
            self._iteration += 1
            self._tool = self._unloaded[self._step] + self._arm.predict(wrench)[:3]
            return [self._question()]
        step, deflection = self._step, np.zeros(6)  # the pass starts at rest, without load
        if step > 0:
            deflection = self._arm.correct(wrench)
            x, y, z = (self._unloaded[step] + deflection[:3] - self._tool).tolist()
            self.correction = max(self.correction, math.sqrt(x * x + y * y + z * z))
        self._step, self._iteration = step + 1, 0
        if step == self.steps:
            self.finished = True
            self.passes += 1
            return self._state(step, sample.stamp, deflection)
        self.awaited_ns = self._stamps[self._step]
        self._tool = self._unloaded[self._step] + self._arm.predict()[:3]
        # the tool pose comes first, so that the cut works while the other messages are published
        return [self._question(), *self._state(step, sample.stamp, deflection)]

    def _question(self) -> Output:
        return "tool_pose", PoseSample(self.awaited_ns, WORKPIECE, self._tool, self._orientation[self._step])

    def _state(self, step: int, stamp_ns: int, deflection: np.ndarray) -> list[Output]:
        outputs: list[Output] = []
        if step % self._every == 0:
            outputs.append(("deflection", TwistSample(stamp_ns, WORKPIECE, deflection)))
            joints = self._joints[step // self._every]
            outputs.append(("joint_states", JointSample(stamp_ns, self.cell.joint_names, joints)))
        if self.cell.publish.clock and step % self._clock_every == 0:
            outputs.append(("clock", ClockSample(stamp_ns)))
        return outputs
