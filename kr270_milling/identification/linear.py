"""Linear least squares with 95 % intervals: x = (A^T A)^-1 A^T b, cov(x) = s^2 (A^T A)^-1, rows in standard deviations.

Stated standard deviations are believed, s = 1, unless the residuals contradict them: where chi^2 is larger than in 1 of
100 cases, s^2 = chi^2 / (m - p), the Birge ratio. Where none are stated, s^2 = chi^2 / (m - p) and the interval is
Student's.
"""

from __future__ import annotations

import numpy as np
from scipy import stats

__all__ = ["MixedUpError", "half_interval", "scatter", "solve"]

WORST = 1e-6  #: share of the largest singular value, columns of length 1, below which unknowns are mixed up


class MixedUpError(ValueError):
    """Fewer rows than unknowns, or columns that are alike; whoever knows what they are says it in words."""


def scatter(chi2: float, freedom: int, known: bool) -> float:
    """s^2."""
    if known and not (freedom > 0 and chi2 > stats.chi2.ppf(0.99, freedom)):
        return 1.0
    return chi2 / freedom if freedom else np.inf


def half_interval(freedom: int, known: bool) -> float:
    """Standard deviations in half of a 95 % interval."""
    if known or not freedom:
        return float(stats.norm.ppf(0.975))
    return float(stats.t.ppf(0.975, freedom))


def solve(a: np.ndarray, b: np.ndarray, known: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Solution (p,), covariance (p, p), half widths (p,) of the intervals; A (m, p), b (m,). Raises MixedUpError."""
    lengths = np.linalg.norm(a, axis=0)
    unit = a / np.where(lengths > 0.0, lengths, 1.0)
    singular = np.linalg.svd(unit, compute_uv=False)
    freedom = len(b) - a.shape[1]
    if freedom < 0 or not singular[-1] >= WORST * singular[0] > 0.0:
        raise MixedUpError
    x = np.linalg.lstsq(unit, b, rcond=None)[0] / lengths
    chi2 = float(np.sum((b - a @ x) ** 2))
    covariance = scatter(chi2, freedom, known) * np.linalg.inv(unit.T @ unit) / np.outer(lengths, lengths)
    return x, covariance, half_interval(freedom, known) * np.sqrt(np.diag(covariance))
