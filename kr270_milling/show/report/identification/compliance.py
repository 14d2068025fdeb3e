"""Identified joint compliances, and a plan of load tests, as sentences, JSON, tables, figures and files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from scipy import stats

from kr270_milling.base.column import TextTable
from kr270_milling.base.record import specs
from kr270_milling.decide.programs.krl import EXTERNAL, HEAD
from kr270_milling.physics.robot.arm import GravityCompensator
from kr270_milling.show.report.identification import Outcome
from kr270_milling.show.report.study_page import COLOURS, DIVERGING, figure_of, points
from kr270_milling.studies.identification.compliance import Fit, Measurements, write_measurements
from kr270_milling.studies.identification.doubts import compliance_doubts
from kr270_milling.studies.identification.plan import Candidates, Design

COLUMNS = ("number", "arm file", "identified", "95 % +-", "identified by the data")
BASE_Z = "not identified: base z: it turns the arm as joint 1 does, whose number contains its compliance"


def compliance_outcome(fit: Fit, pose: Measurements | None, source: str) -> Outcome:
    """Return the result of ``identify compliance``; source: name of the file with the load tests."""
    problem, doubts = fit.problem, compliance_doubts(fit)
    title = f"Joint compliances of {problem.arm.name} from {len(problem.measured)} load tests, {source}"
    residual = f"residual {1e6 * fit.residual_rms:.2f} um RMS, normal with p = {fit.normality:.2g}"
    rows = []
    columns = zip(problem.names, problem.scale, fit.values, fit.half_widths, fit.free, strict=True)
    for name, *numbers, free in columns:
        unit = 1.0 if name.startswith("compensator") else 1e6
        texts = [f"{unit * number:.4g}" if np.isfinite(number) else "-" for number in numbers]
        rows.append([name, *texts, "yes" if free else "no"])
    refused = any(doubt.forbids for doubt in doubts)
    doubted = [doubt.text for doubt in doubts]
    result = _as_dict(fit, None if refused else pose) | {"doubts": doubted, "usable": not refused}
    texts = [residual, *doubted, *sentences(fit, None if refused else pose, bool(doubts))]
    return Outcome(
        "compliance",
        title,
        result,
        [TextTable(title, COLUMNS, rows)],
        texts,
        lambda: _figures(fit),
        _sections(fit),
        "name this file in `includes` after the file of the arm",
        refused,
    )


def reason(fit: Fit, number: int) -> str:
    """Return why a number was not fitted."""
    return f"{fit.problem.names[number]}: {fit.exclusions[number]}"


def sentences(fit: Fit, pose: Measurements | None = None, doubted: bool = False) -> list[str]:
    """Return what the numbers mean; doubted: the data may be wrong, so they are not called complete."""
    texts = [f"not identified: {reason(fit, k)}; it stays as in the arm file" for k in fit.exclusions]
    if fit.problem.base:
        texts.append(BASE_Z)
    if fit.free.all() and not doubted:
        texts.append("the data identify every number that was asked for")
    measured = fit.problem.measured.displacement[:, :3]
    if np.nansum(measured * (measured - fit.residuals[:, :3])) < 0.0:
        texts.append("the arm moved against its loads: look at the signs of forces and displacements")
    outliers = np.flatnonzero(fit.weights < 0.25) + 1  # weight of a load test below which a sentence names the test
    if outliers.size:
        texts.append("tests that contradict the others: " + ", ".join(map(str, outliers.tolist())))
    if fit.normality < 0.05:  # p-value of the normality test below which a sentence warns
        texts.append(f"the residuals are hardly normal (p = {fit.normality:.2g}): look for outliers, or a wrong load")
    if fit.problem.measured.sigma_known and fit.chi2_reduced > 1.5:  # reduced chi^2 above which a sentence warns
        factor = np.sqrt(fit.chi2_reduced)
        texts.append(f"the residuals are {factor:.1f} times what sigma_um states; the intervals are widened by that")
    if pose is not None:
        moved, error = fit.at(pose)
        size = 1e6 * np.sqrt(np.sum(moved**2, axis=1).mean()), 1e6 * np.sqrt(np.mean(error**2))
        texts.append(f"at the cell's posture 100 N move the tool by {size[0]:.1f} um, known to {size[1]:.2f} um")
    return texts


def _as_dict(fit: Fit, pose: Measurements | None) -> dict:
    """Return the values for JSON; infinite half widths become null there."""
    result = {
        "compliance_urad_per_n_m": (1e6 * fit.values[:6]).tolist(),
        "ci95_urad_per_n_m": (1e6 * fit.half_widths[:6]).tolist(),
        "identifiable": fit.free[:6].tolist(),
        "reasons": [reason(fit, k) for k in fit.exclusions],
        "residual_rms_um": 1e6 * fit.residual_rms,
        "residuals_um": (1e6 * fit.residuals[:, :3]).tolist(),
        "weights": fit.weights.tolist(),
        "chi2_reduced": fit.chi2_reduced,
        "normality_p": fit.normality,
        "correlation": fit.correlation.tolist(),
        "singular_values": fit.singular_values.tolist(),
        "tests": len(fit.problem.measured),
    }
    if np.isfinite(fit.residuals[:, 3:]).any():
        result["residuals_mrad"] = (1e3 * fit.residuals[:, 3:]).tolist()
    if fit.problem.compensator:
        result["compensator"] = {"ci95": _compensator(fit, fit.half_widths), **_compensator(fit, fit.values)}
    if fit.problem.base:
        base = fit.problem.is_base
        result["base"] = {
            "compliance_urad_per_n_m": (1e6 * fit.values[base]).tolist(),
            "ci95_urad_per_n_m": (1e6 * fit.half_widths[base]).tolist(),
            "identifiable": fit.free[base].tolist(),
        }
    if pose is not None:
        moved, error = fit.at(pose)
        result["test_pose"] = {
            "joints_deg": np.degrees(pose.q[0]).tolist(),
            "forces_n": pose.wrench[:, :3].tolist(),
            "displacement_um": (1e6 * moved).tolist(),
            "error_um": (1e6 * error).tolist(),
            "share": float(np.sqrt(np.sum(error**2) / np.sum(moved**2))),
        }
    return result


def _compensator(fit: Fit, numbers: np.ndarray) -> dict[str, float]:
    """Numbers (p,) [SI] of the compensator in units of the parameter file."""
    by_name = {spec.name: spec for spec in specs(GravityCompensator)}
    chosen = [by_name[name] for name in fit.problem.compensator]
    numbers = numbers[~fit.problem.is_compliance]
    return {spec.key: float(number / spec.scale) for spec, number in zip(chosen, numbers, strict=True)}


def _sections(fit: Fit) -> dict:
    """Sections of a parameter file: the arm's compliances, and their uncertainty for the verdict."""
    widths = ", ".join("-" if not np.isfinite(w) else f"{1e6 * w:.2g}" for w in fit.half_widths[:6])
    arm: dict = {"joint_compliance_urad_per_n_m": ((1e6 * fit.values[:6]).tolist(), f"identified, 95 % +- {widths}")}
    if fit.problem.compensator:
        arm["compensator"] = _compensator(fit, fit.values)
    if fit.problem.base:
        base = fit.problem.arm_at(fit.factors).base_compliance
        widths = ", ".join(
            "-" if not np.isfinite(w) else f"{1e6 * w:.2g}" for w in fit.half_widths[fit.problem.is_base]
        )
        arm["base_compliance_urad_per_n_m"] = ((1e6 * base).tolist(), f"identified about x and y, 95 % +- {widths}")
    relative = np.sqrt(np.diag(fit.covariance)[:6]) / np.abs(fit.factors[:6])
    spread = (np.clip(relative, 1e-4, 1.0).tolist(), "standard deviations from the same fit")
    return {"arm": arm, "uncertainty": {"joint_compliances": spread}}


