"""Doubts about a table of measurements: a unit, an axis or a row that is wrong, as far as the fit shows it.

Every doubt is a sentence; some forbid the use of the result. A factor is compared with the published range and with
the arm file; a wrong axis is the hypothesis under which the residuals fall; a wrong row is the row that a robust fit
leaves out.
"""

from __future__ import annotations

import contextlib
import dataclasses
import math
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from scipy import stats

from kr270_milling.base.errors import InputError, MillingError
from kr270_milling.physics.cutting.laws import materials
from kr270_milling.physics.robot.kinematics import forward
from kr270_milling.studies.identification.compliance import TILTS, Fit, Measurements, Problem, fit_compliance
from kr270_milling.studies.identification.forces import FIRST, CutMeasurements, LawFit, contradicting_cut, fit_forces
from kr270_milling.studies.identification.modes import Mode
from kr270_milling.studies.identification.signals import AXES

#: factor on the arm file beyond which a unit is suspected: the published sets of one robot differ by 2.2
UNLIKELY = 3.0
NEAR = 1.5  #: factor within which a known factor explains what is seen
EDGE = 2.0  #: factor beyond the published ratios of coefficients from which the table is suspected
FALLS = 0.4  #: residuals fall to this share under a hypothesis that is named
LEFT_OUT = 1e-6  #: weight of a row of a robust fit that is named


class Doubt(NamedTuple):
    """A sentence, and whether it forbids the use of the result."""

    text: str
    forbids: bool = False


def likely_factor(factor: float, known: dict[float, str]) -> str:
    """Return the cause of a factor, as a question; empty if no known factor is near."""
    nearest = min(known, key=lambda k: abs(np.log(factor / k)))
    return f": {known[nearest]}?" if abs(np.log(factor / nearest)) < np.log(NEAR) else ""


def _entered_twice(kind: str, *columns: np.ndarray) -> list[Doubt]:
    """Rows, (n,) or (n, k), that equal an earlier row to the digit, as noise never repeats."""
    rows = np.column_stack([np.nan_to_num(column) for column in columns])
    _, first, place = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    earlier = first[place.ravel()]
    pairs = [f"{k + 1} = {e + 1}" for k, e in enumerate(earlier) if k != e]
    text = f"{kind} {', '.join(pairs)} to the digit: entered twice? Then the intervals are too narrow"
    return [Doubt(text)] if pairs else []


# --- load tests ---


def refuse_units(problem: Problem, path) -> None:
    """Raise InputError where the displacements have another size than the arm file predicts for these loads.

    An arm that really is so much softer or stiffer needs an arm file that is nearer.
    """
    factor, size = _size(problem)
    if factor == 0.0:
        raise InputError(path, "all displacements are zero")
    # factor on compliances -> what causes it
    units = {
        1e-3: "displacements in m in the columns of mm, or forces 1000 times too large",
        1e3: "displacements in um in the columns of mm, or forces in kN in the columns of N",
        9.80665: "forces in kgf in the columns of N",
        4.44822: "forces in pounds in the columns of N",
        1 / 9.80665: "weights in N in the column of kg",
        1 / 25.4: "displacements in inch in the columns of mm",
        39.3701: "displacements in thousandths of an inch in the columns of mm",
    }
    cause = likely_factor(factor, units)
    farthest_factor = 100.0  # factor beyond which the table is refused even without a known cause
    if not 1 / UNLIKELY < factor < UNLIKELY and (cause or not 1 / farthest_factor < factor < farthest_factor):
        raise InputError(path, f"{size}{cause or ', which no arm explains'}")


def _size(problem: Problem) -> tuple[float, str]:
    """Measured over predicted displacement, and the sentence with it."""
    moved, predicted = problem.measured.displacement[:, :3], problem.predict(problem.start)[:, :3]
    factor = float(np.sqrt(np.nansum(moved**2) / np.nansum(predicted[np.isfinite(moved)] ** 2)))
    return factor, f"the displacements are {factor:.3g} times what the arm file predicts for these loads"


