"""How the reference moves the motor side of the arm: the term -M r'' of eq. (1), period by period.

r has six components in workpiece axes: position [m], and a rotation [rad] whose rate is the angular velocity of the
reference. Over one exchange period r'' is taken as linear in time, plus a jump of the velocity at its start, where the
reference has a corner. So positions and velocities at the ends of the periods are met exactly, and a reference that is
linear or cubic between them is met everywhere.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numba import njit
from scipy.spatial.transform import Rotation

from kr270_milling.trajectory.trajectory import Trajectory

__all__ = ["INPUTS", "approach", "push", "reference_motion"]

INPUTS = 18  #: a period: jump of r' at its start [m/s, rad/s], r'' at its start and at its end [m/s^2, rad/s^2]


def reference_motion(reference: Trajectory, stamps: np.ndarray, approach: np.ndarray | None = None) -> np.ndarray:
    """(n, 18) over the n periods between the stamps [ns]: jump of r', r'' at the start, r'' at the end, six each.

    A cubic over H from rate v to w that moves by p has r'' = (6 p / H - 4 v - 2 w) / H at its start and
    (-6 p / H + 2 v + 4 w) / H at its end. approach: r' before the pass, (6,), as ``approach`` has it of the programmed
    trajectory: a straight cut comes in at its feed rate. None: that of the reference itself.
    """
    period = np.diff(stamps)[:, None] * 1e-9
    moved = np.hstack([np.diff(reference.sample(stamps), axis=0), _turns(reference, stamps)])
    after, before = _rates(reference, stamps, "right"), _rates(reference, stamps, "left")
    before[0] = after[0] if approach is None else approach
    after[stamps >= reference.duration_ns] = 0.0  # then it rests
    v, w = after[:-1], before[1:]
    start = (6 * moved / period - 4 * v - 2 * w) / period
    end = (-6 * moved / period + 2 * v + 4 * w) / period
    return np.hstack([(after - before)[:-1], start, end])


def approach(programmed: Trajectory) -> np.ndarray:
    """r' (6,) with which a pass begins [m/s, rad/s]: the first of the programmed trajectory, without a correction."""
    return _rates(programmed, np.zeros(1, np.int64), "right")[0]


def _rates(reference: Trajectory, stamps: np.ndarray, side: Literal["left", "right"]) -> np.ndarray:
    return np.hstack([reference.sample_velocity(stamps, side), _turning(reference, stamps, side)])


def _turns(reference: Trajectory, stamps: np.ndarray) -> np.ndarray:
    """Rotation vectors (n, 3) [rad] of the reference over the periods, workpiece axes."""
    if np.ptp(reference.quaternion, axis=0).max() == 0.0:
        return np.zeros((stamps.size - 1, 3))
    turned = Rotation.from_quat(reference.sample_orientation(stamps))
    return (turned[1:] * turned[:-1].inv()).as_rotvec()


def _turning(reference: Trajectory, stamps: np.ndarray, side: Literal["left", "right"]) -> np.ndarray:
    """Angular velocity (n, 3) [rad/s] of the reference at the stamps, workpiece axes: constant between its knots."""
    if np.ptp(reference.quaternion, axis=0).max() == 0.0:
        return np.zeros((stamps.size, 3))
    knots = Rotation.from_quat(reference.quaternion)
    rates = (knots[1:] * knots[:-1].inv()).as_rotvec() / np.diff(reference.time)[:, None]
    segment, _, _ = reference.locate(stamps, side)
    return np.where(reference.moving(stamps)[:, None], rates[segment], 0.0)


@njit(cache=True, error_model="numpy")
def push(motion, response, steps_per_knot, out):
    """Fill ``out`` (n, 2r): what the motion (n, 18) of the reference adds to the state at the end of each period.

    response: R, (k, 2r, 18) at k postures, interpolated between two of them as in ``advance``.
    """
    knots, order = response.shape[0], response.shape[1]
    for step in range(motion.shape[0]):
        place = step / steps_per_knot
        k = min(int(place), knots - 1)
        m = min(k + 1, knots - 1)
        f = min(place - k, 1.0) if m > k else 0.0
        for i in range(order):
            total = 0.0
            for j in range(motion.shape[1]):
                r = response[k, i, j]
                total += (r + f * (response[m, i, j] - r)) * motion[step, j]
            out[step, i] = total
