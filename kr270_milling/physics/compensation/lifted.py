"""The correction whose response of the arm takes the deviation away: weighted least squares over every knot at once.

The lifted model is d = d0 + H c: deviation d of the tool with the correction c of the knots, d0 without, H the response
of the arm. The sum of (d0 + H c)^T W (d0 + H c) and of the smoothness is made least segment by segment, backwards
(dynamic programming, [Bryson1975]): what is left to pay from a knot on is x^T P x / 2 + p^T x of the state x there. So
nothing of a slowly decaying response is cut off, and the cost is linear in the length of the path.

The matrices of a segment take 12 kB, the policy 1 kB. Windows of the path are solved one by one, each together with the
path beside it: memory does not grow with the path, and each core solves a window.

The numbers of one segment are y = [u, u', c, v, a, j]: relative modal coordinates of the arm and their rates, and the
cubic of the correction, 2 r + 12 of them; the state x at a knot is y without j. Where the correction is smooth j is
free; where the target stops the correction has no slope; straight lines have a free v.
"""

from __future__ import annotations

import functools
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import cast

import numpy as np
from numba import njit

from kr270_milling.physics.compensation.response import ArmResponse, Segments

WINDOW = 4096  #: segments that are solved at once
REACH = 3.0  #: [s], before and after a window: so long two corrections of the same deviation differ
CONTROLS = 6  #: most free numbers of a segment: a and j after a stop
TINY = 1e-12  #: share of the trace: keeps numbers that no sample shows from making a matrix singular


@dataclass(frozen=True, eq=False)
class KnotConditions:
    """Conditions on the correction at its m + 1 knots."""

    smooth: bool  #: C2 between stops; else straight lines
    resting: np.ndarray  #: (m + 1,) bool: the target stops at this knot
    fixed: np.ndarray  #: (m,) bool: the target rests along the whole segment, and so does the correction

    def cut(self, part: slice) -> KnotConditions:
        """Return the conditions of the segments of ``part``."""
        return KnotConditions(self.smooth, self.resting[part.start : part.stop + 1], self.fixed[part])


def in_windows(segments: Segments, solve: Callable[[tuple[slice, slice]], object], shorter: int = 1) -> None:
    """Call ``solve`` for windows of a path: WINDOW / ``shorter`` segments, and these with the path beside them."""
    m, beside, size = len(segments), int(np.ceil(REACH / np.median(segments.duration))), WINDOW // shorter
    inner = [slice(first, min(first + size, m)) for first in range(0, m, size)]
    windows = [(part, slice(max(0, part.start - beside), min(m, part.stop + beside))) for part in inner]
    with ThreadPoolExecutor(len(os.sched_getaffinity(0))) as pool:
        list(pool.map(solve, windows))


def knots(segments: Segments, cubic: np.ndarray) -> np.ndarray:
    """Values [m] of cubics (m, 4, 3) at the knots, (m + 1, 3)."""
    t = segments.duration[-1]
    c, v, a, j = cubic[-1]
    return np.vstack([cubic[:, 0], c + v * t + a * t**2 / 2.0 + j * t**3 / 6.0])


