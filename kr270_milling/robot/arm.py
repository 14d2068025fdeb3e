"""The arm and what is mounted on its flange, as parameter records.

[KUKA signs] A1 turns about -z, A2 and A3 about +y, A4 about -x, A5 about +y, A6 about -x; at zero the arm is stretched
horizontally forward. The chain from ``base_link`` to ``flange``::

    T(0,0,d1) Rz(-q1) T(a1,0,0) Ry(q2) T(a2,0,0) Ry(q3) T(0,0,a3) Rx(-q4) T(d4,0,0) Ry(q5) T(d6,0,0) Rx(-q6)
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import numpy as np

from kr270_milling.base.errors import ParameterError
from kr270_milling.base.frames import Pose
from kr270_milling.base.record import Record, parameter
from kr270_milling.robot.compensator import NO_COMPENSATOR, Compensator

__all__ = ["Arm", "Mount", "BARE", "AXES"]

#: direction of each joint axis in the frame of the link that it turns, (6, 3)
AXES = np.array([[0, 0, -1], [0, 1, 0], [0, 1, 0], [-1, 0, 0], [0, 1, 0], [-1, 0, 0]], float)
AXES.setflags(write=False)


@dataclass(frozen=True, eq=False)
class Arm(Record):
    """A six-joint arm with a KUKA spherical wrist: geometry, limits, joint springs, link masses."""

    name: str = parameter(text="name of the arm")
    d1: float = parameter(unit="m", text="height of axis 2 over the base", low=-10.0, high=10.0)
    a1: float = parameter(unit="m", text="distance of axis 2 from axis 1", low=-10.0, high=10.0)
    a2: float = parameter(unit="m", text="length of the upper arm, axis 2 to axis 3", above=0.0, high=10.0)
    a3: float = parameter(unit="m", text="offset of axis 4 from axis 3, up in the stretched arm", low=-10.0, high=10.0)
    d4: float = parameter(unit="m", text="axis 3 to wrist centre, along axis 4", above=0.0, high=10.0)
    d6: float = parameter(unit="m", text="wrist centre to flange", low=0.0, high=10.0)
    joint_lower: np.ndarray = parameter(unit="deg", text="lower joint limits", low=-720.0, high=720.0, size=6)
    joint_upper: np.ndarray = parameter(unit="deg", text="upper joint limits", low=-720.0, high=720.0, size=6)
    joint_speed_limit: np.ndarray = parameter(unit="deg_per_s", text="joint speed limits", above=0.0, size=6)
    joint_acceleration_limit: np.ndarray = parameter(
        unit="deg_per_s2", text="joint acceleration limits", above=0.0, size=6
    )
    joint_compliance: np.ndarray = parameter(
        unit="urad_per_n_m", text="compliance of the virtual spring of each joint", above=0.0, size=6
    )
    link_mass: np.ndarray = parameter(unit="kg", text="mass of link j, moved by joint j", low=0.0, size=6)
    link_mass_centre: np.ndarray = parameter(
        text="centre of mass of each link as a share of its length, from the base side", low=0.0, high=1.0, size=6
    )
    link_section_radius: np.ndarray = parameter(
        unit="mm", text="radius of each link seen as a thin tube, for the rotary inertia of its sections", low=0.0,
        high=2000.0, size=6,
    )  # fmt: skip
    compensator: Compensator = NO_COMPENSATOR

    def check(self):
        if not np.all(self.joint_lower < self.joint_upper):
            shown = [math.degrees(value) for value in self.joint_upper]
            raise ParameterError("joint_upper_deg", shown, "above joint_lower_deg for every joint")

    @functools.cached_property
    def joint_stiffness(self) -> np.ndarray:
        """Diagonal of K_theta [N m/rad], (6,)."""
        return 1.0 / self.joint_compliance

    @functools.cached_property
    def link_vectors(self) -> np.ndarray:
        """From node O_(j-1) to node O_j in the frame of link j [m], (6, 3); link 5 has no length."""
        return np.array([[self.a1, 0, self.d1], [self.a2, 0, 0], [0, 0, self.a3], [self.d4, 0, 0], [0, 0, 0],
                         [self.d6, 0, 0]])  # fmt: skip

    @property
    def forearm(self) -> float:
        """From axis 3 to the wrist centre [m]."""
        return math.hypot(self.d4, self.a3)

    @property
    def elbow_offset(self) -> float:
        """The angle A3 [rad] at which the arm is stretched."""
        return math.atan2(self.a3, self.d4)


@dataclass(frozen=True, eq=False)
class Mount(Record):
    """Spindle and tool on the flange: where ``tool0`` is in ``flange``, and a rigid mass."""

    xyz: np.ndarray = parameter([0.0, 0.0, 0.0], unit="mm", text="tool tip in the flange frame", size=3,
                                low=-5000.0, high=5000.0)  # fmt: skip
    abc: np.ndarray = parameter([0.0, math.pi / 2, 0.0], unit="deg", size=3, low=-360.0, high=360.0, text="A, B, C of "
                                "tool0 in the flange frame; 0, 90, 0: spindle in line with axis 6")  # fmt: skip
    mass: float = parameter(0.0, unit="kg", text="mass of spindle and tool", low=0.0, high=5000.0)
    mass_centre: np.ndarray = parameter([0.0, 0.0, 0.0], unit="mm", text="its centre in the flange frame", size=3,
                                        low=-5000.0, high=5000.0)  # fmt: skip
    inertia: np.ndarray = parameter([0.0, 0.0, 0.0], unit="kg_m2", size=3, low=0.0, high=1e4, text="its moments of "
                                    "inertia about that centre, axes of the flange; for rigid masses")  # fmt: skip

    def check(self):
        if 2.0 * self.inertia.max() > self.inertia.sum() * (1 + 1e-9):
            shown = self.inertia.tolist()
            raise ParameterError("inertia_kg_m2", shown, "three moments of which none is larger than the others' sum")

    @functools.cached_property
    def pose(self) -> Pose:
        """Maps tool0 coordinates to flange coordinates."""
        return Pose.from_abc(self.xyz, self.abc)


#: nothing on the flange: the tool point is the flange, with the flange's axes
BARE = Mount(abc=np.zeros(3))
