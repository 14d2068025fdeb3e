"""Joint compliances from load tests: weighted non-linear least squares on the loaded model, with their intervals.

minimise sum w_i r_i(x)^2,  r = (model(x) - measurement) / sigma,  cov(x) = s^2 (A^T W A)^-1,  A = dr/dx.

s^2 and the interval are those of ``linear``; where no standard deviations are stated, they are estimated from the
residuals, of translations and rotations each for itself.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from scipy import stats
from scipy.optimize import least_squares
from scipy.stats import chi2

from kr270_milling.base.errors import MillingError
from kr270_milling.identification.identifiability import held_numbers, hidden, why_held
from kr270_milling.identification.linear import half_interval, scatter
from kr270_milling.identification.problem import Problem

__all__ = ["Fit", "TooFewError", "fit", "robust_weights"]

#: relative standard deviation of a number that the data cannot tell, as in the cell's ``uncertainty``: assumed
PRIOR = 0.15
ROUNDS = 30


class TooFewError(MillingError):
    """Fewer numbers were measured than are sought."""

    def __init__(self, measured: int, sought: int):
        self.measured, self.sought = measured, sought
        super().__init__(f"{measured} numbers cannot tell {sought} unknown ones; measure more loads or postures")


@dataclass(frozen=True, eq=False)
class Fit:
    """What the load tests say of the arm."""

    problem: Problem  #: with the standard deviations that were used
    factors: np.ndarray  #: on the arm file's numbers, (p,)
    free: np.ndarray  #: (p,) bool: fitted; the others are as in the arm file
    reasons: dict[int, str]  #: of those that are not
    covariance: np.ndarray  #: of the factors, (p, p), with PRIOR for those that are held
    quantile: float  #: half width of a 95 % interval in standard deviations
    weights: np.ndarray  #: of each load test, (n,); 1 unless robust
    chi2_reduced: float  #: weighted sum of the squares of the residuals over the degrees of freedom

    @property
    def values(self) -> np.ndarray:
        """Compliances [rad/(N m)], then the compensator's numbers [SI], (p,)."""
        return self.factors * self.problem.scale

    @property
    def half_widths(self) -> np.ndarray:
        """Of the 95 % intervals, (p,), infinite where the data cannot tell."""
        sigma = np.sqrt(np.diag(self.covariance)) * np.abs(self.problem.scale)
        return np.where(self.free, self.quantile * sigma, np.inf)

    @property
    def correlation(self) -> np.ndarray:
        """(p, p); 0 beside those that are held."""
        sigma = np.sqrt(np.diag(self.covariance))
        both = self.free[:, None] & self.free[None, :]
        return np.where(both, self.covariance / np.outer(sigma, sigma), np.eye(len(sigma)))

    @property
    def residuals(self) -> np.ndarray:
        """Measured less modelled [m, rad], (n, 6)."""
        return self.problem.measured.displacement - self.problem.predict(self.factors)

    @property
    def residual_rms(self) -> float:
        """Of the translations [m], of the load tests with weight."""
        rows = self.residuals[self.weights > 0.0, :3]
        return float(np.sqrt(np.nanmean(rows**2)))

    @property
    def normality(self) -> float:
        """p-value of the test of Shapiro and Wilk: below 0.05 the residuals are hardly normal; NaN for fewer than 3."""
        scaled = (self.residuals / self.problem.measured.sigma)[self.problem.finite]
        return float(stats.shapiro(scaled[:5000]).pvalue) if scaled.size >= 3 and np.ptp(scaled) > 0.0 else float("nan")

    @property
    def arm(self):
        """The identified arm."""
        return self.problem.arm_at(self.factors)


def fit(problem: Problem, robust: bool = False) -> Fit:
    """Identify; robust: tests that contradict the others lose their weight. Raises TooFewError, SoftArmError.

    A number that the data cannot tell stays as the arm file has it: one without effect, one that is mixed up with
    another, and one whose interval would reach beyond zero. The others' intervals then hold its uncertainty, PRIOR.
    """
    held = held_numbers(problem.derivatives(problem.start))
    reasons = {k: why_held(problem, k, partner) for k, partner in held.items()}
    while True:
        free = np.array([k not in reasons for k in range(len(problem.start))])
        found = _fitted(problem, free, robust)
        relative = found.half_widths / np.maximum(np.abs(found.values), 1e-300)
        relative[~free | (found.factors <= 0.0) & (np.arange(len(free)) < 6)] = 0.0
        relative[free & (found.factors <= 0.0) & (np.arange(len(free)) < 6)] = np.inf
        worst = int(np.argmax(relative))
        if not relative[worst] >= 1.0:
            return dataclasses.replace(found, reasons=reasons)
        noise = f"{problem.names[worst]}: what it does is below the noise, its 95 % interval would reach beyond zero"
        reasons[worst] = worst < 6 and hidden(problem, worst) or noise


