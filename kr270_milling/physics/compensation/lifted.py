"""The correction whose response of the arm takes the deviation away: weighted least squares over every knot at once.

The lifted model is d = d0 + H c: deviation d of the tool with the correction c of the knots, d0 without, H the response
of the arm. The sum of (d0 + H c)^T W (d0 + H c) and of the smoothness is made least segment by segment, backwards
(dynamic programming, [Bryson1975]): what is left to pay from a knot on is x^T P x / 2 + p^T x of the state x there. So
nothing of a slowly decaying response is cut off, and the cost is linear in the length of the path.

The numbers of one segment are y = [u, u', c, v, a, j]: relative modal coordinates of the arm and their rates, and the
cubic of the correction, 2 r + 12 of them; the state x at a knot is y without j. Where the correction is smooth j is
free; where the target stops the correction has no slope; straight lines have a free v.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import numpy as np

from kr270_milling.physics.compensation.response import ArmResponse, Segments

__all__ = ["LiftedCorrection", "KnotConditions", "Lifted", "outputs", "transitions", "units"]

CONTROLS = 6  #: most free numbers of a segment: a and j after a stop
ROUNDS = 40  #: most reweightings
CLOSE = 1.02  #: the largest deviation is within 2 % of the least possible one: it is good enough
TINY = 1e-12  #: of the trace: keeps what no sample sees from making a matrix singular


@dataclass(frozen=True, eq=False)
class KnotConditions:
    """Conditions on the correction at its m + 1 knots."""

    smooth: bool  #: C2 between stops; else straight lines
    resting: np.ndarray  #: (m + 1,) bool: the target stops at this knot
    fixed: np.ndarray  #: (m,) bool: the target rests along the whole segment, and so does the correction


@dataclass(frozen=True, eq=False)
class LiftedCorrection:
    """Cubics c, v, a, j of the correction, (m, 4, 3), and what is left of the deviation [m], (m, parts, 3)."""

    cubic: np.ndarray
    left: np.ndarray

    def knots(self, segments: Segments) -> np.ndarray:
        """Values [m] at the knots, (m + 1, 3)."""
        t = segments.duration[-1]
        c, v, a, j = self.cubic[-1]
        return np.vstack([self.cubic[:, 0], c + v * t + a * t**2 / 2.0 + j * t**3 / 6.0])


class Lifted:
    """The response of one arm along one path to every knot, to be solved for any deviation and weight."""

    def __init__(self, arm: ArmResponse, segments: Segments, conditions: KnotConditions):
        self.order, self.smooth = arm.order, conditions.smooth
        self._unit = units(arm, segments)
        state = 2 * arm.order + 9
        self._output = outputs(arm, segments) * self._unit
        self._next = transitions(arm, segments) * self._unit / self._unit[:state, None]
        self._given, self._free, self._first = choices(arm, segments, conditions, self._unit)

    def least_squares(self, deviation: np.ndarray, weight: np.ndarray, smoothness: float) -> LiftedCorrection:
        """The best correction of deviations d0 [m], (m, parts, 3), under weights W (m, parts, 3, 3).

        smoothness: weight of the change of the correction's third (of straight lines: second) difference over a
        segment of the usual length.
        """
        weighted = np.swapaxes(self._output, -1, -2) @ weight
        cost = np.sum(weighted @ self._output, axis=1)
        slope = np.sum(weighted @ deviation[..., None], axis=1)[..., 0]
        policy, push, later, linear = self._backward(cost, slope, smoothness)
        chosen = self._first.T @ later @ self._first
        chosen += np.diag(np.where(np.diag(chosen) > 0.0, TINY * np.trace(chosen), 1.0))
        state = -self._first @ np.linalg.solve(chosen, self._first.T @ linear)
        local = np.zeros(slope.shape)
        for k in range(len(local)):
            local[k] = self._given[k] @ state + self._free[k] @ (policy[k] @ state + push[k])
            state = self._next[k] @ local[k]
        left = deviation + (self._output @ local[:, None, :, None])[..., 0]
        cubic = (local * self._unit)[:, 2 * self.order :].reshape(-1, 4, 3)
        return LiftedCorrection(cubic, left)

    def _backward(self, cost: np.ndarray, slope: np.ndarray, smoothness: float):
        """The best free numbers of each segment, policy x + push, and P, p at the first knot."""
        m, size, r = self._given.shape[0], self._given.shape[2], self.order
        later, linear = np.zeros((size, size)), np.zeros(size)
        policy, push = np.zeros((m, CONTROLS, size)), np.zeros((m, CONTROLS))
        if self.smooth:  # weight of j
            cost[:, 2 * r + 9 :, 2 * r + 9 :] += smoothness * np.eye(3)
        difference = np.zeros((3, size + CONTROLS))  # of straight lines: what is free minus v of the state
        difference[:, 2 * r + 3 : 2 * r + 6], difference[:, size : size + 3] = -np.eye(3), np.eye(3)
        bend = smoothness * difference.T @ difference
        for k in range(m - 1, -1, -1):
            both = np.hstack([self._given[k], self._free[k]])
            total = both.T @ (cost[k] + self._next[k].T @ later @ self._next[k]) @ both
            gradient = both.T @ (slope[k] + self._next[k].T @ linear)
            if not self.smooth and self._free[k].any():
                total += bend
            block = total[size:, size:]
            idle = np.diag(np.where(np.diag(block) > 0.0, TINY * np.trace(block), 1.0))
            answer = -np.linalg.solve(block + idle, np.column_stack([total[size:, :size], gradient[size:]]))
            policy[k], push[k] = answer[:, :size], answer[:, size]
            later = total[:size, :size] + total[:size, size:] @ policy[k]
            later = 0.5 * (later + later.T)
            linear = gradient[:size] + total[:size, size:] @ push[k]
        return policy, push, later, linear

    def min_max(self, deviation, weight, smoothness: float, scored: np.ndarray) -> LiftedCorrection:
        """As ``least_squares``, but with the least largest deviation in the parts ``scored`` (m, parts).

        Lawson's reweighting [Lawson1961]: parts with a large deviation gain weight; the weighted mean square is a lower
        bound of the largest one, so the end is known when it comes near.
        """
        share, least = np.ones(scored.shape), np.inf
        best: LiftedCorrection | None = None
        for _ in range(ROUNDS if scored.any() else 1):
            solution = self.least_squares(deviation, weight * share[..., None, None], smoothness)
            size = np.sqrt(np.einsum("kpi,kpij,kpj->kp", solution.left, weight, solution.left))[scored]
            if best is None or size.max() < least:
                best, least = solution, float(size.max(initial=0.0))
            now = share[scored]
            if size.max(initial=0.0) < TINY or least <= CLOSE * np.sqrt(np.sum(now * size**2) / np.sum(now)):
                break
            now = now * size / size.max()
            share[scored] = np.maximum(now / now.mean(), 1e-4)
        return cast(LiftedCorrection, best)  # of one round at least


def units(arm: ArmResponse, segments: Segments) -> np.ndarray:
    """(2 r + 12,): unit of each number of y, chosen so that all numbers are lengths of similar size [m]."""
    time, size = float(np.median(segments.duration)), np.linalg.norm(arm.outward[:1], axis=(0, 1))
    size = np.maximum(size, 1e-6 * size.max(initial=1e-300))
    return np.concatenate([1.0 / size, 1.0 / (size * time), *(np.full(3, time**-i) for i in range(4))])


def outputs(arm: ArmResponse, segments: Segments) -> np.ndarray:
    """Motion of the tool in each part from y, (m, parts, 3, 2 r + 12)."""
    place, out = segments.place, arm.outward[:, None]
    free, forced = arm.free(place), arm.forced(place)
    swing = [out @ (f[..., None] * arm.inward[:, None]) if arm.moves else 0.0 for f in forced[:2]]
    straight = segments.powers[..., None, None, :] * np.eye(3)[:, :, None]  # (m, parts, 3, 3, 4)
    cubic = [straight[..., 0], straight[..., 1], straight[..., 2] + swing[0], straight[..., 3] + swing[1]]
    return arm.gain * np.concatenate([out * free[0][..., None, :], out * free[1][..., None, :], *cubic], axis=-1)


def transitions(arm: ArmResponse, segments: Segments) -> np.ndarray:
    """x at the next knot from y, (m, 2 r + 9, 2 r + 12)."""
    duration, r = segments.duration[:, None], arm.order
    h11, h12, h21, h22 = (h[:, 0, None] for h in arm.free(duration))
    of_bend, of_jerk, rate_of_bend, rate_of_jerk = (f[:, 0, :, None] * arm.inward for f in arm.forced(duration))
    matrix = np.zeros((len(segments), 2 * r + 9, 2 * r + 12))
    matrix[:, :r, :r], matrix[:, :r, r : 2 * r] = arm.carry * h11, arm.carry * h12
    matrix[:, r : 2 * r, :r], matrix[:, r : 2 * r, r : 2 * r] = arm.carry * h21, arm.carry * h22
    if arm.moves:
        matrix[:, : 2 * r, 2 * r + 6 :] = np.concatenate(
            [arm.carry @ np.dstack([of_bend, of_jerk]), arm.carry @ np.dstack([rate_of_bend, rate_of_jerk])], axis=1
        )
    powers = duration ** np.arange(4) / [1.0, 1.0, 2.0, 6.0]
    for row in range(3):
        for column in range(row, 4):
            rows, columns = (slice(2 * r + 3 * i, 2 * r + 3 * i + 3) for i in (row, column))
            matrix[:, rows, columns] = powers[:, column - row, None, None] * np.eye(3)
    return matrix


def choices(arm: ArmResponse, segments: Segments, conditions: KnotConditions, unit: np.ndarray):
    """y of a segment, in units, from the state x that arrives and from what is free there: (m, y, x), (m, y, CONTROLS).

    The third one gives x at the first knot from c, v, a of the correction there, (x, 9).
    """
    m, r = len(segments), arm.order
    given, free = np.zeros((m, 2 * r + 12, 2 * r + 9)), np.zeros((m, 2 * r + 12, CONTROLS))
    given[:, : 2 * r + 3, : 2 * r + 3] = np.eye(2 * r + 3)
    jump = -arm.inward * (unit[2 * r + 3] / unit[r : 2 * r, None]) if arm.moves else np.zeros((m, r, 3))
    if conditions.smooth:
        _smooth(given, free, segments, conditions, r)
    else:
        _straight(given, free, conditions, jump, r)
    start = np.zeros((2 * r + 9, 9))  # x at the first knot from c, v, a: before it the correction did not move
    start[2 * r :] = np.eye(9)
    start[r : 2 * r, 3:6] = jump[0]
    if conditions.resting[0]:
        start[:, 3:] = 0.0
    return given, free, start


def _smooth(given, free, segments: Segments, conditions: KnotConditions, r: int) -> None:
    v, a, j = (slice(2 * r + 3 * i, 2 * r + 3 * i + 3) for i in (1, 2, 3))
    time = segments.duration / np.median(segments.duration)
    for k in np.flatnonzero(~conditions.fixed).tolist():
        if conditions.resting[k]:
            free[k, a, 3:] = np.eye(3)  # a free bend after a stop
        else:
            given[k, v, v] = given[k, a, a] = np.eye(3)
        if conditions.resting[k + 1]:  # v + a t + j t^2 / 2 = 0
            given[k, j] = -2.0 / time[k] ** 2 * (given[k, v] + time[k] * given[k, a])
            free[k, j] = -2.0 / time[k] * free[k, a]
        else:
            free[k, j, :3] = np.eye(3)


def _straight(given, free, conditions: KnotConditions, jump: np.ndarray, r: int) -> None:
    v, rate = slice(2 * r + 3, 2 * r + 6), slice(r, 2 * r)
    given[0, v, v] = np.eye(3)
    for k in range(1, len(conditions.fixed)):
        given[k, rate, v] = -jump[k]  # at a corner u' jumps by -dv
        if not conditions.fixed[k]:
            free[k, v, :3] = np.eye(3)
            free[k, rate, :3] = jump[k]
