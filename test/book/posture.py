"""The arm and the posture that the checks share."""

from __future__ import annotations

import functools

import numpy as np

from kr270_milling.base.record import find_file
from kr270_milling.physics.robot import Mount
from kr270_milling.physics.robot.analysis import read_arm

PAPER = np.radians([90.0, -50.0, 120.0, 180.0, 25.0, 180.0])  # [Klimchik2014], Table 1
SPINDLE = Mount(xyz=np.array([0.3, 0.0, 0.1]), mass=60.0, mass_centre=np.array([0.1, 0.03, 0.02]))


@functools.cache
def arm_of(name: str = "kr270_2.yaml"):
    return read_arm(find_file(name))[0]


def postures(n: int = 100) -> np.ndarray:
    """The same n postures (n, 6) [rad] within the limits, every time."""
    arm = arm_of()
    return np.random.default_rng(5).uniform(arm.joint_lower, arm.joint_upper, (n, 6))
