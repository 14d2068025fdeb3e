"""Eq. (1), the arm's displacement under the process wrench, discretised exactly for a wrench constant in a period.

M delta'' + C delta' + K delta = F is (1) as printed. The reference r moves the motor side of the arm and not the tool:
with z = r + delta, M z'' + C (z' - r') + K (z - r) = F, so that -M r'' joins F on the right (``reference_inertia``).

Components without inertia (rotations, in the lumped mass model) follow statically: they are condensed, never
sliced. State of the others: ``[delta (r,), delta_dot (r,)]`` in workpiece axes.

r has six components in workpiece axes: position [m], and a rotation [rad] whose rate is the angular velocity of the
reference. Over one exchange period r'' is taken as linear in time, plus a jump of the velocity at its start, where the
reference has a corner. So positions and velocities at the ends of the periods are met exactly, and a reference that is
linear or cubic between them is met everywhere.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from kr270_milling.base.compiled import compiled, inlined
from kr270_milling.base.errors import ModelError
from kr270_milling.path.trajectory import Trajectory
from kr270_milling.physics.motion.backlash import NO_GAPS, STATES, Gaps, cross_gaps

Side = Literal["left", "right"]


class ArmFactors(NamedTuple):
    """Factors of an identified arm on the modelled arm."""

    frequency: np.ndarray  #: (r,)
    damping: np.ndarray  #: (r,)
    gain: float  #: on the response to a correction of the reference
    softness: float  #: on the static compliance


@dataclass(frozen=True, eq=False)
class ModalModel:
    """The undamped modes of M delta'' + K delta = F in the r components that carry inertia; of n postures (n, ...)."""

    inertial: np.ndarray  #: indices of the components with inertia, (r,)
    frequency: np.ndarray  #: [rad/s], (r,), ascending
    shape: np.ndarray  #: mass-normalised modes, (r, r)
    mass: np.ndarray  #: (r, r)
    force: np.ndarray  #: wrench -> force on the inertial components, (r, 6)
    output: np.ndarray  #: inertial components -> deflection, (6, r)
    feedthrough: np.ndarray  #: static deflection of the components without inertia, (6, 6)
    reference: np.ndarray  #: r of the six components -> of the inertial ones, (r, 6)
    damping: np.ndarray | None = None  #: ratio of each mode, (r,); None: that of ``dynamics.damping_ratio``
    tool: np.ndarray | None = None  #: static compliance of the tool tip against the spindle [m/N], (3, 3); None: rigid

    def ratios(self, damping_ratio: float) -> np.ndarray:
        """Damping ratio of each mode, (r,): its own, or damping_ratio for all."""
        return np.broadcast_to(damping_ratio if self.damping is None else self.damping, self.frequency.shape)

    def scaled(self, factors: ArmFactors, damping_ratio: float) -> ModalModel:
        """Return the modes of an identified arm; the shapes stay. damping_ratio: of a mode without a separate ratio.

        The static displacement sum_i phi_i phi_i^T F / omega_i^2 is that of ``softness`` alone, so the modal forces
        phi^T F get the squares of the factors on omega: F' = M phi diag(f^2) phi^T F, since phi^-1 = phi^T M.
        """
        raised = self.mass @ (self.shape * factors.frequency**2) @ self.shape.T
        return dataclasses.replace(
            self,
            frequency=self.frequency * factors.frequency,
            damping=self.ratios(damping_ratio) * factors.damping,
            force=factors.softness * raised @ self.force,
            feedthrough=factors.softness * self.feedthrough,
            tool=None if self.tool is None else factors.softness * self.tool,
        )


@dataclass(frozen=True, eq=False)
class ArmModel:
    """Discrete-time arm at n postures along a pass: ``x' = A x + B w + R m``, ``deflection = P x + Q w``.

    m (18,) is the motion of the reference over a period, see ``reference_motion``.
    """

    transition: np.ndarray  #: A, (n, 2r, 2r); with a compliant tool 2r + 3 in place of 2r, everywhere
    input: np.ndarray  #: B, (n, 2r, 6)
    output: np.ndarray  #: P, (n, 6, 2r)
    feedthrough: np.ndarray  #: Q, (n, 6, 6)
    reference: np.ndarray  #: R, (n, 2r, 18); (n, 2r, 0) where the reference moves the tool itself, (1) as printed
    steps_per_knot: float  #: exchange periods from one posture to the next
    approach: np.ndarray | None = None  #: r' before the pass [m/s, rad/s], (6,); None: the first of the reference
    gaps: Gaps = NO_GAPS  #: backlash of the joints, whose displacement joins the deflection

    @cached_property
    def arrays(self) -> tuple:
        """Arguments of ``advance``: transposed matrices, whose sums over columns take vector instructions."""
        matrices = (self.transition, self.input, self.output, self.feedthrough)
        turned = (np.ascontiguousarray(matrix.swapaxes(-1, -2)) for matrix in matrices)
        return *turned, self.steps_per_knot, self.gaps.arrays

    def push(
        self, reference: Trajectory, stamps: np.ndarray, first: int = 0, positions: np.ndarray | None = None
    ) -> np.ndarray:
        """R m over each period between the stamps [ns], (periods, 2r); none, (0, 2r), for (1) as printed.

        first: number of the period that begins at the first stamp; positions: of the reference at the stamps
        [m], (periods + 1, 3), where they are known already.
        """
        if not self.reference.size:
            return np.zeros((0, self.order))
        out = np.zeros((stamps.size - 1, self.order))
        motion = reference_motion(reference, stamps, self.approach, first, positions)
        push(motion, np.ascontiguousarray(self.reference.swapaxes(-1, -2)), self.steps_per_knot, first, out)
        return out

    @property
    def order(self) -> int:
        return self.transition.shape[-1]

    @property
    def states(self) -> int:
        """Numbers that ``advance`` carries: those of eq. (1), and those of the gaps where there are some."""
        return self.order + (STATES if len(self.gaps.torque) else 0)


def condense(compliance: np.ndarray, mass: np.ndarray) -> tuple[np.ndarray, ...]:
    """Static condensation of (1) to the components with inertia: (index, K (r, r), force (r, 6), P (6, r), Q (6, 6)).

    With ``delta = C (w - M a)``: K = inv(C_ii), the wrench on the other components m acts through C_im, and these
    follow delta_m = C_mi K delta_i + (C_mm - C_mi K C_im) w_m. Both matrices may be stacks, (..., 6, 6).
    """
    carries = np.diagonal(mass, axis1=-2, axis2=-1).reshape(-1, 6) > 0.0
    inertial, free = np.flatnonzero(carries[0]), np.flatnonzero(~carries[0])
    own, other = inertial[:, None], free[:, None]  # rows of a matrix
    inert = inertial.size and (carries == carries[0]).all() and not np.any(mass[..., free, :])
    if not inert or np.linalg.eigvalsh(mass[..., own, inertial])[..., 0].min() <= 0.0:
        raise ModelError("the mass matrix must be symmetric and positive definite in the components with inertia")
    softness = compliance[..., own, inertial]
    if not (np.isfinite(softness).all() and (np.linalg.cond(softness) < 1e12).all()):
        raise ModelError("the compliance matrix is singular or not finite where there is inertia")
    stiffness = np.linalg.inv(softness)
    stiffness = 0.5 * (stiffness + stiffness.swapaxes(-1, -2))  # rounding only: K_C is symmetric under link weights
    shape = compliance.shape[:-2]
    force, output, feedthrough = (
        np.zeros((*shape, *size)) for size in ((inertial.size, 6), (6, inertial.size), (6, 6))
    )
    force[..., inertial] = output[..., inertial, :] = np.eye(inertial.size)
    if free.size:
        coupling = stiffness @ compliance[..., own, free]
        force[..., free], output[..., free, :] = coupling, coupling.swapaxes(-1, -2)
        rest = compliance[..., other, free] - compliance[..., other, inertial] @ coupling
        feedthrough[..., other, free] = rest
    return inertial, stiffness, force, output, feedthrough


def modes(compliance: np.ndarray, mass: np.ndarray) -> list[ModalModel]:
    """Modes of (1) at n postures, from compliance [m, rad per N, N m] and mass matrices in the same axes, (n, 6, 6)."""
    inertial, stiffness, force, output, feedthrough = condense(compliance, mass)
    mass_i = mass[..., inertial[:, None], inertial]
    root = np.linalg.cholesky(mass_i)  # M = L L^T: the symmetric problem of L^-1 K L^-T has the same eigenvalues
    half = np.linalg.solve(root, stiffness)
    squared, turned = np.linalg.eigh(np.linalg.solve(root, half.swapaxes(-1, -2)))
    if not squared.min() > 0.0:
        raise ModelError("the compliance matrix is not positive definite: no stable equilibrium to vibrate about")
    shape = np.linalg.solve(root.swapaxes(-1, -2), turned)
    frequency, back = np.sqrt(squared), np.eye(6)[inertial]
    return [
        ModalModel(inertial, frequency[k], shape[k], mass_i[k], force[k], output[k], feedthrough[k], back)
        for k in range(len(mass))
    ]


def discretise(model: ModalModel, damping_ratio: float, period: float) -> tuple[np.ndarray, ...]:
    """A (2r, 2r), B (2r, 6), P (6, 2r), Q (6, 6) over ``period`` [s] for a constant wrench; of n postures (n, ...).

    Exact for M delta'' + C delta' + K delta = F   (1) [Klimchik2014].
    """
    w, to = model.frequency[..., None, :], model.shape  # eta -> delta
    a11, a12, a21, a22 = _free(w, model.ratios(damping_ratio)[..., None, :], period)
    back, modal_force = (to.swapaxes(-1, -2) @ matrix for matrix in (model.mass, model.force))  # delta -> eta
    transition = np.block([[to * a11 @ back, to * a12 @ back], [to * a21 @ back, to * a22 @ back]])
    driven = np.concatenate([to * ((1.0 - a11) / w**2) @ modal_force, to * (-a21 / w**2) @ modal_force], -2)
    return transition, driven, np.concatenate([model.output, np.zeros(model.output.shape)], -1), model.feedthrough


def _free(w: np.ndarray, z: np.ndarray, period: float) -> tuple[np.ndarray, ...]:
    """a11, a12, a21, a22, each (..., r), of the free vibration: (eta, eta') at the end from those at the start."""
    damped = w * np.sqrt(1.0 - z * z)
    decay, c, s = np.exp(-z * w * period), np.cos(damped * period), np.sin(damped * period)
    a11, a12 = decay * (c + z * w / damped * s), decay * s / damped
    a21, a22 = -decay * w * w / damped * s, decay * (c - z * w / damped * s)
    return a11, a12, a21, a22


def discretise_reference(model: ModalModel, damping_ratio: float, period: float) -> np.ndarray:
    """R (2r, 18) over ``period`` H [s]: exact for the term -M r'' where r'' is linear in time, after a jump of r'.

    A jump of r' by v leaves z' as it was, so delta' jumps by -v. A modal force t / H leaves
    eta(H) = (1 - a12 / H - 2 zeta (1 - a11) / (omega H)) / omega^2, and eta'(H) is the derivative of its like.
    """
    w, z, h = model.frequency[..., None, :], model.ratios(damping_ratio)[..., None, :], period
    a11, a12, a21, a22 = _free(w, z, h)
    driven = (1.0 - a11) / w**2, -a21 / w**2
    ramp = (1.0 - a12 / h - 2.0 * z * (1.0 - a11) / (w * h)) / w**2, (1.0 - a22 + 2.0 * z * a21 / w) / (w**2 * h)
    to, back = model.shape, model.shape.swapaxes(-1, -2) @ model.mass @ model.reference  # eta -> delta, r -> eta

    def response(place, speed):
        return -np.concatenate([to * place @ back, to * speed @ back], -2)

    falling = [constant - rising for constant, rising in zip(driven, ramp, strict=True)]  # from 1 to 0
    return np.concatenate([response(a12, a22), response(*falling), response(*ramp)], -1)


def reference_motion(
    reference: Trajectory,
    stamps: np.ndarray,
    approach: np.ndarray | None = None,
    first: int = 0,
    positions: np.ndarray | None = None,
) -> np.ndarray:
    """(n, 18) over the n periods between the stamps [ns]: jump of r', r'' at the start, r'' at the end, six each.

    A cubic over H from rate v to w that moves by p has r'' = (6 p / H - 4 v - 2 w) / H at its start and
    (-6 p / H + 2 v + 4 w) / H where the period ends. approach: r' before the pass, (6,), for example that of the
    programmed trajectory: a straight cut enters at its feed rate. None: that of the reference itself. first: number of
    the period that begins at the first stamp; the pass begins with period 0. positions: see ``ArmModel.push``.
    """
    positions = reference.sample(stamps) if positions is None else positions
    moved = np.hstack([np.diff(positions, axis=0), _turns(reference, stamps)])
    after = _rates(reference, stamps, "right")
    before = after.copy()
    if reference.velocity is None:  # it may have corners, at knots alone
        knot = reference.locate(stamps, "left")[0] != reference.locate(stamps, "right")[0]
        if knot.any():
            before[knot] = _rates(reference, stamps[knot], "left")
    if first == 0:
        before[0] = after[0] if approach is None else approach
    after[stamps >= reference.duration_ns] = 0.0  # then it rests
    motion = np.empty((stamps.size - 1, 18))
    _accelerations(np.diff(stamps) * 1e-9, moved, before, after, motion)
    return motion


@compiled
def _accelerations(period, moved, before, after, motion):
    """Fill ``motion`` (n, 18), see ``reference_motion``, from r' before and after each stamp, (n + 1, 6)."""
    for n in range(period.size):
        h = period[n]
        for j in range(6):
            p, v, w = moved[n, j], after[n, j], before[n + 1, j]
            motion[n, j] = v - before[n, j]
            motion[n, 6 + j] = (6.0 * p / h - 4.0 * v - 2.0 * w) / h
            motion[n, 12 + j] = (-6.0 * p / h + 2.0 * v + 4.0 * w) / h


def approach(programmed: Trajectory) -> np.ndarray:
    """r' (6,) with which a pass begins [m/s, rad/s]: the first of the programmed trajectory, without a correction."""
    return _rates(programmed, np.zeros(1, np.int64), "right")[0]


def _rates(reference: Trajectory, stamps: np.ndarray, side: Side) -> np.ndarray:
    return np.hstack([reference.sample_velocity(stamps, side), _turning(reference, stamps, side)])


def _turns(reference: Trajectory, stamps: np.ndarray) -> np.ndarray:
    """Rotation vectors (n, 3) [rad] of the reference over the periods, workpiece axes."""
    if not reference.turns:
        return np.zeros((stamps.size - 1, 3))
    turned = Rotation.from_quat(reference.sample_orientation(stamps))
    return (turned[1:] * turned[:-1].inv()).as_rotvec()


def _turning(reference: Trajectory, stamps: np.ndarray, side: Side) -> np.ndarray:
    """Angular velocity (n, 3) [rad/s] of the reference at the stamps, workpiece axes."""
    if not reference.turns:
        return np.zeros((stamps.size, 3))
    return np.where(reference.moving(stamps)[:, None], reference.turn(stamps, side)[2], 0.0)


@compiled
def push(motion, response, steps_per_knot, first, out):
    """Fill ``out`` (n, 2r): what the motion (n, 18) of the reference adds to the state at the end of each period.

    first: number of the first period; response: R transposed, (k, 18, 2r) at k postures, interpolated between two of
    them as in ``advance``.
    """
    knots, order = response.shape[0], response.shape[2]
    for step in range(motion.shape[0]):
        place = (first + step) / steps_per_knot
        k = min(int(place), knots - 1)
        m = min(k + 1, knots - 1)
        f = min(place - k, 1.0) if m > k else 0.0
        for i in range(order):
            out[step, i] = 0.0
        for j in range(motion.shape[1]):
            if motion[step, j] != 0.0:  # most references do not turn, and have corners in few periods
                for i in range(order):
                    r = response[k, j, i]
                    out[step, i] += (r + f * (response[m, j, i] - r)) * motion[step, j]


@compiled
def advance(step, state, wrench, push, arrays, new_state, deflection):
    """Advance (1) by an exchange period: fill ``new_state`` and ``deflection`` (6,) at the end of the period.

    ``step`` counts exchange periods from the start of the pass; between two postures of the model the matrices are
    interpolated linearly. push (2r,): of the reference in this period, a row of ``ArmModel.push``; (0,): none.
    """
    free = new_state[: arrays[0].shape[1]]
    swing_freely(step, state, arrays, free)
    drive(step, free, state, wrench, push, arrays, new_state, deflection)


@inlined
def _between(step, steps_per_knot, n):
    """Postures k and m about a step, and the share of m."""
    place = step / steps_per_knot
    k = min(int(place), n - 1)
    m = min(k + 1, n - 1)
    return k, m, min(place - k, 1.0) if m > k else 0.0


@inlined
def _add(matrices, k, m, f, vector, total):
    """Add the product of a transposed matrix between postures k and m and a vector."""
    for j in range(matrices.shape[1]):
        for i in range(total.size):
            a = matrices[k, j, i]
            total[i] += (a + f * (matrices[m, j, i] - a)) * vector[j]


@inlined
def swing_freely(step, state, arrays, free):
    """Fill ``free`` (2r,): A x, the part of ``advance`` that is the same under every wrench."""
    transition = arrays[0]
    k, m, f = _between(step, arrays[4], transition.shape[0])
    for i in range(free.size):
        free[i] = 0.0
    _add(transition, k, m, f, state, free)


@inlined
def drive(step, free, state, wrench, push, arrays, new_state, deflection):
    """The part of ``advance`` that follows ``swing_freely``."""
    _, driven, output, feedthrough, steps_per_knot, gaps = arrays
    k, m, f = _between(step, steps_per_knot, driven.shape[0])
    order = free.size
    for i in range(order):
        new_state[i] = free[i]
    _add(driven, k, m, f, wrench, new_state[:order])
    for i in range(push.size):
        new_state[i] += push[i]
    for i in range(6):
        deflection[i] = 0.0
    _add(output, k, m, f, new_state[:order], deflection)
    _add(feedthrough, k, m, f, wrench, deflection)
    if gaps[0].shape[0] > 0:
        cross_gaps(step, state[order:], wrench, gaps, new_state[order:], deflection)
