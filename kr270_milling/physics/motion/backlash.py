"""Backlash of the joints of a plant: each joint lies on one of two flanks, and its load decides on which one.

The load on a joint is the torque of weight, cut and inertia, J_G^T G + J_F^T F - M_theta q''. Its motor only follows
the reference, so a reversal of the motion under a constant load changes nothing.

    s_k = 1 where tau_k > T,  -1 where tau_k < -T,  else s_(k-1)       flank, with the friction torque T
    delta = J b (s_k - s_first) / 2                                    displacement of the tool

This is the relay with hysteresis [Krasnoselskii1989]; the gap is that of the dead-zone model
[Nordin2002]. s_first is the first flank of the pass, on which the tool was touched off. The cut counts with its mean
over about a revolution of the spindle, because the links do not follow single teeth:

    F_k = F_(k-1) + (1 - exp(-H / T_rev)) (w_k - F_(k-1)).

Friction on the link's side that follows the sense of motion is not modelled.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from kr270_milling.base.compiled import compiled, inner

STATES = 18  #: numbers of the state of the gaps: mean wrench, flanks, first flanks


@dataclass(frozen=True, eq=False)
class Gaps:
    """The gaps of six joints along a pass, at n knots; workpiece axes."""

    torque: np.ndarray  #: on the joints by weight and inertia [N m], (n, 6)
    jacobian: np.ndarray  #: Jacobian of the tool point [m/rad, rad/rad], (n, 6, 6)
    friction: np.ndarray  #: T [N m], (6,)
    width: np.ndarray  #: b [rad], (6,)
    share: float  #: share of the newest wrench in the mean wrench, 1 - exp(-H / T_rev)
    steps_per_knot: float  #: exchange periods from one knot to the next

    @property
    def arrays(self) -> tuple:
        """Arguments of ``cross_gaps``."""
        return self.torque, self.jacobian, self.friction, self.width, self.share, self.steps_per_knot


#: joints without backlash
NO_GAPS = Gaps(np.zeros((0, 6)), np.zeros((0, 6, 6)), np.zeros(6), np.zeros(6), 1.0, 1.0)


@compiled
def flank_after(torque, friction, flank):
    """The flank (-1, 0, 1) under a torque [N m] that the friction torque opposes; 0: not known yet.

    s = sign(tau) where |tau| > T, else the flank before.
    """
    if torque > friction:
        return 1.0
    if torque < -friction:
        return -1.0
    return flank


@inner
def cross_gaps(step, state, wrench, gaps, new_state, deflection):
    """Advance the gaps by an exchange period: fill ``new_state`` (18,) and add to ``deflection`` (6,).

    state: mean wrench, flanks, first flanks, six each; wrench (6,): of the period; gaps: ``Gaps.arrays``.
    """
    torque, jacobian, friction, width, share, steps_per_knot = gaps
    n = torque.shape[0]
    place = step / steps_per_knot
    k = min(int(place), n - 1)
    m = min(k + 1, n - 1)
    f = min(place - k, 1.0) if m > k else 0.0
    for i in range(6):
        new_state[i] = state[i] + share * (wrench[i] - state[i])
    for j in range(6):
        load = torque[k, j] + f * (torque[m, j] - torque[k, j])
        for i in range(6):
            load += (jacobian[k, i, j] + f * (jacobian[m, i, j] - jacobian[k, i, j])) * new_state[i]
        flank = flank_after(load, friction[j], state[6 + j])
        first = state[12 + j] if state[12 + j] != 0.0 else flank
        new_state[6 + j], new_state[12 + j] = flank, first
        lost = 0.5 * width[j] * (flank - first)
        if lost != 0.0:
            for i in range(6):
                deflection[i] += (jacobian[k, i, j] + f * (jacobian[m, i, j] - jacobian[k, i, j])) * lost


def flanks(gaps: Gaps, wrenches: np.ndarray) -> np.ndarray:
    """Flanks (n + 1, 6) of a pass with known wrenches (n + 1, 6); 0 before the first torque beyond the friction."""
    series = np.zeros((len(wrenches), 6))
    _flanks(gaps.arrays, np.ascontiguousarray(wrenches, float), series)
    return series


@njit(cache=True, nogil=True)
def _flanks(gaps, wrenches, series):
    state, new_state, deflection = np.zeros(STATES), np.zeros(STATES), np.zeros(6)
    for n in range(len(wrenches) - 1):
        cross_gaps(n, state, wrenches[n + 1], gaps, new_state, deflection)
        for j in range(STATES):  # one by one: Numba compiles the sentence on shapes of a slice for seconds
            state[j] = new_state[j]
        for j in range(6):
            series[n + 1, j] = state[6 + j]


def tool_jumps(gaps: Gaps, wrenches: np.ndarray) -> list[tuple[int, int, float]]:
    """(step, joint from 0, jump of the tool [m]) of each change of a flank: |J_j| b_j   at the step."""
    series = flanks(gaps, wrenches)
    steps, joints = np.nonzero((series[1:] * series[:-1]) < 0.0)
    place = np.minimum(steps / gaps.steps_per_knot, len(gaps.torque) - 1)
    knot = np.minimum(place.astype(int), max(0, len(gaps.torque) - 2))
    start, end = gaps.jacobian[knot, :3, joints], gaps.jacobian[np.minimum(knot + 1, len(gaps.torque) - 1), :3, joints]
    size = np.linalg.norm(start + (place - knot)[:, None] * (end - start), axis=1) * gaps.width[joints]
    return list(zip((steps + 1).tolist(), joints.tolist(), size.tolist(), strict=True))
