"""Findings: what a check says, where, how far beyond which limit, and what to do about it.

Terminal, JSON, report and the header of every robot program print the same findings.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from kr270_milling.cell.cell import Cell
from kr270_milling.decision.advice import KINDS, Kind
from kr270_milling.decision.path_limits import Violation
from kr270_milling.trajectory.trajectory import Trajectory

__all__ = ["SEVERITIES", "Finding", "Place", "gathered"]

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
