"""Eq. (1), the arm's displacement under the process wrench, discretised exactly for a wrench held over a period.

Components without inertia (rotations, in the lumped mass model) follow statically: they are condensed, never
sliced. State of the others: ``[delta (r,), delta_dot (r,)]`` in workpiece axes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy.linalg import eigh

from kr270_milling.base.errors import MillingError
from kr270_milling.base.record import Record, parameter

__all__ = ["Dynamics", "ArmModel", "ModalModel", "advance", "condense", "discretise", "modes"]


class DynamicsError(MillingError):
    """Mass or compliance that cannot belong to an arm."""


@dataclass(frozen=True, eq=False)
class Dynamics(Record):
    """YAML ``dynamics``: how the arm moves under load."""

    mass_model: str = parameter(text="mass matrix M_C of (25)", choices=("lumped", "consistent"))
    damping_ratio: float = parameter(low=0.0, high=0.99, text="damping ratio of every mode")
    gravity: bool = parameter(True, text="linearise about the equilibrium under the link weights")
    follow_pose: bool = parameter(
        False, text="stiffness and mass follow the posture along the path; false: at its start"
    )
    posture_spacing: float = parameter(5e-3, unit="mm", above=0.0, high=1000.0, text="way between two such postures")


@dataclass(frozen=True, eq=False)
class ModalModel:
    """The undamped modes of M delta'' + K delta = F in the r components that carry inertia."""

    inertial: np.ndarray  #: indices of the components with inertia, (r,)
    frequency: np.ndarray  #: [rad/s], (r,), ascending
    shape: np.ndarray  #: mass-normalised modes, (r, r)
    mass: np.ndarray  #: (r, r)
    force: np.ndarray  #: wrench -> force on the inertial components, (r, 6)
    output: np.ndarray  #: inertial components -> deflection, (6, r)
    feedthrough: np.ndarray  #: static deflection of the components without inertia, (6, 6)


@dataclass(frozen=True, eq=False)
class ArmModel:
    """Discrete-time arm at n postures along a pass: ``x' = A x + B w``, ``deflection = P x + Q w``."""

    transition: np.ndarray  #: A, (n, 2r, 2r)
    input: np.ndarray  #: B, (n, 2r, 6)
    output: np.ndarray  #: P, (n, 6, 2r)
    feedthrough: np.ndarray  #: Q, (n, 6, 6)
    steps_per_knot: float  #: exchange periods from one posture to the next

    @property
    def arrays(self) -> tuple:
        """What ``advance`` takes."""
        return self.transition, self.input, self.output, self.feedthrough, self.steps_per_knot

    @property
    def order(self) -> int:
        return self.transition.shape[-1]


def condense(compliance: np.ndarray, mass: np.ndarray) -> tuple[np.ndarray, ...]:
    """Static condensation of (1) to the components with inertia: (index, K (r, r), force (r, 6), P (6, r), Q (6, 6)).

    With ``delta = C (w - M a)``: K = inv(C_ii), the wrench on the other components m acts through C_im, and these
    follow delta_m = C_mi K delta_i + (C_mm - C_mi K C_im) w_m.
    """
    inertial = np.flatnonzero(np.diag(mass) > 0.0)
    free = np.setdiff1d(np.arange(6), inertial)
    if inertial.size == 0 or np.any(mass[free]) or np.linalg.eigvalsh(mass[np.ix_(inertial, inertial)])[0] <= 0.0:
        raise DynamicsError("the mass matrix must be symmetric and positive definite in the components with inertia")
    softness = compliance[np.ix_(inertial, inertial)]
    if not (np.isfinite(softness).all() and np.linalg.cond(softness) < 1e12):
        raise DynamicsError("the compliance matrix is singular or not finite where there is inertia")
    stiffness = np.linalg.inv(softness)
    stiffness = 0.5 * (stiffness + stiffness.T)  # rounding only: K_C is symmetric under link weights
    force, output, feedthrough = np.zeros((inertial.size, 6)), np.zeros((6, inertial.size)), np.zeros((6, 6))
    force[:, inertial] = output[inertial] = np.eye(inertial.size)
    if free.size:
        coupling = stiffness @ compliance[np.ix_(inertial, free)]
        force[:, free], output[free] = coupling, coupling.T
        rest = compliance[np.ix_(free, free)] - compliance[np.ix_(free, inertial)] @ coupling
        feedthrough[np.ix_(free, free)] = rest
    return inertial, stiffness, force, output, feedthrough


def modes(compliance: np.ndarray, mass: np.ndarray) -> ModalModel:
    """Modes of (1) from the 6x6 compliance [m, rad per N, N m] and mass matrix in the same axes."""
    inertial, stiffness, force, output, feedthrough = condense(compliance, mass)
    mass_i = mass[np.ix_(inertial, inertial)]
    squared, shape = eigh(stiffness, mass_i)
    if not squared[0] > 0.0:
        raise DynamicsError("the compliance matrix is not positive definite: no stable equilibrium to vibrate about")
    return ModalModel(inertial, np.sqrt(squared), shape, mass_i, force, output, feedthrough)


def discretise(model: ModalModel, damping_ratio: float, period: float) -> tuple[np.ndarray, ...]:
    """A (2r, 2r), B (2r, 6), P (6, 2r), Q (6, 6) over ``period`` [s] for a wrench held over it: exact for (1)."""
    w, z, r = model.frequency, damping_ratio, model.frequency.size
    damped = w * np.sqrt(1.0 - z * z)
    decay, c, s = np.exp(-z * w * period), np.cos(damped * period), np.sin(damped * period)
    a11, a12 = decay * (c + z * w / damped * s), decay * s / damped
    a21, a22 = -decay * w * w / damped * s, decay * (c - z * w / damped * s)
    to, back = model.shape, model.shape.T @ model.mass  # eta -> delta, delta -> eta
    transition = np.block([[to * a11 @ back, to * a12 @ back], [to * a21 @ back, to * a22 @ back]])
    modal_force = model.shape.T @ model.force
    held = np.vstack([to * ((1.0 - a11) / w**2) @ modal_force, to * (-a21 / w**2) @ modal_force])
    return transition, held, np.hstack([model.output, np.zeros((6, r))]), model.feedthrough


@njit(cache=True, error_model="numpy")
def advance(step, state, wrench, arrays, new_state, deflection):
    """One exchange period of (1): fills ``new_state`` and ``deflection`` (6,) at its end.

    ``step`` counts exchange periods from the start of the pass; between two postures of the model the matrices are
    interpolated linearly.
    """
    transition, held, output, feedthrough, steps_per_knot = arrays
    n = transition.shape[0]
    place = step / steps_per_knot
    k = min(int(place), n - 1)
    m = min(k + 1, n - 1)
    f = min(place - k, 1.0) if m > k else 0.0
    order = state.size
    for i in range(order):
        total = 0.0
        for j in range(order):
            a = transition[k, i, j]
            total += (a + f * (transition[m, i, j] - a)) * state[j]
        for j in range(6):
            b = held[k, i, j]
            total += (b + f * (held[m, i, j] - b)) * wrench[j]
        new_state[i] = total
    for i in range(6):
        total = 0.0
        for j in range(order):
            p = output[k, i, j]
            total += (p + f * (output[m, i, j] - p)) * new_state[j]
        for j in range(6):
            q = feedthrough[k, i, j]
            total += (q + f * (feedthrough[m, i, j] - q)) * wrench[j]
        deflection[i] = total
