"""Least squares with 95 % intervals: cov(x) = s^2 (A^T W A)^-1, rows in standard deviations; weights against outliers.

Stated standard deviations are believed, s = 1, unless the residuals contradict them: where chi^2 is larger than in 1 of
100 cases, s^2 = chi^2 / (m - p), the Birge ratio. Where none are stated, s^2 = chi^2 / (m - p) and the interval is
Student's.
"""

from __future__ import annotations

import numpy as np
from scipy import stats


class MixedUpError(ValueError):
    """Fewer rows than unknowns, or columns that are alike; the caller knows their names."""


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


def solve(a: np.ndarray, b: np.ndarray, known: bool) -> tuple[np.ndarray, np.ndarray]:
    """Solution (p,) and half widths (p,) of its intervals; A (m, p), b (m,). Raises MixedUpError."""
    lengths = np.linalg.norm(a, axis=0)
    unit = a / np.where(lengths > 0.0, lengths, 1.0)
    singular = np.linalg.svd(unit, compute_uv=False)
    freedom = len(b) - a.shape[1]
    worst = 1e-6  # share of the largest singular value, columns of length 1, below which unknowns are mixed up
    if freedom < 0 or not singular[-1] >= worst * singular[0] > 0.0:
        raise MixedUpError
    x = np.linalg.lstsq(unit, b, rcond=None)[0] / lengths
    chi2 = float(np.sum((b - a @ x) ** 2))
    variance = scatter(chi2, freedom, known) * np.diag(np.linalg.inv(unit.T @ unit)) / (lengths * lengths)
    return x, half_interval(freedom, known) * np.sqrt(variance)


def robust_weights(residuals: np.ndarray) -> np.ndarray:
    """Return a weight for each test (n,): (1 - u^2)^2, u < 1, from its residuals (n, k), NaN where not measured."""
    u = _shares(residuals)
    return np.where(u < 1.0, (1.0 - u**2) ** 2, 0.0)


def _shares(residuals: np.ndarray) -> np.ndarray:
    """u (n,): the length of a test's residuals over the length c_k s at which it loses all weight.

    Its square is s^2 times a chi^2 distributed number; s comes from the median, c_k cuts off the same share as TUKEY
    does for one number.
    """
    count = np.isfinite(residuals).sum(1)
    length = np.sqrt(np.nansum(residuals**2, axis=1))
    scale = float(np.median(length / np.sqrt(stats.chi2.ppf(0.5, count))))
    tukey = 4.685  # 95 % efficiency for normal residuals of one number a test [Tukey's biweight]
    cut = np.sqrt(stats.chi2.isf(stats.chi2.sf(tukey**2, 1), count))
    return length / np.maximum(scale * cut, 1e-300)


def robust_variance(residuals: np.ndarray, sought: int) -> float:
    """s^2 in cov = s^2 (A^T A)^-1 of an M-estimate [Huber1981, section 7.6].

    s^2 = K^2 [sum psi^2 / (m - p)] / mean(psi')^2, K = 1 + p / m var(psi') / mean(psi')^2, psi = w r of m numbers;
    psi' = (1 - u^2)^2 - 4 u^2 (1 - u^2) / k, its mean over the k directions of a test.
    """
    u, count = _shares(residuals), np.isfinite(residuals).sum(1)
    inside = np.maximum(1.0 - u**2, 0.0)
    slope = inside**2 - 4.0 * u**2 * inside / count
    m = int(count.sum())
    psi = np.nansum((inside**2)[:, None] ** 2 * residuals**2)
    mean = float(np.average(slope, weights=count))
    spread = float(np.average((slope - mean) ** 2, weights=count))
    correction = 1.0 + sought / m * spread / mean**2
    return correction**2 * float(psi) / max(1, m - sought) / mean**2
