"""The C2 cubic spline over the knots of a trajectory that is nearest to a series of samples; at rest where it must be.

Bandwidth 4 whatever the length of the path: cost and memory are linear in samples and knots.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline, CubicSpline
from scipy.linalg import solve_banded, solveh_banded

__all__ = ["knot_rates", "spline_fit"]

ROUNDS = 200  #: most reweightings
PATIENCE = 10  #: rounds within which it must gain half a percent
CLOSE = 1.01  #: the largest error of a fit is within 1 % of the least possible one: it is good enough
BARELY = 1e-6  #: weight of a sample that only keeps the spline bounded
PAIRS = [(a, b) for a in range(4) for b in range(a, 4)]


def knot_rates(time: np.ndarray, values: np.ndarray, resting: np.ndarray | None, ends: str = "natural") -> np.ndarray:
    """Slopes (n, 3) at times (n,) of the cubic spline through ``values`` (n, 3): C2, and 0 where ``resting`` (n,).

    At a resting knot the spline is C1. ends: "natural" or "not-a-knot", for first and last knots that do not rest.
    """
    if resting is None or not resting.any():
        return CubicSpline(time, values, bc_type=ends)(time, 1)
    step = np.diff(time)
    slope = np.diff(values, axis=0) / step[:, None]
    below, middle, above = np.zeros(time.size), np.full(time.size, 2.0), np.zeros(time.size)
    right = np.zeros_like(values)
    below[1:-1], above[1:-1] = step[1:], step[:-1]  # C2 at the inner knots
    middle[1:-1] = 2.0 * (step[1:] + step[:-1])
    right[1:-1] = 3.0 * (step[1:, None] * slope[:-1] + step[:-1, None] * slope[1:])
    above[0] = below[-1] = 1.0  # natural ends
    right[0], right[-1] = 3.0 * slope[0], 3.0 * slope[-1]
    below[resting], above[resting], middle[resting], right[resting] = 0.0, 0.0, 1.0, 0.0
    bands = np.stack([np.append(0.0, above[:-1]), middle, np.append(below[1:], 0.0)])
    return solve_banded((1, 1), bands, right)


def spline_fit(
    knots_ns, time_ns, error, scored, criterion: str = "min_max", resting=None, unscored=BARELY
) -> np.ndarray:
    """Values (k, 3) at the knots [ns], (k,), of the spline nearest to ``error`` (n, 3) at times [ns], (n,).

    "least_squares", or "min_max" by Lawson's reweighting [Lawson1961], over the samples where ``scored`` (n,) is set;
    the others, with the weight ``unscored``, (n,) or one, only keep the spline bounded. Where ``resting`` (k,) is set
    the spline has no slope, as ``knot_rates`` makes it.
    """
    inside = (time_ns >= knots_ns[0]) & (time_ns <= knots_ns[-1])
    knots, scored = knots_ns * 1e-9, scored[inside]
    basis = _basis(time_ns[inside] * 1e-9, knots, np.zeros(knots.size, bool) if resting is None else resting)
    fit = _least_squares if criterion == "least_squares" or not scored.any() else _min_max
    weight = np.where(scored, 1.0, np.broadcast_to(unscored, time_ns.shape)[inside])
    return np.stack([basis.at_knots(fit(basis, e, scored, weight)) for e in error[inside].T], axis=1)


@dataclass(frozen=True, eq=False)
class _Basis:
    """B-splines of the samples; two of them that a resting knot ties together share one coefficient."""

    value: np.ndarray  # (n, 4), of the four that are not 0 at each sample
    product: np.ndarray  # (n, 10), of each two of them, in the order of PAIRS
    column: np.ndarray  # (m, 4), coefficients in each of the m spans that hold samples
    start: np.ndarray  # (m,), first sample of each span
    span: np.ndarray  # (n,), span of each sample
    merged: np.ndarray  # (c,), coefficient of each B-spline
    breaks: np.ndarray  # knot vector
    knots: np.ndarray  # [s], (k,)

    def solve(self, values: np.ndarray, weight: np.ndarray) -> np.ndarray:
        """Coefficients of the weighted least squares by banded normal equations."""
        size = self.merged[-1] + 1
        bands, right = np.zeros((4, size)), np.zeros(size)
        sums = np.add.reduceat(self.product * weight[:, None], self.start)
        for (a, b), total in zip(PAIRS, sums.T, strict=True):
            first, second = self.column[:, a], self.column[:, b]
            twice = 2.0 if a != b else 1.0  # both halves of the symmetric matrix fall on one entry
            np.add.at(bands, (second - first, first), np.where((first == second), twice, 1.0) * total)
        for a, total in enumerate(np.add.reduceat(self.value * (weight * values)[:, None], self.start).T):
            np.add.at(right, self.column[:, a], total)
        bands[0] += 1e-9 * bands[0].max()  # a knot span without a sample stays where it is
        return solveh_banded(bands, right, lower=True)

    def sample(self, fit: np.ndarray) -> np.ndarray:
        return np.sum(self.value * fit[self.column][self.span], axis=1)

    def at_knots(self, fit: np.ndarray) -> np.ndarray:
        return BSpline(self.breaks, fit[self.merged], 3)(self.knots)


def _basis(time: np.ndarray, knots: np.ndarray, resting: np.ndarray) -> _Basis:
    """As many coefficients as knots: not-a-knot ends, or a tie at a resting end; a resting knot is double and tied.

    At a double knot only two cubic B-splines are not 0, and the slope there is proportional to the difference of
    their coefficients; at the end of the knot vector likewise.
    """
    inner = np.repeat(knots[1:-1], np.where(resting[1:-1], 2, 1))
    first, last = 0 if resting[0] else 1, inner.size if resting[-1] else inner.size - 1
    breaks = np.concatenate([np.repeat(knots[0], 4), inner[first:last], np.repeat(knots[-1], 4)])
    count = breaks.size - 4
    tied = np.zeros(count, bool)  # to the coefficient before
    tied[1] = resting[0]
    tied[-1] |= resting[-1]
    double = np.flatnonzero(breaks[4:-4][1:] == breaks[4:-4][:-1]) + 4
    tied[double - 1] = True
    merged = np.cumsum(~tied) - 1
    design = BSpline.design_matrix(time, breaks, 3)
    value, left = design.data.reshape(-1, 4), design.indices.reshape(-1, 4)[:, 0]
    start = np.flatnonzero(np.diff(left, prepend=-1))
    span = np.repeat(np.arange(start.size), np.diff(np.append(start, time.size)))
    product = np.stack([value[:, a] * value[:, b] for a, b in PAIRS], axis=1)
    column = merged[left[start][:, None] + np.arange(4)]
    return _Basis(value, product, column, start, span, merged, breaks, knots)


def _least_squares(basis: _Basis, values: np.ndarray, scored: np.ndarray, weight: np.ndarray) -> np.ndarray:
    return basis.solve(values, weight)


def _min_max(basis: _Basis, values: np.ndarray, scored: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Lawson: samples with a large error gain weight. The weighted mean square is a lower bound of the largest error,
    so the end is known when it comes near."""
    weight, best, least = weight.copy(), None, np.inf
    reached = [np.inf] * PATIENCE
    for _ in range(ROUNDS):
        fit = basis.solve(values, weight)
        rest = np.abs(values - basis.sample(fit))[scored]
        largest = rest.max()
        if largest < least:
            best, least = fit, largest
        share = weight[scored]
        if largest < 1e-12 or least <= CLOSE * np.sqrt(np.sum(share * rest**2) / np.sum(share)):
            break
        reached.append(least)
        if least > 0.995 * reached[-1 - PATIENCE]:
            break
        share = share * rest / largest
        weight[scored] = np.maximum(share / share.mean(), 1e-4)
    return best