class Lifted:
    """The response of one arm along one path to every knot, to be solved for any deviation and weight.

    unit: of the whole path, where the segments are a part of it; see ``units``.
    """

    def __init__(
        self, arm: ArmResponse, segments: Segments, conditions: KnotConditions, unit: np.ndarray | None = None
    ):
        self.order, self.smooth = arm.order, conditions.smooth
        self._arm, self._segments, self._conditions = arm, segments, conditions
        self._unit = units(arm, segments) if unit is None else unit

    @functools.cached_property
    def _matrices(self) -> tuple[np.ndarray, ...]:
        """Outputs, transitions, given and free numbers of the segments."""
        first, run = self._arm.runs(self._segments.duration)
        arm = self._arm.cut(first)
        some = Segments(np.append(0, np.cumsum(np.diff(self._segments.time_ns)[first])), self._segments.parts)
        step = transitions(arm, some) * self._unit / self._unit[: 2 * self.order + 9, None]
        chosen = choices(self._arm, self._segments, self._conditions, self._unit)
        return (outputs(arm, some) * self._unit)[run], step[run], *chosen

    def least_squares(
        self, deviation: np.ndarray, weight: np.ndarray, smoothness: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """The best correction of deviations d0 [m], (m, parts, 3), under weights W (m, parts, 3, 3).

        Returns cubics c, v, a, j, (m, 4, 3), and what is left of the deviation [m], (m, parts, 3).

        smoothness: weight of the change of the correction's third (of straight lines: second) difference over a
        segment of the usual length.
        """
        cubic, left = np.zeros((len(self._segments), 4, 3)), np.array(deviation)

        def solve(window: tuple[slice, slice]) -> None:
            inner, part = window
            rows = slice(inner.start - part.start, inner.stop - part.start)
            small = Lifted(self._arm.cut(part), self._segments.cut(part), self._conditions.cut(part), self._unit)
            output = small._matrices[0]
            forced = (weight[part] @ deviation[part, ..., None]).reshape(len(output), 1, -1)
            slope = forced @ output.reshape(len(output), forced.shape[2], -1)
            local = small._solver(weight[part], smoothness)(slope[:, 0])[rows]
            left[inner] += (output[rows] @ local[:, None, :, None])[..., 0]
            cubic[inner] = (local * self._unit)[:, -12:].reshape(-1, 4, 3)

        in_windows(self._segments, solve)
        return cubic, left

    def prepared(self, weight: np.ndarray, smoothness: float) -> Callable[[np.ndarray], np.ndarray]:
        """Return the function from the slope of a cost by the cubics (m, 4, 3) to the cubics that are best with it."""
        solve, m = self._solver(weight, smoothness), len(self._segments)

        def best(slope: np.ndarray) -> np.ndarray:
            local = np.zeros((m, self._unit.size))
            local[:, -12:] = slope.reshape(-1, 12) * self._unit[-12:]
            return (solve(local) * self._unit)[:, -12:].reshape(-1, 4, 3)

        return best

    def _solver(self, weight: np.ndarray, smoothness: float) -> Callable[[np.ndarray], np.ndarray]:
        """Return the function from the slope of half a cost by y, (m, y), to the best y, (m, y), in units."""
        size = 2 * self.order + 9
        later = np.zeros((size, size))
        policy, factor = self._policy(weight, smoothness, later)
        _, step, from_state, free = self._matrices

        def solve(slope: np.ndarray) -> np.ndarray:
            linear, push, local = np.zeros(size), np.zeros((len(step), CONTROLS)), np.zeros(slope.shape)
            _backward_slope(slope, step, from_state, free, policy, factor, linear, push)
            _forward(step, from_state, free, policy, push, self._start(later, linear), local)
            return local

        return solve

    def _policy(self, weight: np.ndarray, smoothness: float, later: np.ndarray):
        """Policy and factors of what is free; P of the last knot becomes that of the first."""
        size = len(later)
        output, step, from_state, free = self._matrices
        moved = output.reshape(len(output), -1, size + 3)
        cost = np.swapaxes(moved, 1, 2) @ (weight @ output).reshape(moved.shape)
        bend = np.zeros((size + CONTROLS, size + CONTROLS))
        if self.smooth:  # weight of j
            cost[:, size:, size:] += smoothness * np.eye(3)
        else:
            difference = np.zeros((3, size + CONTROLS))  # what is free minus v of the state
            difference[:, size - 6 : size - 3], difference[:, size : size + 3] = -np.eye(3), np.eye(3)
            bend = smoothness * difference.T @ difference
        policy, factor = np.zeros((len(step), CONTROLS, size)), np.zeros((len(step), CONTROLS, CONTROLS))
        _backward(cost, step, from_state, free, bend, later, policy, factor)
        return policy, factor

    def _start(self, later: np.ndarray, linear: np.ndarray) -> np.ndarray:
        """The best state at the first knot."""
        start = first_state(self._arm, self._conditions, self._unit)
        chosen = start.T @ later @ start
        chosen += np.diag(np.where(np.diag(chosen) > 0.0, TINY * np.trace(chosen), 1.0))
        return -start @ np.linalg.solve(chosen, start.T @ linear)

    def roughness(self, cubic: np.ndarray, smoothness: float) -> np.ndarray:
        """Slopes of half the cost of the smoothness, (m, 4, 3)."""
        slope, unit = np.zeros_like(cubic), self._unit[2 * self.order + 3 :: 3]
        if self.smooth:
            slope[:, 3] = smoothness / unit[2] ** 2 * cubic[:, 3]
            return slope
        bend = smoothness / unit[0] ** 2 * np.diff(cubic[:, 1], axis=0)
        bend[self._conditions.fixed[1:]] = 0.0
        slope[1:, 1] += bend
        slope[:-1, 1] -= bend
        return slope

    def min_max(self, deviation, weight, smoothness: float, scored: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """As ``least_squares``, but with the least largest deviation in the parts ``scored`` (m, parts).

        Lawson's reweighting [Lawson1961]: parts with a large deviation gain weight; the weighted mean square is a lower
        bound of the largest one, so the end is known when it comes near.
        """
        share, least = np.ones(scored.shape), np.inf
        best: tuple[np.ndarray, np.ndarray] | None = None
        for _ in range(40 if scored.any() else 1):  # most reweightings
            cubic, left = self.least_squares(deviation, weight * share[..., None, None], smoothness)
            size = np.sqrt(np.einsum("kpi,kpij,kpj->kp", left, weight, left))[scored]
            if best is None or size.max() < least:
                best, least = (cubic, left), float(size.max(initial=0.0))
            now = share[scored]
            # a largest deviation within 2 % of the least possible one is good enough
            if size.max(initial=0.0) < TINY or least <= 1.02 * np.sqrt(np.sum(now * size**2) / np.sum(now)):
                break
            now = now * size / size.max()
            share[scored] = np.maximum(now / now.mean(), 1e-4)
        return cast(tuple[np.ndarray, np.ndarray], best)  # of one round at least


@njit(cache=True, error_model="numpy", nogil=True)
def _backward(cost, step, from_state, free, bend, later, policy, factor):
    """Fill policies and factors of each segment; P of the last knot becomes that of the first.

    bend: cost of the change of slope of straight lines, (x + CONTROLS, x + CONTROLS); 0: none.
    """
    # one number at a time where no matrix is multiplied: Numba compiles an assignment of arrays, and ``solve``, for
    # seconds each
    size, count, width = later.shape[0], policy.shape[1], step.shape[2]
    both, total = np.zeros((width, size + count)), np.zeros((size + count, size + count))
    for k in range(len(step) - 1, -1, -1):
        bent, plain = False, True  # plain: y is the state and three free numbers, and ``both`` changes nothing
        for i in range(width):
            for j in range(size):
                both[i, j] = from_state[k, i, j]
                plain &= both[i, j] == (1.0 if i == j else 0.0)
            for j in range(count):
                both[i, size + j] = free[k, i, j]
                plain &= free[k, i, j] == (1.0 if i == size + j else 0.0)
                bent |= free[k, i, j] != 0.0
        inner = step[k].T @ (later @ step[k])
        for i in range(width):
            for j in range(width):
                inner[i, j] += cost[k, i, j]
        if not plain:
            total = both.T @ (inner @ both)
        else:
            for i in range(size + count):
                for j in range(size + count):
                    total[i, j] = inner[i, j] if max(i, j) < width else 0.0
        if bent:
            for i in range(size + count):
                for j in range(size + count):
                    total[i, j] += bend[i, j]
        _factorise(total, size, factor[k])
        for j in range(size):
            _substitute(factor[k], total[size:, j], policy[k, :, j])
        for i in range(size):
            for j in range(size):
                for c in range(count):
                    total[i, j] += total[i, size + c] * policy[k, c, j]
        for i in range(size):
            for j in range(size):
                later[i, j] = 0.5 * (total[i, j] + total[j, i])


@njit(cache=True, error_model="numpy", nogil=True)
def _backward_slope(slope, step, from_state, free, policy, factor, linear, push):
    """Fill the push of each segment: its best free numbers are policy x + push; p of the last knot becomes that of the
    first. slope: of half the cost by y, (m, y)."""
    size, count, width = linear.size, policy.shape[1], step.shape[2]
    gradient = np.zeros(size + count)
    for k in range(len(step) - 1, -1, -1):
        for j in range(size + count):
            gradient[j] = 0.0
        for i in range(width):
            value = slope[k, i]
            for j in range(size):
                value += step[k, j, i] * linear[j]
            for j in range(size):
                gradient[j] += from_state[k, i, j] * value
            for j in range(count):
                gradient[size + j] += free[k, i, j] * value
        _substitute(factor[k], gradient[size:], push[k])
        for j in range(size):
            linear[j] = gradient[j]
            for c in range(count):
                linear[j] += policy[k, c, j] * gradient[size + c]


@njit(cache=True, error_model="numpy", nogil=True)
def _factorise(total, size, factor):
    """Fill the Cholesky factor (lower) of the block of the free numbers, regular by a share of its trace."""
    trace = 0.0
    for i in range(len(factor)):
        trace += total[size + i, size + i]
    for i in range(len(factor)):
        for j in range(i + 1):
            rest = 0.5 * (total[size + i, size + j] + total[size + j, size + i])
            if i == j:
                rest += TINY * trace if rest > 0.0 else 1.0
            for c in range(j):
                rest -= factor[i, c] * factor[j, c]
            factor[i, j] = np.sqrt(rest) if i == j else rest / factor[j, j]


@njit(cache=True, error_model="numpy", nogil=True)
def _substitute(factor, right, answer):
    """Fill the answer of L L^T answer = -right."""
    for i in range(len(factor)):
        rest = -right[i]
        for c in range(i):
            rest -= factor[i, c] * answer[c]
        answer[i] = rest / factor[i, i]
    for i in range(len(factor) - 1, -1, -1):
        rest = answer[i]
        for c in range(i + 1, len(factor)):
            rest -= factor[c, i] * answer[c]
        answer[i] = rest / factor[i, i]


@njit(cache=True, error_model="numpy", nogil=True)
def _forward(step, from_state, free, policy, push, state, local):
    """Fill y of each segment, from the state at its first knot, which becomes that of the last knot."""
    for k in range(len(step)):
        for i in range(local.shape[1]):
            local[k, i] = 0.0
            for j in range(state.size):
                local[k, i] += from_state[k, i, j] * state[j]
        for c in range(policy.shape[1]):
            value = push[k, c]
            for j in range(state.size):
                value += policy[k, c, j] * state[j]
            for i in range(local.shape[1]):
                local[k, i] += free[k, i, c] * value
        for i in range(state.size):
            state[i] = 0.0
            for j in range(local.shape[1]):
                state[i] += step[k, i, j] * local[k, j]


def units(arm: ArmResponse, segments: Segments) -> np.ndarray:
    """(2 r + 12,): unit of each number of y, chosen so that all numbers are lengths of similar size [m]."""
    time, size = float(np.median(segments.duration)), np.linalg.norm(arm.outward[:1], axis=(0, 1))
    size = np.maximum(size, 1e-6 * size.max(initial=1e-300))
    return np.concatenate([1.0 / size, 1.0 / (size * time), *(np.full(3, time**-i) for i in range(4))])


def outputs(arm: ArmResponse, segments: Segments) -> np.ndarray:
    """Motion of the tool in each part from y, (m, parts, 3, 2 r + 12)."""
    place, out = segments.place, arm.outward[:, None]
    free = arm.free(place)
    forced = arm.forced(place, free)
    swing = [out @ (f[..., None] * arm.inward[:, None]) if arm.moves else 0.0 for f in forced[:2]]
    straight = segments.powers[..., None, None, :] * np.eye(3)[:, :, None]  # (m, parts, 3, 3, 4)
    cubic = [straight[..., 0], straight[..., 1], straight[..., 2] + swing[0], straight[..., 3] + swing[1]]
    return arm.gain * np.concatenate([out * free[0][..., None, :], out * free[1][..., None, :], *cubic], axis=-1)


def transitions(arm: ArmResponse, segments: Segments) -> np.ndarray:
    """x at the next knot from y, (m, 2 r + 9, 2 r + 12)."""
    duration, r = segments.duration[:, None], arm.order
    free = arm.free(duration)
    h11, h12, h21, h22 = (h[:, 0, None] for h in free)
    of_bend, of_jerk, rate_of_bend, rate_of_jerk = (f[:, 0, :, None] * arm.inward for f in arm.forced(duration, free))
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


def choices(
    arm: ArmResponse, segments: Segments, conditions: KnotConditions, unit: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """y of a segment, in units, from the arriving state x and from what is free there: (m, y, x), (m, y, CONTROLS)."""
    m, r = len(segments), arm.order
    from_state, free = np.zeros((m, 2 * r + 12, 2 * r + 9)), np.zeros((m, 2 * r + 12, CONTROLS))
    from_state[:, : 2 * r + 3, : 2 * r + 3] = np.eye(2 * r + 3)
    if conditions.smooth:
        _smooth(from_state, free, segments.duration * unit[2 * r + 3], conditions, r)
    else:
        _straight(from_state, free, conditions, _jump(arm, unit), r)
    return from_state, free


def first_state(arm: ArmResponse, conditions: KnotConditions, unit: np.ndarray) -> np.ndarray:
    """x at the first knot from c, v, a of the correction there, (x, 9): before it the correction did not move."""
    r = arm.order
    start = np.zeros((2 * r + 9, 9))
    start[2 * r :] = np.eye(9)
    start[r : 2 * r, 3:6] = _jump(arm, unit)[0]
    if conditions.resting[0]:
        start[:, 3:] = 0.0
    return start


def _jump(arm: ArmResponse, unit: np.ndarray) -> np.ndarray:
    """u' by a change of the slope of the correction, (m, r, 3)."""
    r = arm.order
    return -arm.inward * (unit[2 * r + 3] / unit[r : 2 * r, None]) if arm.moves else np.zeros(arm.inward.shape)


def _smooth(from_state, free, time, conditions: KnotConditions, r: int) -> None:
    v, a, j = (slice(2 * r + 3 * i, 2 * r + 3 * i + 3) for i in (1, 2, 3))
    moving, rests, stops = ~conditions.fixed, conditions.resting[:-1], conditions.resting[1:]
    from_state[moving & ~rests, v, v] = from_state[moving & ~rests, a, a] = np.eye(3)
    free[moving & rests, a, 3:] = np.eye(3)  # a free bend after a stop
    k, time = moving & stops, time[moving & stops, None, None]  # v + a t + j t^2 / 2 = 0
    from_state[k, j] = -2.0 / time**2 * (from_state[k, v] + time * from_state[k, a])
    free[k, j] = -2.0 / time * free[k, a]
    free[moving & ~stops, j, :3] = np.eye(3)


def _straight(from_state, free, conditions: KnotConditions, jump: np.ndarray, r: int) -> None:
    v, rate = slice(2 * r + 3, 2 * r + 6), slice(r, 2 * r)
    corner = np.arange(len(from_state)) >= 1  # at the first knot the slope is that of the first state
    from_state[~corner, v, v] = np.eye(3)
    from_state[corner, rate, v] = -jump[corner]  # at a corner u' jumps by -dv
    k = corner & ~conditions.fixed
    free[k, v, :3] = np.eye(3)
    free[k, rate, :3] = jump[k]