def compliance_doubts(fit: Fit) -> list[Doubt]:
    """Doubts about load tests."""
    # factor around that of pounds; Table 1 beside the set of 2013 differs by 1.1 to 2.2 from joint to joint
    alike = 1.25
    if not fit.free[:6].any():
        return [Doubt("nothing is identified", True)]
    published = 0.05e-6, 10e-6  # [rad/(N m)] of a joint of a heavy arm, published
    outside = fit.free[:6] & ~((fit.values[:6] > published[0]) & (fit.values[:6] < published[1]))
    measured, (factor, size) = fit.problem.measured, _size(fit.problem)
    doubts = _pattern(fit) + _entered_twice("test", measured.q, measured.wrench, measured.displacement)
    if not 1 / UNLIKELY < factor < UNLIKELY:
        doubts.append(Doubt(f"{size}: is a unit wrong, or the arm file that of another arm?"))
    pounds = 0.453592  # factor on compliances, of masses in pounds in the column of kg
    if 1 / alike < factor / pounds < alike and not measured.wrench[:, [0, 1, 3, 4, 5]].any():
        doubts.append(Doubt(f"{size}: masses in pounds in the column of kg?"))
    if outside.any():
        names = ", ".join(str(k + 1) for k in np.flatnonzero(outside))
        limits = "{:g} to {:g}".format(*(1e6 * limit for limit in published))
        doubts.append(Doubt(f"compliance of joint {names} is outside of the published {limits} urad/(N m)"))
    return doubts