def _figures(fit: Fit) -> list:
    """Compliances with their intervals, residuals of each test and against the normal distribution, correlation."""
    bars = figure_of("Joint compliances", "", "[urad/(N m)]")
    values, widths = fit.values[:6], np.where(np.isfinite(fit.half_widths[:6]), fit.half_widths[:6], 0.0)
    spread = dict(type="data", color=COLOURS[6], array=(1e6 * widths).tolist())
    joints, names = fit.problem.names[:6], fit.problem.names
    bars.add_bar(name="identified, 95 %", x=joints, y=(1e6 * values).tolist(), error_y=spread)
    bars.add_bar(name="arm file", x=joints, y=(1e6 * fit.problem.arm.joint_compliance).tolist())
    heat = figure_of("Correlation of the fitted numbers", "", "")
    heat.add_heatmap(
        x=names, y=names, z=fit.correlation.tolist(), zmin=-1, zmax=1, colorscale=DIVERGING, texttemplate="%{z:.2f}"
    )
    heat.update_layout(yaxis_autorange="reversed", height=480)
    residuals = 1e6 * fit.residuals[:, :3]
    tests = np.arange(1, len(residuals) + 1)
    scaled = np.sort(fit.scaled)
    normal = stats.norm.ppf((np.arange(scaled.size) + 0.5) / scaled.size)
    modelled = 1e6 * (fit.problem.measured.displacement - fit.residuals)[:, :3]
    measured = 1e6 * fit.problem.measured.displacement[:, :3]
    axes = list(enumerate("xyz"))
    return [
        bars,
        points(
            "Measured against modelled displacement",
            "modelled [um]",
            "measured [um]",
            {a: (modelled[:, i], measured[:, i]) for i, a in axes},
        ),
        points(
            "Residuals of each load test",
            "test",
            "measured less modelled [um]",
            {a: (tests, residuals[:, i]) for i, a in axes},
        ),
        points(
            "Residuals against the normal distribution",
            "normal quantile",
            "residual [standard deviations]",
            {"residuals": (normal, scaled), "normal": (normal, normal)},
            ("normal",),
        ),
        heat,
    ]


