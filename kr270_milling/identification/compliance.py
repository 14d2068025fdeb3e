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

from kr270_milling.base.errors import MillingError
from kr270_milling.base.record import specs
from kr270_milling.identification.intervals import half_interval, robust_variance, robust_weights, scatter
from kr270_milling.identification.measurements import Measurements
from kr270_milling.identification.outcome import Outcome, figure_of, points
from kr270_milling.identification.problem import Problem
from kr270_milling.robot.arm import Compensator

__all__ = ["Fit", "TooFewError", "compliance_outcome", "fit", "sentences"]

#: relative standard deviation of a number that the data cannot tell, as in the cell's ``uncertainty``: assumed
PRIOR = 0.15
ROUNDS = 30
HARDLY_NORMAL = 0.05
COLUMNS = ("number", "arm file", "identified", "95 % +-", "told by the data")


class TooFewError(MillingError):
    """Fewer numbers were measured than are sought."""


@dataclass(frozen=True, eq=False)
class Fit:
    """What the load tests say of the arm."""

    problem: Problem  #: with the standard deviations that were used
    factors: np.ndarray  #: on the arm file's numbers, (p,)
    reasons: dict[int, str]  #: of those that were not fitted, which are as in the arm file
    covariance: np.ndarray  #: of the factors, (p, p), with PRIOR for those that are held
    quantile: float  #: half width of a 95 % interval in standard deviations
    weights: np.ndarray  #: of each load test, (n,); 1 unless robust
    chi2_reduced: float  #: weighted sum of the squares of the residuals over the degrees of freedom

    @property
    def free(self) -> np.ndarray:
        """(p,) bool: fitted."""
        return np.array([k not in self.reasons for k in range(len(self.factors))])

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
    def singular_values(self) -> np.ndarray:
        """Of the derivatives, each column scaled to length 1, (p,), the largest first; 1 each: nothing is mixed up."""
        columns = self.problem.derivatives(self.factors)
        lengths = np.linalg.norm(columns, axis=0)
        return np.linalg.svd(columns / np.where(lengths > 0.0, lengths, 1.0), compute_uv=False)

    @functools.cached_property
    def residuals(self) -> np.ndarray:
        """Measured less modelled [m, rad], (n, 6)."""
        return self.problem.measured.displacement - self.problem.predict(self.factors)

    @property
    def residual_rms(self) -> float:
        """Of the translations [m], of the load tests with weight."""
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


def fit(problem: Problem, robust: bool = False) -> Fit:
    """Identify; robust: tests that contradict the others lose their weight. Raises TooFewError, SoftArmError.

    A number that the data cannot tell stays as the arm file has it: one without effect, one that is mixed up with
    another, and one whose interval would reach beyond zero. The others' intervals then hold its uncertainty, PRIOR.
    """
    reasons = problem.held()
    while True:
        found = _fitted(problem, dict(reasons), robust)
        relative = found.half_widths / np.maximum(np.abs(found.values), 1e-300)
        relative[:6][found.factors[:6] <= 0.0] = np.inf
        relative[~found.free] = 0.0
        worst = int(np.argmax(relative))
        if not relative[worst] >= 1.0:
            return found
        noise = f"{problem.names[worst]}: what it does is below the noise, its 95 % interval would reach beyond zero"
        reasons[worst] = problem.hidden(worst) or noise


def _fitted(problem: Problem, reasons: dict[int, str], robust: bool) -> Fit:
    """The fit of all numbers without a reason to be held, by weights and standard deviations from its own residuals."""
    weights, x = np.ones(len(problem.measured)), problem.start
    free = np.array([k not in reasons for k in range(len(x))])
    sought, measured = int(free.sum()), int(problem.finite.sum())
    if measured <= sought:
        reason = f"{measured} numbers cannot tell {sought} unknown ones; measure more loads or postures"
        raise TooFewError(reason)
    for _ in range(ROUNDS):
        x = problem.solve(x, free, weights)
        left = problem.weighted(problem.predict(x))
        new = robust_weights(left) if robust else weights
        scaled = problem if problem.measured.sigma_known else problem.with_estimated_sigma(left, weights, sought)
        done = np.abs(new - weights).max() < 1e-3 and np.allclose(scaled.measured.sigma, problem.measured.sigma, 1e-4)
        problem, weights = scaled, new
        if done:
            break
    each = problem.by_number(weights)
    residuals, a = problem.linearised(x)
    freedom = max(1, int((each > 0.0).sum() - sought))
    chi2 = float(np.sum(each * residuals**2))
    if robust:
        variance = robust_variance(problem.weighted(problem.predict(x)), sought)
    else:
        variance = scatter(chi2, freedom, True)
    covariance = _with_prior(np.linalg.inv(a[:, free].T @ a[:, free]) * variance, a * np.sqrt(each)[:, None], free)
    quantile = half_interval(freedom, problem.measured.sigma_known and not robust)
    return Fit(problem, x, reasons, covariance, quantile, weights, chi2 / freedom)


