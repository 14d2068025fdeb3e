"""Checks of the messages that the nodes receive. The nodes and a recompute refuse the same messages."""

from __future__ import annotations

import math

import numpy as np

from kr270_milling.base.errors import MessageError, MillingError
from kr270_milling.base.frames import TOOL, WORKPIECE, rotation_from_quaternion
from kr270_milling.base.samples import PoseSample, WrenchSample

__all__ = ["ExchangeError", "Output", "checked_pose", "checked_wrench", "in_workpiece_axes"]

Output = tuple[str, object]  #: topic, record

UNIT_LENGTH = 1e-3  #: allowed difference of a quaternion's length from 1: a quaternion of 32-bit floats is far below it


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
    _expect_finite(sample.position.tolist() + quaternion, "tool_pose")
    if not abs(math.hypot(*quaternion) - 1.0) <= UNIT_LENGTH:
        raise MessageError("tool_pose: the quaternion is not of length 1")
    return sample


def checked_wrench(sample: WrenchSample) -> WrenchSample:
    """Return the sample; raises MessageError where its frame or a value cannot be used."""
    if sample.frame not in (WORKPIECE, TOOL):
        raise MessageError(f"wrench: the frame is {sample.frame!r}, but must be {WORKPIECE} or {TOOL}")
    _expect_finite(sample.wrench.tolist(), "wrench")
    return sample


def in_workpiece_axes(sample: WrenchSample, quaternion: np.ndarray) -> np.ndarray:
    """Return the wrench (6,) in workpiece axes; a force sensor may publish it in the axes of tcp.

    F_workpiece = R F_tool and M_workpiece = R M_tool: both are taken at the tool tip. quaternion: of tcp, (4,).
    """
    wrench = sample.wrench
    if sample.frame == WORKPIECE:
        return wrench
    rotation_tool_to_workpiece = rotation_from_quaternion(quaternion)
    return np.concatenate([rotation_tool_to_workpiece @ wrench[:3], rotation_tool_to_workpiece @ wrench[3:]])


def _expect_finite(values: list[float], topic: str) -> None:
    if not math.isfinite(sum(values)) and not all(map(math.isfinite, values)):  # the sum of finite values may overflow
        raise MessageError(f"{topic}: a value is not finite")