def _contradicting_row(fit: Fit, forbids: bool) -> list[Doubt]:
    """The rows that a robust fit leaves out, if the others then agree."""
    if not np.all(fit.weights == 1.0) or len(fit.weights) < 4:
        return []
    with contextlib.suppress(MillingError, np.linalg.LinAlgError):
        other = fit_compliance(fit.problem, robust=True)
        rows = np.flatnonzero(other.weights < LEFT_OUT)
        if 0 < rows.size <= max(1, len(fit.weights) // 10) and other.residual_rms < FALLS * fit.residual_rms:
            names = ", ".join(str(row + 1) for row in rows)
            return [Doubt(f"test {names} contradicts the others: correct its row, or use --robust", forbids)]
    return []


def _unexplained(fit: Fit) -> float:
    """Residual over displacement, root mean squares of the translations, of the load tests with weight."""
    used = fit.weights > LEFT_OUT
    measured = fit.problem.measured.displacement[used, :3]
    return float(np.sqrt(np.nanmean(fit.residuals[used, :3] ** 2) / np.nanmean(measured**2)))


def _pattern(fit: Fit) -> list[Doubt]:
    """Causes that the residuals suggest: another frame, one wrong row, a base that tilts."""
    left = _unexplained(fit)
    unexplained = 0.25  # share of the displacements that the model leaves, from which another frame or arm is suspected
    if left < unexplained:
        return _contradicting_row(fit, False) or _tilting_base(fit)
    best, name = left, ""
    for what, measured in _hypotheses(fit.problem.measured):
        with contextlib.suppress(MillingError, np.linalg.LinAlgError):
            other = fit_compliance(dataclasses.replace(fit.problem, measured=measured))
            if np.all(other.factors[:6] > 0.0) and _unexplained(other) < best:
                best, name = _unexplained(other), what
    share = f"the model leaves {100 * left:.0f} % of the displacements unexplained"
    if best < FALLS * left:
        return [Doubt(f"{share}, and {100 * best:.0f} % {name}: compare the axes of tracker, base and joints", True)]
    frame = "axes, load point or joint angles may be those of another arm or frame"
    return _contradicting_row(fit, True) or [*_tilting_base(fit), Doubt(f"{share}: {frame}", True)]


def _hypotheses(measured: Measurements) -> Iterable[tuple[str, Measurements]]:
    """Other readings of the same table."""
    moved, wrench = measured.displacement, measured.wrench

    def swapped(rows, i: int, k: int):
        order = np.arange(6)
        order[[i, k, i + 3, k + 3]] = order[[k, i, k + 3, i + 3]]
        return rows[:, order]

    for i, k in ((0, 1), (1, 2), (0, 2)):
        names = f"{'xyz'[i]} and {'xyz'[k]}"
        yield (
            f"with {names} of the displacements swapped",
            dataclasses.replace(measured, displacement=swapped(moved, i, k)),
        )
        yield f"with {names} of the loads swapped", dataclasses.replace(measured, wrench=swapped(wrench, i, k))
    for i in range(3):
        sign = np.where(np.arange(6) % 3 == i, -1.0, 1.0)
        yield f"with the sign of d{'xyz'[i]} changed", dataclasses.replace(measured, displacement=moved * sign)
    yield "with the signs of all displacements changed", dataclasses.replace(measured, displacement=-moved)
    for j in range(6):
        turn = np.where(np.arange(6) == j, -1.0, 1.0)
        yield f"with the sign of A{j + 1} changed", dataclasses.replace(measured, q=measured.q * turn)
    for j in (1, 2):
        for offset in (90, -90):
            shift = np.where(np.arange(6) == j, np.radians(offset), 0.0)
            yield f"with {offset:+d} deg on A{j + 1}", dataclasses.replace(measured, q=measured.q + shift)


def _tilting_base(fit: Fit) -> list[Doubt]:
    """Springs of the base about x and y, fitted beside the joints; named where the F-test is sure.

    A reflector at p under a wrench with the moment m about the origin of the base moves by (c m) x p. About z the base
    turns the arm as joint 1 does. A fit with the base among the unknowns has no such doubt.
    """
    problem: Problem = fit.problem
    if problem.base:
        return []
    measured, sigma = problem.measured, problem.measured.sigma
    frames = forward(problem.arm, problem.mount, measured.q)
    place, at = frames.flange.apply(measured.reflector), frames.flange.apply(measured.application)
    moment = measured.wrench[:, 3:] + np.cross(at, measured.wrench[:, :3])
    columns = []
    for k in range(len(TILTS)):
        tilt = np.zeros_like(moment)
        tilt[:, k] = 1e-6 * moment[:, k]
        columns.append((np.hstack([np.cross(tilt, place), tilt]) / sigma)[problem.finite])
    weight = np.sqrt(problem.by_number(fit.weights))
    left, joints = problem.linearised(fit.factors)
    joints, left = joints[:, fit.free] * weight[:, None], -left * weight
    both = np.column_stack([joints, *(column * weight for column in columns)])
    freedom = int((weight > 0.0).sum()) - both.shape[1]
    if freedom < 3:
        return []
    fitted = np.linalg.lstsq(both, left, rcond=None)[0]
    before, after = float(left @ left), float(np.sum((left - both @ fitted) ** 2))
    count = len(columns)
    significance = stats.f.sf((before - after) / count / max(after / freedom, 1e-300), count, freedom)
    softest = float(fitted[-count:].max())
    sure_enough = 1e-4  # p-value of a base that tilts
    if not (significance < sure_enough and after < FALLS * before and softest > 0.0):
        return []
    tilts = ", ".join(f"{value:.2g}" for value in fitted[-count:])
    known = "bolt it, or fit it with --base (about z the number of joint 1 contains the base)"
    return [Doubt(f"the residuals look like a base that tilts by {tilts} urad/(N m) about x, y: {known}")]


# --- forces ---


def force_doubts(fits: list[LawFit], law: str) -> list[Doubt]:
    """Doubts about cuts; fits: the linear-edge law first; law: of the parameter file."""
    edge = fits[0]
    chosen = {fit.law: fit for fit in fits}[law]
    cuts = edge.cuts
    doubts = _other_axes(edge) or _contradicting_cut(edge) or _swapped_modes(edge)
    doubts += _coefficients(edge)
    doubts += _entered_twice("cut", cuts.feed_per_tooth, cuts.depth, cuts.entry, cuts.exit, cuts.force)
    lateral = chosen.values[:4] if law == FIRST else chosen.values[np.isfinite(chosen.values)][:3]
    if np.any(lateral < 0.0) or lateral[0] == 0.0:
        doubts.append(Doubt("a coefficient of the cut is negative or zero, which no cut has", True))
    if not np.isfinite(chosen.half_widths[: len(lateral)]).any():
        doubts.append(Doubt("nothing is identified", True))
    return doubts


def _coefficients(edge: LawFit) -> list[Doubt]:
    """K_tc and K_tc / K_te beside the published range."""
    known = np.array([row.values for row in materials()])
    k_tc, k_te = edge.values[0], edge.values[1]
    low, high = known[:, 0].min(), known[:, 0].max()
    ratio, ratios = k_tc / k_te if k_te > 0.0 else np.nan, known[:, 0] / known[:, 1]
    teeth = edge.cuts.tool.teeth
    shown = f"K_tc is {1e-6 * k_tc:.3g} N/mm2, published for aluminium: {1e-6 * low:.0f} to {1e-6 * high:.0f}"
    if 0.0 < ratio < ratios.min() / EDGE and teeth > 1 and low < k_tc * teeth < high:
        text = f"is feed_per_tooth_mm the feed per revolution? Divided by {teeth} it gives {1e-6 * k_tc * teeth:.0f}"
        return [Doubt(f"{shown}, and K_tc / K_te is {1e-3 * ratio:.2g} /mm, published {1e-3 * ratios.min():.0f} to "
                      f"{1e-3 * ratios.max():.0f}: {text}")]  # fmt: skip
    # factor beyond the published K_tc from which a unit is suspected: assumed; pounds give 0.225 times K_tc
    other_unit = 1.25
    # factor on coefficients -> what causes it
    units = {
        1e-3: "forces in kN in the columns of N",
        1e3: "forces in mN in the columns of N",
        1 / 9.80665: "forces in kgf in the columns of N",
        1 / 4.44822: "forces in pounds in the columns of N",
        25.4: "depth or feed per tooth in inch in the columns of mm",
        25.4**2: "depth and feed per tooth in inch in the columns of mm",
    }
    if 0.0 < k_tc < low / other_unit or k_tc > high * other_unit:
        typical = float(np.median(known[:, 0]))
        cause = " or ".join(text for factor, text in units.items() if low < k_tc / factor < high)
        return [Doubt(f"{shown}, {k_tc / typical:.2g} times the median{f': {cause}?' if cause else ''}")]
    return []


def _plausible(fit: LawFit) -> bool:
    """Return whether K_tc is positive and the 95 % interval of K_rc has a ratio to K_tc as published."""
    ratios = [row.values[2] / row.values[0] for row in materials()]
    k_tc, k_rc, width = fit.values[0], fit.values[2], fit.half_widths[2]
    return bool(
        k_tc > 0.0 and min(ratios) / EDGE < (k_rc + width) / k_tc and (k_rc - width) / k_tc < max(ratios) * EDGE
    )


def _other_axes(edge: LawFit) -> list[Doubt]:
    """The readings of F_x and F_y with which the coefficients are those of a cut, where they are not as read."""
    most, left = edge.lateral_rms * (FALLS if _plausible(edge) else 1 / FALLS), {}
    # another reading of F_x, F_y -> its matrix from the right
    readings = {
        "forces on the part (--sensor-on part), or with x against the feed": ((-1, 0), (0, -1)),
        "x and y swapped": ((0, 1), (1, 0)),
        "x and y swapped and the signs of both changed": ((0, -1), (-1, 0)),
        "the sensor turned (--sensor-abc 90,0,0)": ((0, 1), (-1, 0)),
        "the sensor turned (--sensor-abc -90,0,0)": ((0, -1), (1, 0)),
        "the sign of y changed, or the other sense of rotation": ((1, 0), (0, -1)),
        "the sign of x changed": ((-1, 0), (0, 1)),
    }
    for name, turned in readings.items():
        force = edge.cuts.force.copy()
        force[:, :2] = force[:, :2] @ np.array(turned)
        with contextlib.suppress(MillingError):
            other = fit_forces(FIRST, dataclasses.replace(edge.cuts, force=force))
            if _plausible(other) and other.lateral_rms < most:
                left[name] = other.lateral_rms
    if not left:
        return []
    names = " or ".join(name for name, rms in left.items() if rms < min(left.values()) / FALLS)
    values = "K_tc is {:.3g}, K_rc {:.3g} N/mm2".format(*(1e-6 * edge.values[[0, 2]]))
    fall = f"the residual falls from {edge.lateral_rms:.3g} to {min(left.values()):.3g} N"
    return [Doubt(f"{values}; with {names} they are those of a cut, and {fall}", True)]


def _contradicting_cut(edge: LawFit) -> list[Doubt]:
    """The cut without which the others agree."""
    clean = 0.2  # residuals fall to this share without the row that is named
    with contextlib.suppress(MillingError):
        row = contradicting_cut(edge.cuts, clean)
        if row is not None:
            return [Doubt(f"cut {row + 1} contradicts the others: correct its row, or use --robust")]
    return []


def _swapped_modes(edge: LawFit) -> list[Doubt]:
    """Up and down milling are mirror images: entry and exit change sign and place."""
    cuts: CutMeasurements = edge.cuts
    slots = np.isclose(cuts.entry, -cuts.exit)
    if slots.all():
        return []
    with contextlib.suppress(MillingError):
        other = fit_forces(FIRST, dataclasses.replace(cuts, entry=-cuts.exit, exit=-cuts.entry))
        better = other.lateral_rms < FALLS * edge.lateral_rms or (
            np.any(edge.values[:4] < 0.0) and np.all(other.values[:4] > 0.0)
        )
        if better:
            return [Doubt(
                "up and down milling are swapped? With the other mode the residual falls from "
                f"{edge.lateral_rms:.3g} to {other.lateral_rms:.3g} N: look at the mode and the sense of rotation"
            )]  # fmt: skip
    return []


# --- a hammer ---


def hammer_doubts(
    modes: list[Mode], shapes: np.ndarray, axis: str, static: np.ndarray | None = None, first: float = math.nan
) -> list[Doubt]:
    """Masses and compliance of the modes at the drive point, on which a wrong unit shows; shapes: (n, 6).

    The modes of the arm are a part of its static compliance, sum phi_d^2 / omega^2 <= C_dd, and nearly all of it where
    they begin with the first mode of the cell.

    static: compliance of arm and tool of the cell, (6, 6); None: without a cell; first: its first mode [rad/s].
    """
    at, omega = AXES.index(axis), 2 * np.pi * np.array([mode.frequency for mode in modes])
    soft, unit = float(np.sum((shapes[:, at] / omega) ** 2)), ("kg", "um/N") if at < 3 else ("kg m2", "urad/(N m)")
    masses = ", ".join(f"{1 / value**2:.3g}" for value in shapes[:, at])
    shown = f"at the drive point the modes have {masses} {unit[0]} and together {1e6 * soft:.3g} {unit[1]}"
    if static is None:
        return [Doubt(f"{shown}, if the columns are in SI units: a motion in g or mm/s2 and a force in kN show only "
                      "with --cell")]  # fmt: skip
    factor = soft / float(static[at, at])
    # factor on compliances -> what causes it
    units = {
        1 / 9.80665: "accelerations in g instead of m/s2",
        1e3: "forces in kN instead of N, or motions in mm instead of m",
        4.44822: "forces in pounds instead of N",
        1e-3: "forces in mN instead of N",
    }
    if factor > UNLIKELY or (factor < 1 / UNLIKELY and np.min(omega) < NEAR * first):
        cause = likely_factor(factor, units) or ": is a unit wrong, or the cell that of another arm?"
        return [Doubt(f"{shown}, {factor:.3g} times that of the cell{cause}", True)]
    return []