def _with_prior(inverse: np.ndarray, a: np.ndarray, free: np.ndarray) -> np.ndarray:
    """Covariance of all factors, (p, p): of the free ones, and what the uncertainty PRIOR of the held ones adds."""
    carried = -np.linalg.lstsq(a[:, free], a[:, ~free], rcond=None)[0]
    covariance = np.zeros((free.size, free.size))
    covariance[np.ix_(free, free)] = inverse + PRIOR**2 * carried @ carried.T
    covariance[np.ix_(free, ~free)] = PRIOR**2 * carried
    covariance[np.ix_(~free, free)] = PRIOR**2 * carried.T
    covariance[np.ix_(~free, ~free)] = PRIOR**2 * np.eye(int((~free).sum()))
    return covariance


def compliance_outcome(found: Fit, pose: Measurements | None, source: str) -> Outcome:
    """Everything that ``identify compliance`` says; source: name of the file with the load tests."""
    tests, problem = len(found.problem.measured), found.problem
    title = f"Joint compliances of {problem.arm.name} from {tests} load tests, {source}"
    residual = f"residual {1e6 * found.residual_rms:.2f} um RMS, normal with p = {found.normality:.2g}"
    rows = []
    columns = zip(problem.names, problem.scale, found.values, found.half_widths, found.free, strict=True)
    for name, *numbers, free in columns:
        unit = 1e6 if name.startswith("joint") else 1.0
        shown = [f"{unit * number:.4g}" if np.isfinite(number) else "-" for number in numbers]
        rows.append([name, *shown, "yes" if free else "no"])
    return Outcome(
        "compliance", title, _as_dict(found, pose), [(title, COLUMNS, rows)], [residual, *sentences(found, pose)],
        lambda: _figures(found), _sections(found), "name this file in `includes` behind that of the arm",
    )  # fmt: skip


def _as_dict(found: Fit, pose: Measurements | None) -> dict:
    """For JSON; half widths that are infinite become null there."""
    report = {
        "compliance_urad_per_n_m": (1e6 * found.values[:6]).tolist(),
        "ci95_urad_per_n_m": (1e6 * found.half_widths[:6]).tolist(),
        "identifiable": found.free[:6].tolist(),
        "reasons": list(found.reasons.values()),
        "residual_rms_um": 1e6 * found.residual_rms,
        "residuals_um": (1e6 * found.residuals[:, :3]).tolist(),
        "weights": found.weights.tolist(),
        "chi2_reduced": found.chi2_reduced,
        "normality_p": found.normality,
        "correlation": found.correlation.tolist(),
        "singular_values": found.singular_values.tolist(),
        "tests": len(found.problem.measured),
    }
    if np.isfinite(found.residuals[:, 3:]).any():
        report["residuals_mrad"] = (1e3 * found.residuals[:, 3:]).tolist()
    if found.problem.compensator:
        report["compensator"] = {"ci95": _compensator(found, found.half_widths), **_compensator(found, found.values)}
    if pose is not None:
        moved, error = found.at(pose)
        report["test_pose"] = {
            "joints_deg": np.degrees(pose.q[0]).tolist(),
            "forces_n": pose.wrench[:, :3].tolist(),
            "displacement_um": (1e6 * moved).tolist(),
            "error_um": (1e6 * error).tolist(),
            "share": float(np.sqrt(np.sum(error**2) / np.sum(moved**2))),
        }
    return report


def _compensator(found: Fit, numbers: np.ndarray) -> dict[str, float]:
    """Numbers (p,) [SI] of the compensator in units of the parameter file."""
    by_name = {spec.name: spec for spec in specs(Compensator)}
    chosen = [by_name[name] for name in found.problem.compensator]
    return {spec.key: float(number / spec.scale) for spec, number in zip(chosen, numbers[6:], strict=True)}


