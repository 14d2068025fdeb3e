"""Findings: what a check says, where, how far beyond which limit, and what to do about it.

Terminal, JSON, report and the header of every robot program print the same findings.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from kr270_milling.cell.cell import Cell
from kr270_milling.decision.path_limits import Violation
from kr270_milling.trajectory.trajectory import Trajectory

__all__ = ["KINDS", "SEVERITIES", "Finding", "Kind", "Place", "gathered"]

DEG = 180.0 / math.pi


@dataclass(frozen=True)
class Kind:
    """Unit of value and limit, factor from SI to it, and the advice."""

    unit: str = ""
    scale: float = 1.0
    advice: str = "Look at the place before you go on."


KINDS = {
    "reach": Kind("m", 1.0, "Move the workpiece nearer to the arm, or turn the tool."),
    "joint limit": Kind("deg", DEG, "Move or turn the workpiece, or choose another branch by posture_hint_deg."),
    "singularity": Kind("", 1.0, "Move the workpiece, or tilt the mount so that the wrist stays bent."),
    "configuration flip": Kind("", 1.0, "Move the workpiece until the arm keeps its configuration along the path."),
    "joint speed": Kind("deg/s", DEG, "Lower the feed there, or keep away from the singularity."),
    "joint acceleration": Kind("deg/s^2", DEG, "Lower timing.acceleration_m_per_s2, or round the corner."),
    "axis reversal": Kind("um", 1e6, "It shows on the part unless a load holds the axis to one side."),
    "correction size": Kind("mm", 1e3, "Check compliances and force law; then raise compensation.max_correction_mm."),
    "correction per tick": Kind("um", 1e6, "Use method inverse, or raise compensation.max_change_per_tick_um."),
    "correction limited": Kind("mm", 1e3, "Lower the feed there, or raise the limit in section compensation."),
    "corner blending": Kind("%", 100.0, "Lower program.blend_distance_mm, or use SPLINE motions."),
    "spindle torque": Kind("N m", 1.0, "Lower depth, width or feed of the cut."),
    "spindle power": Kind("kW", 1e-3, "Lower depth, width, feed or speed of the cut."),
    "stock missed": Kind("mm3", 1e9, "Check datum, unit and stock."),
    "rapid in material": Kind("mm", 1e3, "Retract above the stock before the rapid move, or feed there (G1)."),
    "below the stock": Kind("mm", 1e3, "Raise the path or lower the stock's bottom; limits.below_stock_mm allows it."),
    "in the fixture": Kind("mm", 1e3, "Move the fixture or the path."),
    "depth of cut": Kind("mm", 1e3, "Mill in more levels, or take a tool with a longer flute."),
    "plunge": Kind("mm", 1e3, "Let the CAM enter by a ramp or helix, or from outside, or take a centre-cutting tool."),
    "feed per tooth": Kind("mm", 1e3, "Check the unit of the feed and the number of teeth; lower F or raise S."),
    "cutting speed": Kind("m/min", 60.0, "Lower the spindle speed."),
    "chatter": Kind("1", 1.0, "Lower the depth of cut, or move to a stable spindle speed (kr270_milling stability)."),
    "deflection": Kind("mm", 1e3, "Check force law, feed per tooth, compliances and masses."),
    "joint deflection": Kind("deg", DEG, "Check compliances and masses; the linear springs do not hold so far."),
    "load on the arm": Kind("1", 1.0, "Check masses and compliances: the arm does not bear its own weight."),
    "tool and grid": Kind("mm", 1e3, "Check tool.diameter_mm, or lower stock.grid_step_um."),
    "envelope": Kind("m", 1.0, "Check workpiece.xyz_mm and its unit: it is on base_link, in mm."),
    "compliance": Kind("urad/(N m)", 1e6, "Check arm.joint_compliance and its unit, urad per N m."),
    "mass": Kind("kg", 1.0, "Check arm.link_mass_kg and mount.mass_kg."),
    "posture": Kind("deg", DEG, "Give the posture within the limits of the arm, in degrees."),
}


SEVERITIES = ("stop", "warning", "note")  #: the worst first


@dataclass(frozen=True)
class Place:
    """Where a finding is; None where it belongs to no point of the path."""

    point: int | None = None  #: number in the robot program, from 1
    line: int | None = None  #: in the file of the tool path
    feature: str | None = None  #: of the part
    position: tuple[float, float, float] | None = None  #: of the tool tip [m], workpiece frame

    def as_dict(self) -> dict:
        """For JSON."""
        place = None if self.position is None else [1e3 * v for v in self.position]
        return {"point": self.point, "line": self.line, "feature": self.feature, "position_mm": place}


@dataclass(frozen=True)
class Finding:
    """Like things that a check found, named by the worst of them."""

    severity: str  #: "stop": must not be run; "warning"; "note"
    what: str
    where: Place
    value: float  #: at the worst place, in ``unit``
    limit: float
    unit: str
    advice: str
    sentence: str  #: of the worst one
    count: int = 1

    def as_dict(self) -> dict:
        """For JSON."""
        names = ("severity", "what", "value", "limit", "unit", "advice", "count", "sentence")
        return {**{name: getattr(self, name) for name in names}, "where": self.where.as_dict()}

    @property
    def text(self) -> str:
        """One line, as every output prints it."""
        times = "" if self.count == 1 else f", and {self.count - 1} more of the kind"
        line = "" if self.where.line is None else f" (line {self.where.line})"
        return f"{self.sentence}{line}{times}. {self.advice}"


def gathered(cell: Cell, run: Trajectory, violations: Iterable[Violation]) -> tuple[Finding, ...]:
    """One finding for all violations of a kind, severity and subject, named by the worst; the worst severity first."""
    groups: dict[tuple[str, str, str], list[Violation]] = {}
    for violation in violations:
        groups.setdefault((violation.severity, violation.kind, violation.subject), []).append(violation)
    findings = [_finding(cell, run, group) for group in groups.values()]
    return tuple(sorted(findings, key=lambda f: (SEVERITIES.index(f.severity), f.where.point or 0)))


def _finding(cell: Cell, run: Trajectory, group: Sequence[Violation]) -> Finding:
    kind = KINDS.get(group[0].kind, Kind())
    worst = max(group, key=lambda v: np.inf if np.isnan(v.value) else abs(v.value - v.limit))
    return Finding(
        severity=worst.severity,
        what=worst.kind,
        where=_place(cell, run, worst.point),
        value=worst.value * kind.scale,
        limit=worst.limit * kind.scale,
        unit=kind.unit,
        advice=kind.advice,
        sentence=worst.sentence,
        count=len(group),
    )


def _place(cell: Cell, run: Trajectory, point: int | None) -> Place:
    if point is None:
        return Place()
    position = tuple(run.position[min(point, len(run)) - 1].tolist())
    fed = cell.fed_path
    if fed is None:
        return Place(point, None, None, position)
    block = int(fed.block[min(point, len(fed.block)) - 1])
    line, feature = int(fed.toolpath.line[block]), fed.toolpath.features[int(fed.toolpath.feature[block])]
    return Place(point, line or None, feature or None, position)
