"""Joint compliances from load tests: weighted non-linear least squares on the loaded model, with their intervals.

minimise sum w_i r_i(x)^2,  r = (model(x) - measurement) / sigma,  cov(x) = s^2 (A^T W A)^-1,  A = dr/dx.

s^2 and the interval are those of ``intervals``; where no standard deviations are stated, they are estimated from the
residuals, of translations and rotations each for itself.
"""

from __future__ import annotations

import dataclasses
import functools
from dataclasses import dataclass

import numpy as np
from scipy import stats

from kr270_milling.base.errors import ModelError
from kr270_milling.studies.identification.intervals import half_interval, robust_variance, robust_weights, scatter
from kr270_milling.studies.identification.measurements import Measurements
from kr270_milling.studies.identification.problem import Problem

#: relative standard deviation of a number that the data cannot identify, as in the cell's ``uncertainty``: assumed
PRIOR = 0.15


@dataclass(frozen=True, eq=False)
class Fit:
    """Numbers of the arm, identified from load tests."""

    problem: Problem  #: with the standard deviations that were used
    factors: np.ndarray  #: on the arm file's numbers, (p,)
    exclusions: dict[int, str]  #: why a number was not fitted; its value is that of the arm file
    covariance: np.ndarray  #: covariance of the factors, (p, p), with PRIOR for those that were not fitted
    quantile: float  #: half width of a 95 % interval in standard deviations
    weights: np.ndarray  #: weight of each load test, (n,); 1 unless robust
    chi2_reduced: float  #: weighted sum of the squares of the residuals over the degrees of freedom

    @property
    def free(self) -> np.ndarray:
        """(p,) bool: fitted."""
        return np.array([k not in self.exclusions for k in range(len(self.factors))])

    @property
    def values(self) -> np.ndarray:
        """Compliances [rad/(N m)], then the compensator's numbers [SI], (p,)."""
        return self.factors * self.problem.scale

    @property
    def half_widths(self) -> np.ndarray:
        """Half widths of the 95 % intervals, (p,), infinite for a number that was not fitted."""
        sigma = np.sqrt(np.diag(self.covariance)) * np.abs(self.problem.scale)
        return np.where(self.free, self.quantile * sigma, np.inf)

    @property
    def correlation(self) -> np.ndarray:
        """(p, p); 0 in rows and columns of numbers that were not fitted."""
        sigma = np.sqrt(np.diag(self.covariance))
        both = self.free[:, None] & self.free[None, :]
        return np.where(both, self.covariance / np.outer(sigma, sigma), np.eye(len(sigma)))

    @property
    def singular_values(self) -> np.ndarray:
        """Singular values of the derivatives, (p,), columns scaled to length 1; all 1: orthogonal columns."""
        columns = self.problem.derivatives(self.factors)
        lengths = np.linalg.norm(columns, axis=0)
        return np.linalg.svd(columns / np.where(lengths > 0.0, lengths, 1.0), compute_uv=False)

    @functools.cached_property
    def residuals(self) -> np.ndarray:
        """Measured less modelled [m, rad], (n, 6)."""
        return self.problem.measured.displacement - self.problem.predict(self.factors)

    @property
    def residual_rms(self) -> float:
        """Root mean square of the translations [m] of the load tests with weight."""
        rows = self.residuals[self.weights > 0.0, :3]
        return float(np.sqrt(np.nanmean(rows**2)))

    @property
    def scaled(self) -> np.ndarray:
        """Residuals in standard deviations, (m,)."""
        return (self.residuals / self.problem.measured.sigma)[self.problem.finite]

    @property
    def normality(self) -> float:
        """p-value of the test of Shapiro and Wilk: below 0.05 the residuals are hardly normal; NaN for fewer than 3."""
        if self.scaled.size < 3 or not np.ptp(self.scaled) > 0.0:
            return float("nan")
        return float(stats.shapiro(self.scaled[:5000]).pvalue)

    def at(self, pose: Measurements) -> tuple[np.ndarray, np.ndarray]:
        """Translation of the tool under each force of a test pose [m], (k, 3), and its standard deviation [m], (k,)."""
        slopes = self.problem.slopes(self.factors, pose)
        square = np.einsum("kip,pq,kiq->k", slopes, self.covariance, slopes)
        moved = dataclasses.replace(self.problem, measured=pose).predict(self.factors)[:, :3]
        return moved, np.sqrt(np.maximum(square, 0.0))