MODULE = "LOADTEST"


def plan_as_dict(plan: Candidates, designs: Mapping[str, Design], chosen: Design, names: Sequence[str]) -> dict:
    """Return a plan for JSON; designs: by name, for comparison; chosen: the design of the plan; names: of the sought
    numbers, (p,)."""
    return {
        "blind_spots": blind_spots(chosen.relative, names),
        "sought": list(names),
        "designs": [
            {
                "name": name,
                "error_um": 1e6 * d.pose_error,
                "relative": d.relative.tolist(),
                "determinant": d.determinant,
            }
            for name, d in designs.items()
        ],
        "tests": [
            {"joints_deg": np.degrees(q).tolist(), "wrench": w.tolist(), "load": load_text(plan, i)}
            for i, (q, w) in enumerate(zip(plan.tests.q, plan.tests.wrench, strict=True))
        ],
    }


def plan_tables(plan: Candidates, designs: Mapping[str, Design]) -> list[TextTable]:
    """Return the comparison of the designs and of the tests."""
    rows = [
        [name, f"{1e6 * d.pose_error:.3f}", f"{100 * d.relative.max():.1f}", f"{100 * d.determinant:.2f}"]
        for name, d in designs.items()
    ]
    title = f"{len(plan.tests)} load tests: standard deviation of the displacement by 100 N at the cell's posture"
    tests = [[load_text(plan, i), " ".join(f"{a:7.2f}" for a in np.degrees(q))] for i, q in enumerate(plan.tests.q)]
    return [
        TextTable(title, ["choice", "error there [um]", "worst compliance [%]", "mean [%]"], rows),
        TextTable("The tests, in the order of the program", ["load", "A1 to A6 [deg]"], tests),
    ]


def blind_spots(relative: np.ndarray, names: Sequence[str]) -> list[str]:
    """Return sentences about the numbers that a plan cannot identify.

    relative: standard deviations of the factors, (p,); names: of the sought numbers, (p,).
    """
    # relative standard deviation from which a compliance is practically unknown
    unseen = [name for name, deviation in zip(names, relative, strict=True) if deviation > 0.5]
    cure = "a horizontal pull turns joint 1, a --point off axis 6 turns joint 6, more tests help joints of small effect"
    texts = [f"{', '.join(unseen)}: these tests hardly identify the compliance; {cure}"] if unseen else []
    return texts + [BASE_Z] * (len(names) > 6)  # more than the joints


def load_text(plan: Candidates, row: int) -> str:
    """Return the instruction for the load of a test."""
    kinds = ("hang", "pull outward", "pull sideways", "pull between both")  # kind of a candidate -> text
    x, y, z = plan.tests.wrench[row, :3].tolist()
    kind = int(plan.kind[row])
    toward = f" toward {np.degrees(np.arctan2(y, x)):.1f} deg" if kind else ""
    return f"{kinds[kind]} {np.linalg.norm([x, y, z]):.0f} N{toward}"


def write_plan(directory, plan: Candidates, notes: list[str]) -> list[Path]:
    """Write plan.csv, the input of ``identify compliance`` without its results, and a KRL program.

    The program moves to the postures and halts twice at each, without and with the load.
    """
    place = Path(directory)
    head = [*(f"; {note}" for note in notes), "; VERIFY IN T1: THE MOTIONS ARE NOT CHECKED FOR COLLISION"]
    remarks = [f"test {row + 1}: {load_text(plan, row)}" for row in range(len(plan.tests))]
    write_measurements(place / "plan.csv", plan.tests, notes, remarks)
    source = [*HEAD, f"DEF {MODULE}( )", *head, "BAS(#INITMOV,0)", "BAS(#VEL_PTP,10)"]  # [%] of the axis speeds
    for remark, q in zip(remarks, np.degrees(plan.tests.q).tolist(), strict=True):
        axes = ",".join(f"A{i} {angle:.4f}" for i, angle in enumerate(q, 1))
        source += [f"; {remark}", f"PTP {{{axes}}}"]
        source += ["HALT ; measure the reflector without the load", "HALT ; put the load on, measure, take it off"]
    program = {".src": [*source, "END"], ".dat": [*HEAD, f"DEFDAT {MODULE}", *head, *EXTERNAL, "ENDDAT"]}
    for suffix, lines in program.items():
        text = "".join(f"{line}\r\n" for line in lines)
        (place / f"{MODULE}{suffix}").write_bytes(text.encode("ascii", "replace"))
    return [place / "plan.csv", *(place / f"{MODULE}{suffix}" for suffix in program)]