def _fitted(problem: Problem, free: np.ndarray, robust: bool) -> Fit:
    measured = int(problem.finite.sum())
    if measured <= free.sum():
        raise TooFewError(measured, int(free.sum()))
    weights, x = np.ones(len(problem.measured)), problem.start
    for _ in range(ROUNDS):
        x = _solved(problem, x, free, weights)
        left = _by_test(problem, problem.residuals(x))
        new = robust_weights(left) if robust else weights
        scaled = problem if problem.measured.sigma_known else _with_estimated_sigma(problem, left, weights, free)
        done = np.abs(new - weights).max() < 1e-3 and np.allclose(scaled.measured.sigma, problem.measured.sigma, 1e-4)
        problem, weights = scaled, new
        if done:
            break
    return _with_covariance(problem, x, free, weights, robust)


def _solved(problem: Problem, x: np.ndarray, free: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """The factors of least weighted squares."""
    if not free.any():
        return x
    root = np.sqrt(np.repeat(weights, 6)[problem.finite.ravel()])
    known: dict[bytes, tuple] = {}  # residuals and derivatives of one place come from one evaluation

    def linearised(part):
        key = part.tobytes()
        if key not in known:
            known.clear()
            known[key] = problem.linearised(_inserted(part, x, free))
        return known[key]

    solved = least_squares(
        lambda part: root * linearised(part)[0],
        x[free],
        lambda part: root[:, None] * linearised(part)[1][:, free],
        method="lm",
        xtol=1e-8,
        ftol=1e-12,
    )
    return _inserted(solved.x, x, free)


def _inserted(part: np.ndarray, x: np.ndarray, free: np.ndarray) -> np.ndarray:
    full = x.copy()
    full[free] = part
    return full


def _by_test(problem: Problem, residuals: np.ndarray) -> np.ndarray:
    """(n, 6), NaN where nothing was measured."""
    table = np.full(problem.finite.shape, np.nan)
    table[problem.finite] = residuals
    return table


def _with_estimated_sigma(problem: Problem, left: np.ndarray, weights: np.ndarray, free: np.ndarray) -> Problem:
    """Standard deviations so that translations and rotations scatter by 1 each; p / m of each is taken by the fit."""
    sigma = problem.measured.sigma.copy()
    share = 1.0 - free.sum() / problem.finite.sum()
    for part in (slice(0, 3), slice(3, 6)):
        used = np.isfinite(left[:, part]) & (weights[:, None] > 0.0)
        if used.any():
            heavy = np.broadcast_to(weights[:, None], used.shape)[used]
            square = np.sum(heavy * left[:, part][used] ** 2) / np.sum(heavy) / share
            sigma[:, part] *= np.sqrt(max(square, 1e-24))
    measured = dataclasses.replace(problem.measured, sigma=sigma)
    return dataclasses.replace(problem, measured=measured)


def _with_covariance(problem: Problem, x, free, weights, robust: bool) -> Fit:
    """The record, with cov = s^2 (A^T W A)^-1 and what the held numbers add."""
    each = np.repeat(weights, 6)[problem.finite.ravel()]
    left, a = problem.linearised(x)
    freedom = max(1, int((each > 0.0).sum() - free.sum()))
    chi2 = float(np.sum(each * left**2))
    known = problem.measured.sigma_known and not robust
    square = robust_variance(_by_test(problem, left), int(free.sum())) if robust else scatter(chi2, freedom, True)
    inverse = np.linalg.inv(a[:, free].T @ a[:, free]) * square
    quantile = half_interval(freedom, known)
    covariance = _with_prior(inverse, a * np.sqrt(each)[:, None], free)
    return Fit(problem, x, free, {}, covariance, quantile, weights, chi2 / freedom)


def _with_prior(inverse: np.ndarray, a: np.ndarray, free: np.ndarray) -> np.ndarray:
    """Covariance of all factors, (p, p): of the free ones, and what the uncertainty PRIOR of the held ones adds."""
    carried = -np.linalg.lstsq(a[:, free], a[:, ~free], rcond=None)[0]
    covariance = np.zeros((free.size, free.size))
    covariance[np.ix_(free, free)] = inverse + PRIOR**2 * carried @ carried.T
    covariance[np.ix_(free, ~free)] = PRIOR**2 * carried
    covariance[np.ix_(~free, free)] = PRIOR**2 * carried.T
    covariance[np.ix_(~free, ~free)] = PRIOR**2 * np.eye(int((~free).sum()))
    return covariance


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
