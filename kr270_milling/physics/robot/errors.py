"""Errors of an arm; every error carries the numbers of its sentence.

``index`` is the place in the batch of postures or poses, () for a single one.
"""

from __future__ import annotations

import math

from kr270_milling.base.errors import MillingError


def _place(index) -> str:
    return f" (pose {', '.join(str(i) for i in index)})" if index else ""


class ReachError(MillingError):
    """The wrist centre is too far from axis 2 or too near to it; distance [m], reach = (least, largest) [m]."""

    def __init__(self, distance: float, reach: tuple[float, float], index: tuple = ()):
        self.distance, self.reach, self.index = distance, reach, index
        super().__init__(
            f"the wrist centre would be {distance:.4f} m from axis 2, but the arm reaches from {reach[0]:.4f} m "
            f"to {reach[1]:.4f} m{_place(index)}"
        )


class JointLimitError(MillingError):
    """A joint would leave its range; joint counts from 1, angle and limits [rad]."""

    def __init__(self, joint: int, angle: float, limits: tuple[float, float], index: tuple = ()):
        self.joint, self.angle, self.limits, self.index = joint, angle, limits, index
        low, high = (math.degrees(limit) for limit in limits)
        super().__init__(
            f"joint {joint} would be at {math.degrees(angle):.3f} deg, but must stay within {low:g} to {high:g} deg"
            f"{_place(index)}"
        )


class SingularityError(MillingError):
    """The Jacobian has lost rank; which is "shoulder", "elbow" or "wrist", measure is 0 at the singularity."""

    def __init__(self, which: str, measure: float, index: tuple = ()):
        self.which, self.measure, self.index = which, measure, index
        cure = {
            "shoulder": "keep the wrist centre away from axis 1",
            "elbow": "keep the arm away from its stretched posture",
            "wrist": "keep axis 5 away from 0 deg",
        }[which]
        super().__init__(f"the arm is in its {which} singularity (measure {measure:.2g}); {cure}{_place(index)}")


class UnstableLoadError(MillingError):
    """The springs no longer hold the load; load_factor: the share of the load at which an eigenvalue
    [N m/rad] of K_theta - H is no longer positive."""

    def __init__(self, load_factor: float, eigenvalue: float, index: tuple = ()):
        self.load_factor, self.eigenvalue, self.index = load_factor, eigenvalue, index
        super().__init__(
            f"the arm is unstable under this load: at {load_factor:.3g} of it the smallest eigenvalue of K_theta - H "
            f"is {eigenvalue:.3g} N m/rad, but must be positive; reduce the load or stiffen the joints{_place(index)}"
        )


class DeflectionError(MillingError):
    """The load bends a joint further than a linear spring may be believed; joint counts from 1, 0: the base, both
    angles [rad]; load_factor: the share of the load that already does it."""

    def __init__(self, joint: int, deflection: float, limit: float, load_factor: float, index: tuple = ()):
        self.joint, self.deflection, self.limit = joint, deflection, limit
        self.load_factor, self.index = load_factor, index
        name = f"joint {joint}" if joint else "the base"
        super().__init__(
            f"at {load_factor:.3g} of the load {name} bends by {math.degrees(deflection):.3g} deg, but its "
            f"linear spring is believed only up to {math.degrees(limit):.3g} deg; reduce the load or check the "
            f"compliances{_place(index)}"
        )


class EquilibriumError(MillingError):
    """No equilibrium; residual [N m], iterations, load_factor: the largest share of the load with an equilibrium."""

    def __init__(self, residual: float, iterations: int, load_factor: float, index: tuple = ()):
        self.residual, self.iterations, self.load_factor, self.index = residual, iterations, load_factor, index
        super().__init__(
            f"no static equilibrium: {iterations} iterations left a residual of {residual:.3g} N m, and "
            f"only {load_factor:.3g} of the load has an equilibrium; reduce the load or avoid singular postures"
            f"{_place(index)}"
        )