def sentences(found: Fit, pose: Measurements | None = None) -> list[str]:
    """What the numbers mean."""
    said = [f"not identified: {reason}; it stays as in the arm file" for reason in found.reasons.values()]
    if found.free.all():
        said.append("every sought number is told by the data")
    seen = found.problem.measured.displacement[:, :3]
    if np.nansum(seen * (seen - found.residuals[:, :3])) < 0.0:
        said.append("the arm moved against its loads: look at the signs of forces and displacements")
    outliers = np.flatnonzero(found.weights < 0.25) + 1
    if outliers.size:
        said.append("tests that contradict the others: " + ", ".join(map(str, outliers.tolist())))
    if found.normality < HARDLY_NORMAL:
        said.append(f"the residuals are hardly normal (p = {found.normality:.2g}): look for outliers, or a wrong load")
    if found.problem.measured.sigma_known and found.chi2_reduced > 1.5:
        factor = np.sqrt(found.chi2_reduced)
        said.append(f"the residuals are {factor:.1f} times what sigma_um states; the intervals are widened by that")
    if pose is not None:
        moved, error = found.at(pose)
        size = 1e6 * np.sqrt(np.sum(moved**2, axis=1).mean()), 1e6 * np.sqrt(np.mean(error**2))
        said.append(f"at the cell's posture 100 N move the tool by {size[0]:.1f} um, known to {size[1]:.2f} um")
    return said


def _sections(found: Fit) -> dict:
    """The groups of a parameter file: the arm's compliances, and how well they are known for the verdict."""
    widths = ", ".join("-" if not np.isfinite(w) else f"{1e6 * w:.2g}" for w in found.half_widths[:6])
    arm: dict = {"joint_compliance_urad_per_n_m": ((1e6 * found.values[:6]).tolist(), f"identified, 95 % +- {widths}")}
    if found.problem.compensator:
        arm["compensator"] = _compensator(found, found.values)
    relative = np.sqrt(np.diag(found.covariance)[:6]) / np.abs(found.factors[:6])
    spread = (np.clip(relative, 1e-4, 1.0).tolist(), "standard deviations from the same fit")
    return {"arm": arm, "uncertainty": {"joint_compliances": spread}}


def _figures(found: Fit) -> list:
    """Compliances with their intervals, residuals of each test and against the normal distribution, correlation."""
    bars = figure_of("Joint compliances", "", "[urad/(N m)]")
    values, widths = found.values[:6], np.where(np.isfinite(found.half_widths[:6]), found.half_widths[:6], 0.0)
    spread = dict(type="data", color="#888888", array=(1e6 * widths).tolist())
    joints, names = found.problem.names[:6], found.problem.names
    bars.add_bar(name="identified, 95 %", x=joints, y=(1e6 * values).tolist(), error_y=spread)
    bars.add_bar(name="arm file", x=joints, y=(1e6 * found.problem.arm.joint_compliance).tolist())
    heat = figure_of("Correlation of what was fitted", "", "")
    heat.add_heatmap(x=names, y=names, z=found.correlation.tolist(), zmin=-1, zmax=1, colorscale="RdBu",
                     texttemplate="%{z:.2f}")  # fmt: skip
    heat.update_layout(yaxis_autorange="reversed", height=480)
    left = 1e6 * found.residuals[:, :3]
    tests = np.arange(1, len(left) + 1)
    scaled = np.sort(found.scaled)
    normal = stats.norm.ppf((np.arange(scaled.size) + 0.5) / scaled.size)
    modelled = 1e6 * (found.problem.measured.displacement - found.residuals)[:, :3]
    seen = 1e6 * found.problem.measured.displacement[:, :3]
    axes = list(enumerate("xyz"))
    return [
        bars,
        points("Measured against modelled displacement", "modelled [um]", "measured [um]",
               {a: (modelled[:, i], seen[:, i]) for i, a in axes}),
        points("Residuals of each load test", "test", "measured less modelled [um]",
               {a: (tests, left[:, i]) for i, a in axes}),
        points("Residuals against the normal distribution", "normal quantile", "residual [standard deviations]",
               {"residuals": (normal, scaled), "normal": (normal, normal)}, ("normal",)),
        heat,
    ]  # fmt: skip
