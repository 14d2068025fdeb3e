"""Messages of the exchange for tests that publish them by hand."""

from __future__ import annotations

from kr270_milling.base.samples import PoseSample, WrenchSample
from kr270_milling.ros.messages import to_msg


def pose_msg(stamp_ns: int, position, quaternion):
    return to_msg(PoseSample(int(stamp_ns), "workpiece", position, quaternion))


def wrench_msg(stamp_ns: int, wrench):
    return to_msg(WrenchSample(int(stamp_ns), "workpiece", wrench))
