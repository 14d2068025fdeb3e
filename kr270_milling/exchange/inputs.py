"""Checks of the messages that the nodes receive. The nodes and a recompute refuse the same messages."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from kr270_milling.base.errors import MessageError, MillingError
from kr270_milling.base.frames import TOOL, TOOL0, WORKPIECE, Pose, rotation_from_quaternion
from kr270_milling.base.samples import PoseSample, WrenchSample
from kr270_milling.cell.paths import MOST_STEPS
from kr270_milling.cell.sections import Workpiece
from kr270_milling.path.trajectory import Trajectory
from kr270_milling.physics.motion.periods import Clock
from kr270_milling.physics.robot.arm import Mount
from kr270_milling.physics.robot.loads import GRAVITY
from kr270_milling.physics.robot.sensor import ForceSensor, moved_wrench

Output = tuple[str, object]  #: topic, record


class ExchangeError(MillingError):
    """A message that does not fit the exchange; stamp_ns is its stamp."""

    def __init__(self, stamp_ns: int, reason: str):
        self.stamp_ns, self.reason = stamp_ns, reason
        super().__init__(f"stamp {stamp_ns * 1e-9:.6f} s: {reason}")


def checked_pose(sample: PoseSample) -> PoseSample:
    """Return the sample; raises MessageError unless it is a finite pose of tcp in the workpiece frame."""
    if sample.frame != WORKPIECE:
        raise MessageError(f"tool_pose: the frame is {sample.frame!r}, but must be {WORKPIECE}")
    quaternion = sample.quaternion.tolist()
    # 100 m for a coordinate of the tool; assumed: an arm with its cell is smaller
    _expect_finite(sample.position.tolist() + quaternion, "tool_pose", 100.0, "m")
    # the length of a quaternion of 32-bit floats differs far less from 1
    if not abs(math.hypot(*quaternion) - 1.0) <= 1e-3:
        raise MessageError("tool_pose: the quaternion is not of length 1")
    return sample


def checked_wrench(sample: WrenchSample, frames: Sequence[str] = (WORKPIECE, TOOL)) -> WrenchSample:
    """Return the sample; raises MessageError where its frame is none of ``frames``, or a value cannot be used."""
    if sample.frame not in frames:
        allowed = f"{', '.join(frames[:-1])} or {frames[-1]}"
        raise MessageError(f"wrench: the frame is {sample.frame!r}, but must be {allowed}")
    # assumed: a hundred times what the strongest milling robots carry
    _expect_finite(sample.wrench.tolist(), "wrench", 1e6, "N and N m")
    return sample


class WrenchFrames:
    """The frames in which the compensator takes a wrench, and the wrench at the tool tip in workpiece axes.

    workpiece, base, base_link: axes of the frame, taken at the tool tip. tcp, flange, tool0 and ``sensor.frame``: axes
    and origin of the frame. The readings of the sensor are tared.
    """

    def __init__(self, mount: Mount, workpiece: Workpiece, sensor: ForceSensor):
        flange = mount.pose.inverse()
        self._sensor = sensor
        # pose in tcp
        self._on_tool = {TOOL: Pose(np.zeros(3), np.eye(3)), "flange": flange, "tool0": flange @ TOOL0}
        base = workpiece.pose.rotation.T  # axes of the base in those of the workpiece
        self._fixed = {"base": base, "base_link": base}
        self._gravity = base @ [0.0, 0.0, -GRAVITY]
        if self._sensor.frame:
            self._on_tool[self._sensor.frame] = flange @ TOOL0 @ self._sensor.pose
        self.names = (WORKPIECE, *self._on_tool, *self._fixed)

    def untared(self, standing: Sequence[WrenchSample]) -> bool:
        """Return whether no reading of the sensor is among the wrenches before the start."""
        return bool(self._sensor.frame) and not any(sample.frame == self._sensor.frame for sample in standing)

    def offset(self, standing: Sequence[WrenchSample], quaternion: np.ndarray) -> np.ndarray:
        """Return the offset of the sensor (6,): its mean reading before the start minus the weight; 0 without one.

        quaternion: of tcp before the start, (4,).
        """
        readings = [sample.wrench for sample in standing if sample.frame == self._sensor.frame]
        if not readings:
            return np.zeros(6)
        return np.mean(readings, axis=0) - self._weight(self._pose(self._sensor.frame, quaternion))

    def at_tip(self, frame: str, wrench: np.ndarray, quaternion: np.ndarray, offset: np.ndarray) -> np.ndarray:
        """Return wrenches (n, 6) of one of these frames at the tool tip in workpiece axes.

        quaternion: of tcp, (n, 4); offset: of the sensor, (6,).
        """
        if frame in self._fixed:
            return moved_wrench(wrench, Pose(np.zeros(3), self._fixed[frame]))
        pose = self._pose(frame, quaternion)
        if frame == self._sensor.frame:
            wrench = wrench - offset - self._weight(pose)
        return moved_wrench(wrench, pose)

    def _pose(self, frame: str, quaternion: np.ndarray) -> Pose:
        """Return the pose of a frame on the tool, in axes of the workpiece at the tool tip."""
        return Pose(np.zeros(3), rotation_from_quaternion(quaternion)) @ self._on_tool[frame]

    def _weight(self, pose: Pose) -> np.ndarray:
        """Return the reading of the sensor (..., 6) under the weight alone."""
        return self._sensor.weight(np.einsum("...ji,j->...i", pose.rotation, self._gravity))


def checked_length(run: Trajectory, clock: Clock) -> Trajectory:
    """Return the trajectory; raises MessageError where a pass along it would have too many exchanges."""
    steps = clock.steps(run.duration_ns)
    if steps > MOST_STEPS:
        longest = MOST_STEPS * clock.period
        raise MessageError(f"trajectory: takes {run.duration_ns * 1e-9:g} s, but at most {longest:g} s are allowed")
    return run


def _expect_finite(values: list[float], topic: str, most: float, unit: str) -> None:
    """Raise MessageError unless all values are finite and no larger than ``most``."""
    if not (max(values) <= most and min(values) >= -most and not math.isnan(sum(values))):
        finite = all(map(math.isfinite, values))
        raise MessageError(
            f"{topic}: a value is beyond {most:g} {unit}" if finite else f"{topic}: a value is not finite"
        )
