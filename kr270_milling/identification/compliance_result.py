"""What ``identify compliance`` says: numbers for JSON, sentences for people, a parameter file to include."""

from __future__ import annotations

import numpy as np
from scipy.stats import norm

from kr270_milling.base.record import specs
from kr270_milling.identification.compliance import Fit
from kr270_milling.identification.figures import figure_of, points
from kr270_milling.identification.identifiability import singular_values
from kr270_milling.identification.measurements import Measurements
from kr270_milling.identification.outcome import Outcome
from kr270_milling.identification.plan import predicted_errors
from kr270_milling.robot.compensator import Compensator

__all__ = ["as_dict", "compliance_outcome", "include_sections", "sentences"]

HARDLY_NORMAL = 0.05
COLUMNS = ("number", "arm file", "identified", "95 % +-", "told by the data")


def compliance_outcome(found: Fit, pose: Measurements | None, source: str) -> Outcome:
    """Everything that ``identify compliance`` says; source: name of the file with the load tests."""
    result = as_dict(found, pose)
    title = f"Joint compliances of {found.problem.arm.name} from {result['tests']} load tests, {source}"
    residual = f"residual {result['residual_rms_um']:.2f} um RMS, normal with p = {result['normality_p']:.2g}"
    return Outcome(
        "compliance", title, result, [(title, COLUMNS, _rows(found))], [residual, *sentences(found, pose)],
        lambda: _figures(found), include_sections(found), "name this file in `includes` behind that of the arm",
    )  # fmt: skip


def _rows(found: Fit) -> list[list[str]]:
    rows = []
    numbers = zip(found.problem.scale, found.values, found.half_widths, strict=True)
    for name, three, free in zip(found.problem.names, numbers, found.free, strict=True):
        unit = 1e6 if name.startswith("joint") else 1.0
        shown = [f"{unit * number:.4g}" if np.isfinite(number) else "-" for number in three]
        rows.append([name, *shown, "yes" if free else "no"])
    return rows


def as_dict(found: Fit, pose: Measurements | None = None) -> dict:
    """For JSON; half widths that are infinite become null there."""
    values, widths = found.values, found.half_widths
    residuals = found.residuals
    report = {
        "compliance_urad_per_n_m": (1e6 * values[:6]).tolist(),
        "ci95_urad_per_n_m": (1e6 * widths[:6]).tolist(),
        "identifiable": found.free[:6].tolist(),
        "reasons": list(found.reasons.values()),
        "residual_rms_um": 1e6 * found.residual_rms,
        "residuals_um": (1e6 * residuals[:, :3]).tolist(),
        "weights": found.weights.tolist(),
        "chi2_reduced": found.chi2_reduced,
        "normality_p": found.normality,
        "correlation": found.correlation.tolist(),
        "singular_values": singular_values(found.problem.derivatives(found.factors)).tolist(),
        "tests": len(found.problem.measured),
    }
    if np.isfinite(residuals[:, 3:]).any():
        report["residuals_mrad"] = (1e3 * residuals[:, 3:]).tolist()
    if found.problem.compensator:
        report["compensator"] = _compensator(found)
    if pose is not None:
        report["test_pose"] = _test_pose(found, pose)
    return report


def _compensator(found: Fit) -> dict:
    by_name = {spec.name: spec for spec in specs(Compensator)}
    report: dict = {"ci95": {}}
    for k, name in enumerate(found.problem.compensator, 6):
        spec = by_name[name]
        report[spec.key] = float(found.values[k] / spec.scale)
        report["ci95"][spec.key] = float(found.half_widths[k] / spec.scale)
    return report


def _test_pose(found: Fit, pose: Measurements) -> dict:
    moved, error = predicted_errors(found, pose)
    return {
        "joints_deg": np.degrees(pose.q[0]).tolist(),
        "forces_n": pose.wrench[:, :3].tolist(),
        "displacement_um": (1e6 * moved).tolist(),
        "error_um": (1e6 * error).tolist(),
        "share": float(np.sqrt(np.sum(error**2) / np.sum(moved**2))),
    }


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
        moved, error = predicted_errors(found, pose)
        size = 1e6 * np.sqrt(np.sum(moved**2, axis=1).mean()), 1e6 * np.sqrt(np.mean(error**2))
        said.append(f"at the cell's posture 100 N move the tool by {size[0]:.1f} um, known to {size[1]:.2f} um")
    return said


def include_sections(found: Fit) -> dict:
    """The groups of a parameter file: the arm's compliances, and how well they are known for the verdict."""
    widths = ["-" if not np.isfinite(w) else f"{1e6 * w:.2g}" for w in found.half_widths[:6]]
    arm: dict = {
        "joint_compliance_urad_per_n_m": (
            (1e6 * found.values[:6]).tolist(),
            "identified, 95 % +- " + ", ".join(widths),
        )
    }
    if found.problem.compensator:
        arm["compensator"] = {key: value for key, value in _compensator(found).items() if key != "ci95"}
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
    scaled = np.sort((found.residuals / found.problem.measured.sigma)[found.problem.finite])
    normal = norm.ppf((np.arange(scaled.size) + 0.5) / scaled.size)
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
