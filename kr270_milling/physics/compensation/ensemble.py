"""The response of many robots to one correction: slopes of their mean cost, all robots at once.

The numbers of one segment are y = [u, p, y, y', c, v, a, j]: modal coordinates u of the arm relative to its motors and
p = u' + L v, which no corner of the motors' path changes (L: reference -> modal coordinates), place and velocity of the
motors, and the cubic of the correction. One matrix for each kind of segment (posture, duration) leads to the motion
of the tool in each part and to [u, p, y, y'] at the next knot. The compiled loop multiplies the matrices of all robots.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numba import njit

from kr270_milling.physics.compensation.lifted import KnotConditions, Lifted, in_windows, outputs, transitions, units
from kr270_milling.physics.compensation.response import ArmResponse, Segments

STEPS = 30  #: most conjugate gradients


def least_mean_square(
    arm: ArmResponse,
    segments: Segments,
    conditions: KnotConditions,
    robots: Sequence[tuple[ArmResponse, np.ndarray]],
    shares: np.ndarray,
    weight: np.ndarray,
    smoothness: float,
    settled: float,
) -> np.ndarray:
    """Cubics (m, 4, 3) of the correction with the least mean cost of n robots: response H_k, deviation d_k, share s_k.

    sum_k s_k H_k^T W (d_k + H_k c) / n + S c = 0   where the mean of s_k (d_k + H_k c)^T W (d_k + H_k c) is least

    arm: of the model. Conjugate gradients [HestenesStiefel1952] among the corrections that the knots allow,
    preconditioned by ``Lifted`` with the slow modes of a mean robot. They end where a step gains less than ``settled``
    [m^2], so robots without a deviation leave no correction. Windows of the path are solved one by one, each together
    with the path beside it. Time is linear in the length of the path, memory does not grow with it.
    """
    frequency, m = np.array([response.frequency[0] for response, _ in robots]), len(segments)
    slow = arm.frequency[0] * float(np.median(segments.duration)) < 4.0  # [rad]: a correction moves no faster mode
    between = np.exp(np.log(frequency / arm.frequency[0]).mean(axis=0))
    # assumed: robots that differ in frequency answer in the mean as one with three times the damping
    mean = arm.scaled(between, 3.0).modes(slow)
    unit = units(mean, segments)
    cubic = np.zeros((m, 4, 3))
    # each kind of segment has 250 kB of matrices: short windows where many segments are a kind by themselves
    posture, steps = robots[0][0].posture, np.diff(segments.time_ns)
    varied = posture is None or np.mean((np.diff(posture) != 0) | (np.diff(steps) != 0)) > 0.1

    def solve(window: tuple[slice, slice]) -> None:
        inner, part = window
        model = Lifted(mean.cut(part), segments.cut(part), conditions.cut(part), unit)
        ensemble = Ensemble(robots, shares, segments, weight, part)
        precondition = model.prepared(weight[part], smoothness)
        solution = np.zeros((part.stop - part.start, 4, 3))
        rest, direction, before = ensemble.slope(solution, 1.0), solution, np.inf
        for _ in range(STEPS):
            better = precondition(rest)
            gain = -float(np.sum(rest * better))
            if not gain > settled * len(solution) / m:
                break
            direction = better + gain / before * direction
            bent = ensemble.slope(direction, 0.0) + model.roughness(direction, smoothness)
            step = gain / np.sum(direction * bent)
            solution, rest, before = solution + step * direction, rest + step * bent, gain
        cubic[inner] = solution[inner.start - part.start :][: inner.stop - inner.start]

    in_windows(segments, solve, 8 if varied else 1)
    return cubic


class Ensemble:
    """Robots with response, deviation [m] (m, parts, 3) and share of the cost, along a ``part`` of a path."""

    def __init__(
        self,
        robots: Sequence[tuple[ArmResponse, np.ndarray]],
        shares: np.ndarray,
        segments: Segments,
        weight: np.ndarray,
        part: slice,
    ):
        whole, self._shares = np.arange(len(segments)), shares / len(robots)
        rows = np.stack([whole if arm.posture is None else arm.posture for arm, _ in robots])
        after = np.append(rows[:, 1:], rows[:, -1:], axis=1)
        kinds = np.vstack([np.diff(segments.time_ns), rows, after])[:, part]
        _, first, self._kind = np.unique(kinds, axis=1, return_index=True, return_inverse=True)
        sample = Segments(np.append(0, np.cumsum(kinds[0, first])), segments.parts)
        first += part.start
        following = np.minimum(first + 1, whole[-1])
        matrices = [_matrix(arm.cut(first), arm.cut(following).inward, sample) for arm, _ in robots]
        forward = np.stack(matrices)
        self._forward, self._backward = (_widened(rows) for rows in (forward, np.swapaxes(forward, -1, -2)))
        self._deviation = np.stack([deviation[part].reshape(-1, 3 * segments.parts) for _, deviation in robots])
        self._weight = np.ascontiguousarray(weight[part])

    def slope(self, cubic: np.ndarray, share: float) -> np.ndarray:
        """Slope of half the cost by cubics (m, 4, 3), with this share of the deviations."""
        pulled, flat = np.zeros((len(cubic), 12)), np.ascontiguousarray(cubic).reshape(-1, 12)
        matrices = self._kind, self._forward, self._backward
        _slope(*matrices, share, self._deviation, self._weight, self._shares, flat, pulled)
        return pulled.reshape(-1, 4, 3)


def _widened(rows: np.ndarray) -> np.ndarray:
    """Zeros behind the rows up to a multiple of 16 numbers, which a processor multiplies without a rest."""
    return np.pad(rows, [(0, 0)] * 3 + [(0, -rows.shape[-1] % 16)])


def _matrix(arm: ArmResponse, next_inward: np.ndarray, segments: Segments) -> np.ndarray:
    """Motion of the tool in each part and [u, p, y, y'] at the next knot from y, (kinds, 3 parts + 2 r + 6, y)."""
    motors = 6  # numbers of place and velocity of the motors
    r, m = arm.order, len(segments)
    inward, after = (rows if arm.moves else np.zeros_like(rows) for rows in (arm.inward, next_inward))
    moved, swung = outputs(arm, segments).reshape(m, -1, 2 * r + 12), transitions(arm, segments)[:, : 2 * r]
    for matrix in (moved, swung):
        matrix[:, :, 2 * r + 3 : 2 * r + 6] -= matrix[:, :, r : 2 * r] @ inward
    powers = segments.duration[:, None] ** np.arange(3) / [1.0, 1.0, 2.0]
    swung[:, r:, 2 * r + 3 :] += (powers[:, None, :, None] * after[:, :, None]).reshape(m, r, 9)
    answer = np.zeros((m, moved.shape[1] + 2 * r + motors, 2 * r + motors + 12))
    arm_rows, motor_rows = slice(0, moved.shape[1] + 2 * r), slice(moved.shape[1] + 2 * r, None)
    both = np.concatenate([moved, swung], axis=1)
    answer[:, arm_rows, : 2 * r] = both[:, :, : 2 * r]
    if arm.lag is None:
        answer[:, arm_rows, 2 * r + motors :] = both[:, :, 2 * r :]
        return answer
    free, driven, hermite = arm.lag.matrices(segments.duration)
    ends = np.concatenate([free, driven], axis=2)
    cubic = hermite[:, :, 2:] @ ends
    cubic[:, :, :2] += hermite[:, :, :2]
    ends, cubic = (np.kron(rows, np.eye(3)) for rows in (ends, cubic))
    answer[:, arm_rows, 2 * r :] = both[:, :, 2 * r :] @ cubic
    answer[:, motor_rows, 2 * r :] = ends
    return answer


# sums in any order, so that the processor takes several numbers at a time
@njit(cache=True, error_model="numpy", nogil=True, fastmath={"reassoc", "contract", "nsz"})
def _slope(kind, forward, backward, share, deviation, weight, shares, cubic, pulled):
    """Add the slopes by cubics (m, 12) to ``pulled``.

    forward: (n, kinds, 3 parts and states, y), zeros behind y; backward: (n, kinds, y, 3 parts and states).
    """
    n, _, width, height = backward.shape
    m, parts = weight.shape[:2]
    states, moved = width - 12, 3 * parts
    left, last = np.zeros((m, moved)), height - moved
    y, answer, motors = np.zeros(forward.shape[3]), np.zeros(height), states - 6
    for e in range(n):
        for j in range(states):
            y[j] = 0.0
        for j in range(3):  # the motors are on the first value of the correction
            y[motors + j] = cubic[0, j]
        for k in range(m):
            matrix = forward[e, kind[k]]
            for j in range(12):
                y[states + j] = cubic[k, j]
            for i in range(moved):
                value = share * deviation[e, k, i]
                for j in range(y.size):
                    value += matrix[i, j] * y[j]
                left[k, i] = value
            for i in range(states):
                value = 0.0
                for j in range(y.size):
                    value += matrix[moved + i, j] * y[j]
                answer[i] = value
            for j in range(states):
                y[j] = answer[j]
        for i in range(height):
            answer[i] = 0.0
        for k in range(m - 1, -1, -1):
            matrix = backward[e, kind[k]]
            for p in range(parts):
                for i in range(3):
                    value = 0.0
                    for j in range(3):
                        value += weight[k, p, i, j] * left[k, 3 * p + j]
                    answer[3 * p + i] = shares[e] * value
            for j in range(width):
                value = 0.0
                for i in range(height):
                    value += matrix[j, i] * answer[i]
                y[j] = value
            for j in range(last):
                answer[moved + j] = y[j] if j < states else 0.0
            for j in range(12):
                pulled[k, j] += y[states + j]
        for j in range(3):
            pulled[0, j] += y[motors + j]
