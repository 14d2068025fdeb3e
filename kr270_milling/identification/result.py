"""What ``identify compliance`` says: numbers for JSON, sentences for people, a parameter file to include."""

from __future__ import annotations

import numpy as np

from kr270_milling.base.record import specs
from kr270_milling.identification.compliance import Fit
from kr270_milling.identification.identifiability import singular_values
from kr270_milling.identification.measurements import Measurements
from kr270_milling.identification.prediction import predicted_errors
from kr270_milling.robot.compensator import Compensator

__all__ = ["as_dict", "include_sections", "sentences"]

HARDLY_NORMAL = 0.05


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
