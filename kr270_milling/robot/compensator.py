"""The gravity compensator: a spring between link 1 and link 2, which acts as a second spring of joint 2.

The spring is hinged to link 1 at A = (a_x, a_z), seen from axis 2 in the plane of the arm (x forward, z up), and to the
upper arm at B = L (cos q2, -sin q2), on the line from axis 2 to axis 3. Its length is

    s^2 = |B - A|^2 = a_x^2 + a_z^2 + L^2 - 2 L (a_x cos q2 - a_z sin q2),   ds/dq2 = L (a_x sin q2 + a_z cos q2) / s.

Its energy E = k (s - s_0)^2 / 2 depends on q2 alone, so the only joint that it loads is joint 2, with

    M_c = -dE/dq2 = -k (s - s_0) ds/dq2,
    dM_c/dq2 = -k [(ds/dq2)^2 + (s - s_0) d2s/dq2^2],   d2s/dq2^2 = [L (a_x cos q2 - a_z sin q2) - (ds/dq2)^2] / s.

With the joint's own spring K_2 this is the posture-dependent spring K_2 - dM_c/dq2 of [Klimchik2013b]: with a = |A|,
psi the angle at axis 2 between A and B, and eta = (s_0/s) (a L sin(psi)^2 / s^2 - cos(psi)) + cos(psi), the equivalent
spring of joint 2 is K_2 + k a L eta. The free length follows from the force F_0 that pulls in the spring where the
upper arm stands upright (q2 = -90 deg), its preload: s_0 = s(-90 deg) - F_0 / k.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kr270_milling.base.errors import ParameterError
from kr270_milling.base.record import Record, parameter

__all__ = ["Compensator", "NO_COMPENSATOR", "moment_slope"]

UPRIGHT = -np.pi / 2  #: q2 at which the preload is stated


@dataclass(frozen=True, eq=False)
class Compensator(Record):
    """YAML ``arm.compensator``; a stiffness of 0 stands for an arm without one."""

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
        """M_c on joint 2 [N m]."""
        if not self.present:
            return np.zeros_like(cosine)
        s = self.length(cosine, sine)
        slope = self.arm_length * (self.base_x * sine + self.base_z * cosine) / s
        return -self.stiffness * (s - self.free_length) * slope

    def moment_slope(self, cosine, sine):
        """dM_c/dq2 [N m/rad]."""
        if not self.present:
            return np.zeros_like(cosine)
        spring = (self.stiffness, self.free_length, self.base_x, self.base_z, self.arm_length)
        return moment_slope(spring, cosine, sine)


def moment_slope(spring, cosine, sine):
    """dM_c/dq2 [N m/rad]; spring: k, s_0, a_x, a_z, L. Plain arithmetic, so that batches of postures compile it."""
    k, s_0, a_x, a_z, length = spring
    s = np.sqrt(a_x**2 + a_z**2 + length**2 - 2 * length * (a_x * cosine - a_z * sine))
    slope = length * (a_x * sine + a_z * cosine) / s
    bend = (length * (a_x * cosine - a_z * sine) - slope**2) / s
    return -k * (slope**2 + (s - s_0) * bend)


#: an arm without one
NO_COMPENSATOR = Compensator()
