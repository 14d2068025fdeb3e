"""Weights that take outliers out: Tukey's biweight, with the scale from the median."""

from __future__ import annotations

import numpy as np
from scipy.stats import chi2

__all__ = ["robust_weights"]

TUKEY = 4.685  #: 95 % efficiency for normal residuals of one number a test [Tukey's biweight]


def robust_weights(residuals: np.ndarray) -> np.ndarray:
    """One weight for each test (n,), 0 to 1, from its residuals (n, k), NaN where not measured: (1 - u^2)^2, u < 1."""
    u = _shares(residuals)
    return np.where(u < 1.0, (1.0 - u**2) ** 2, 0.0)


def _shares(residuals: np.ndarray) -> np.ndarray:
    """u (n,): the length of a test's residuals over the length c_k s at which it loses all weight.

    Its square is s^2 times a chi^2 distributed number; s comes from the median, c_k cuts off the same share as TUKEY
    does for one number.
    """
    count = np.isfinite(residuals).sum(1)
    length = np.sqrt(np.nansum(residuals**2, axis=1))
    scale = float(np.median(length / np.sqrt(chi2.ppf(0.5, count))))
    cut = np.sqrt(chi2.isf(chi2.sf(TUKEY**2, 1), count))
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
