"""The arm, its gravity compensator and what is mounted on its flange, as parameter records.

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
from kr270_milling.base.record import Record, parameter, section

#: direction of each joint axis in the frame of the link that it turns, (6, 3)
AXES = np.array([[0, 0, -1], [0, 1, 0], [0, 1, 0], [-1, 0, 0], [0, 1, 0], [-1, 0, 0]], float)
AXES.setflags(write=False)


#: [rad]; 3e-5: KUKA KR 300 R2500, JonasWeigand/Robot_Identification (A1 to A3); assumed: the same for A4 to A6
ASSUMED_BACKLASH = np.full(6, 6.2 * math.pi / 648000)


@dataclass(frozen=True, eq=False)
class GravityCompensator(Record):
    """YAML ``arm.compensator``: a spring between links 1 and 2, a second spring of joint 2; stiffness 0: there is none.

    It is hinged to link 1 at A = (a_x, a_z), seen from axis 2 in the plane of the arm (x forward, z up), and to the
    upper arm at B = L (cos q2, -sin q2), on the line from axis 2 to axis 3. Its length is

        s^2 = |B - A|^2 = a_x^2 + a_z^2 + L^2 - 2 L (a_x cos q2 - a_z sin q2),   ds/dq2 = L (a_x sin q2 + a_z cos q2)/s.

    Its energy E = k (s - s_0)^2 / 2 depends on q2 alone, so the only joint that it loads is joint 2, with

        M_c = -dE/dq2 = -k (s - s_0) ds/dq2,
        dM_c/dq2 = -k [(ds/dq2)^2 + (s - s_0) d2s/dq2^2],   d2s/dq2^2 = [L (a_x cos q2 - a_z sin q2) - (ds/dq2)^2] / s.

    With the joint's own spring K_2 this is the posture-dependent spring K_2 - dM_c/dq2 of [Klimchik2013b]: with
    a = |A|, psi the angle at axis 2 between A and B, and eta = (s_0/s) (a L sin(psi)^2 / s^2 - cos(psi)) + cos(psi),
    the equivalent spring of joint 2 is K_2 + k a L eta. The free length follows from the force F_0 that pulls in the
    spring where the upper arm is upright (q2 = -90 deg), its preload: s_0 = s(-90 deg) - F_0 / k.
    """

    stiffness: float = parameter(0.0, unit="n_per_mm", low=0.0, high=1e5, text="k of the spring; 0: no compensator")
    preload: float = parameter(0.0, unit="n", low=-1e6, high=1e6, text="pull of the spring with the upper arm upright")
    base_x: float = parameter(
        -0.3, unit="mm", low=-3000.0, high=3000.0, text="a_x, its hinge on link 1 in front of axis 2"
    )
    base_z: float = parameter(0.1, unit="mm", low=-3000.0, high=3000.0, text="a_z, its hinge on link 1 above axis 2")
    arm_length: float = parameter(
        0.15, unit="mm", above=0.0, high=3000.0, text="L, from axis 2 to its hinge on the upper arm, toward axis 3"
    )

    def check(self) -> None:
        if not abs(np.hypot(self.base_x, self.base_z) - self.arm_length) > 1e-3:
            allowed = "a hinge farther from axis 2, or nearer, than arm_length_mm, so that the spring keeps a length"
            raise ParameterError("base_x_mm", 1e3 * self.base_x, allowed)

    @property
    def present(self) -> bool:
        return self.stiffness > 0.0

    def length(self, cosine, sine):
        """s [m] from cosine and sine of q2."""
        across = self.base_x**2 + self.base_z**2 + self.arm_length**2
        return np.sqrt(across - 2 * self.arm_length * (self.base_x * cosine - self.base_z * sine))

    @property
    def free_length(self) -> float:
        """s_0 [m]; negative for a strong preload, as a gas spring has it."""
        return float(self.length(0.0, -1.0)) - self.preload / self.stiffness

    def moment(self, cosine, sine):
        """M_c on joint 2 [N m], of a spring that is present."""
        s = self.length(cosine, sine)
        slope = self.arm_length * (self.base_x * sine + self.base_z * cosine) / s
        return -self.stiffness * (s - self.free_length) * slope

    @property
    def numbers(self) -> tuple[float, ...]:
        """k, s_0, a_x, a_z, L."""
        return self.stiffness, self.free_length, self.base_x, self.base_z, self.arm_length

    def moment_slope(self, cosine, sine):
        """dM_c/dq2 [N m/rad]; 0 without a spring."""
        return moment_slope(self.numbers, cosine, sine) if self.present else np.zeros_like(cosine)


def moment_slope(spring, cosine, sine):
    """dM_c/dq2 [N m/rad]; spring: ``Compensator.numbers``. Plain arithmetic, so that batches of postures compile it."""
    k, s_0, a_x, a_z, length = spring
    s = np.sqrt(a_x**2 + a_z**2 + length**2 - 2 * length * (a_x * cosine - a_z * sine))
    slope = length * (a_x * sine + a_z * cosine) / s
    bend = (length * (a_x * cosine - a_z * sine) - slope**2) / s
    return -k * (slope**2 + (s - s_0) * bend)


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
    joint_speed_limit: np.ndarray = parameter(unit="deg_per_s", text="joint speed limits", low=0.01, size=6)
    joint_acceleration_limit: np.ndarray = parameter(
        unit="deg_per_s2", text="joint acceleration limits", low=0.01, size=6
    )
    joint_compliance: np.ndarray = parameter(
        unit="urad_per_n_m", text="compliance of the virtual spring of each joint", above=0.0, size=6
    )
    link_mass: np.ndarray = parameter(unit="kg", text="mass of link j, moved by joint j", low=0.0, size=6)
    link_mass_centre: np.ndarray = parameter(
        text="centre of mass of each link as a share of its length, from the base side", low=0.0, high=1.0, size=6
    )
    link_section_radius: np.ndarray = parameter(
        unit="mm",
        text="radius of each link seen as a thin tube, for the rotary inertia of its sections",
        low=0.0,
        high=2000.0,
        size=6,
    )
    base_compliance: np.ndarray = parameter(
        np.zeros(3),
        unit="urad_per_n_m",
        low=0.0,
        high=1e4,
        size=3,
        text="compliance of the ground: three springs that let base_link turn about its x, y, z; 0: rigid",
    )
    backlash: np.ndarray = parameter(
        ASSUMED_BACKLASH,
        unit="arcsec",
        size=6,
        low=0.0,
        high=18000.0,
        text="backlash of each joint, between its two flanks",
    )
    # the whole drive of the KR 300 of that model: 188, 490, 470, 99, 99, 57 N m (motor friction times gear ratio);
    # assumed: half of it acts on the link's side, where it holds the link while the load reverses
    friction_torque: np.ndarray = parameter(
        [94.0, 245.0, 235.0, 49.0, 49.0, 29.0],
        unit="n_m",
        size=6,
        low=0.0,
        high=1e5,
        text="friction torque of each joint on the link's side; a smaller load leaves the link on its flank",
    )
    payload: float = parameter(0.0, unit="kg", low=0.0, high=5000.0, text="most that the flange carries; 0: not known")
    compensator: GravityCompensator = section(GravityCompensator)

    def check(self):
        if not np.all(self.joint_lower < self.joint_upper):
            shown = [math.degrees(value) for value in self.joint_upper]
            raise ParameterError("joint_upper_deg", shown, "above joint_lower_deg for every joint")
        if self.link_mass.sum() < 1.0:
            raise ParameterError("link_mass_kg", self.link_mass.tolist(), "1 kg at least in all")

    @functools.cached_property
    def base_axes(self) -> np.ndarray:
        """Axes of base_link, 0 to 2, about which the ground is compliant, (k,)."""
        return np.flatnonzero(self.base_compliance)

    @functools.cached_property
    def spring_compliance(self) -> np.ndarray:
        """Compliances of the k springs under the base, then of the joints [rad/(N m)], (k + 6,)."""
        return np.concatenate([self.base_compliance[self.base_axes], self.joint_compliance])

    @functools.cached_property
    def spring_stiffness(self) -> np.ndarray:
        """Diagonal of K_theta, with the k springs under the base before the joints [N m/rad], (k + 6,)."""
        return 1.0 / self.spring_compliance

    def on_base(self, q) -> np.ndarray:
        """Postures (..., k + 6) on an untilted base from joint positions q [rad], (..., 6)."""
        q = np.asarray(q, float)
        return np.concatenate([np.zeros(q.shape[:-1] + (self.base_axes.size,)), q], -1)

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
    """Spindle and tool on the flange: where ``tcp`` is in ``flange``, and a rigid mass."""

    xyz: np.ndarray = parameter(
        [0.0, 0.0, 0.0],
        unit="mm",
        text="tool tip in the flange frame; or tool_kuka: TOOL_DATA",
        size=3,
        low=-5000.0,
        high=5000.0,
    )
    abc: np.ndarray = parameter(
        [0.0, math.pi / 2, 0.0],
        unit="deg",
        size=3,
        low=-360.0,
        high=360.0,
        text="A, B, C of tcp in the flange frame; 0, 90, 0: spindle in line with axis 6",
    )
    mass: float = parameter(0.0, unit="kg", text="mass of spindle and tool", low=0.0, high=5000.0)
    mass_centre: np.ndarray = parameter(
        [0.0, 0.0, 0.0], unit="mm", text="centre of this mass in the flange frame", size=3, low=-5000.0, high=5000.0
    )
    inertia: np.ndarray = parameter(
        [0.0, 0.0, 0.0],
        unit="kg_m2",
        size=3,
        low=0.0,
        high=1e4,
        text="moments of inertia of this mass about its centre, axes of the flange; for rigid masses",
    )

    def check(self):
        if 2.0 * self.inertia.max() > self.inertia.sum() * (1 + 1e-9):
            shown = self.inertia.tolist()
            raise ParameterError("inertia_kg_m2", shown, "three moments of which none is larger than the others' sum")

    @functools.cached_property
    def pose(self) -> Pose:
        """Maps tcp coordinates to flange coordinates."""
        return Pose.from_abc(self.xyz, self.abc)


#: nothing on the flange: the tool point is the flange, with the flange's axes
BARE = Mount(abc=np.zeros(3))
