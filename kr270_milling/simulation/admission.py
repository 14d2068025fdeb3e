"""Which poses and wrenches a protocol takes: their frame and their values; live and recomputed alike."""

from __future__ import annotations

import math

import numpy as np

from kr270_milling.base.errors import MillingError
from kr270_milling.base.frames import rotation_from_quaternion
from kr270_milling.base.samples import PoseSample, WrenchSample

__all__ = ["TOOL", "WORKPIECE", "MessageError", "checked_pose", "checked_wrench", "in_workpiece_axes"]

TOOL = "tool0"
WORKPIECE = "workpiece"
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
