"""Messages of the exchange for tests that publish them by hand."""

from __future__ import annotations

import numpy as np
from ros_messages import to_msg

from kr270_milling.base.samples import PoseSample, WrenchSample


def pose_msg(stamp_ns: int, position, quaternion):
    return to_msg(PoseSample(int(stamp_ns), "workpiece", np.asarray(position, float), np.asarray(quaternion, float)))


def wrench_msg(stamp_ns: int, wrench):
    return to_msg(WrenchSample(int(stamp_ns), "workpiece", np.asarray(wrench, float)))