def fit_compliance(problem: Problem, robust: bool = False) -> Fit:
    """Identify the arm; robust: tests that contradict the others lose their weight. Raises ModelError.

    A number keeps the value of the arm file if it has no effect, if another number has the same effect, or if its
    interval would include zero. The intervals of the other numbers then include its uncertainty, PRIOR.
    """
    exclusions = problem.excluded()
    hidden_by_noise = "its effect is below the noise, its 95 % interval would include zero"
    while True:
        fitted = _fitted(problem, dict(exclusions), robust)
        relative = fitted.half_widths / np.maximum(np.abs(fitted.values), 1e-300)
        relative[problem.is_compliance & (fitted.factors <= 0.0)] = np.inf
        relative[~fitted.free] = 0.0
        worst = int(np.argmax(relative))
        if not relative[worst] >= 1.0:
            return fitted
        exclusions[worst] = problem.hidden(worst) or hidden_by_noise


def _fitted(problem: Problem, exclusions: dict[int, str], robust: bool) -> Fit:
    """Fit every number that is not excluded, with weights and standard deviations from the residuals of the fit."""
    weights, x = np.ones(len(problem.measured)), problem.start
    free = np.array([k not in exclusions for k in range(len(x))])
    sought, measured = int(free.sum()), int(problem.finite.sum())
    if measured <= sought:
        raise ModelError(f"{measured} measured numbers for {sought} unknown ones; measure more loads or postures")
    rounds = 30
    for _ in range(rounds):
        x = problem.solve(x, free, weights)
        left = problem.weighted(problem.predict(x))
        new = robust_weights(left) if robust else weights
        scaled = problem if problem.measured.sigma_known else problem.with_estimated_sigma(left, weights, sought)
        converged = np.abs(new - weights).max() < 1e-3 and np.allclose(
            scaled.measured.sigma, problem.measured.sigma, 1e-4
        )
        problem, weights = scaled, new
        if converged:
            break
    each = problem.by_number(weights)
    residuals, a = problem.linearised(x)
    freedom = max(1, int((each > 0.0).sum() - sought))
    chi2 = float(np.sum(each * residuals**2))
    if robust:
        variance = robust_variance(problem.weighted(problem.predict(x)), sought)
    else:
        variance = scatter(chi2, freedom, True)
    # that of the base, in units of ``problem.TILT`` where the arm file has a rigid base: assumed, as stiff as published
    # foundations or rigid
    base_prior = 1.0
    prior = np.where(problem.is_base, base_prior, PRIOR)[~free]
    weighted = a * np.sqrt(each)[:, None]
    covariance = _with_prior(np.linalg.inv(a[:, free].T @ a[:, free]) * variance, weighted, free, prior)
    quantile = half_interval(freedom, problem.measured.sigma_known and not robust)
    return Fit(problem, x, exclusions, covariance, quantile, weights, chi2 / freedom)


def _with_prior(inverse: np.ndarray, a: np.ndarray, free: np.ndarray, prior: np.ndarray) -> np.ndarray:
    """Covariance of all factors, (p, p): of the fitted ones, with the share that the prior of the others adds.

    prior: standard deviations of the factors that are not fitted.
    """
    carried = -np.linalg.lstsq(a[:, free], a[:, ~free], rcond=None)[0]
    covariance = np.zeros((free.size, free.size))
    covariance[np.ix_(free, free)] = inverse + carried * prior**2 @ carried.T
    covariance[np.ix_(free, ~free)] = carried * prior**2
    covariance[np.ix_(~free, free)] = (carried * prior**2).T
    covariance[np.ix_(~free, ~free)] = np.diag(prior**2)
    return covariance
