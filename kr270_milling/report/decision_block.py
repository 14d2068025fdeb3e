"""What stands on the first screen of a report: the decision, as those who make it deliver it.

Plain records of words and numbers that are ready to be shown: the report judges nothing itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from kr270_milling.decision.check import Checked

__all__ = ["SEVERITIES", "DecisionBlock", "FindingRow", "Judgement", "ReportTable", "decision_of_check"]

#: the worst first
SEVERITIES = ("stop", "warning", "note")


@dataclass(frozen=True)
class Judgement:
    """Whether one version of the path meets the tolerance."""

    passes: bool | None  #: None: no tolerance is given
    sentence: str = ""


@dataclass(frozen=True)
class FindingRow:
    """One thing that was found; value and limit are in ``unit``."""

    severity: str  #: one of SEVERITIES
    what: str
    where: str = ""  #: place in words: "line 42, point 311"
    value: float | None = None
    limit: float | None = None
    unit: str = ""
    advice: str = ""
    count: int = 1  #: places of this kind, of which this is the worst
    point: int | None = None  #: number of the point in the robot program, from 1: the page jumps there


@dataclass(frozen=True)
class DecisionBlock:
    """The answer to what was asked; what is None or empty is not known and is not shown."""

    as_programmed: Judgement | None = None
    compensated: Judgement | None = None
    may_be_run: bool | None = None
    recommended_method: str = ""
    stability: str = ""  #: statement in one sentence
    findings: tuple[FindingRow, ...] = ()
    tolerance: float | None = None  #: [m], of the deviation to the side: drawn as lines in the pictures


@dataclass(frozen=True)
class ReportTable:
    """A further table on the page; the first column is text, the others are texts that are set right-aligned."""

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    note: str = ""


def decision_of_check(checked: Checked, method: str = "") -> DecisionBlock:
    """What ``decision.check`` found, one row for each kind of finding, named by its worst place."""
    groups: dict[tuple[str, str], list[tuple]] = {}
    for finding, line in zip(checked.findings, checked.lines, strict=True):
        groups.setdefault((finding.severity, finding.kind), []).append((finding, line))
    rows = [_row(severity, found) for (severity, _), found in groups.items()]
    return DecisionBlock(may_be_run=not checked.stops, recommended_method=method, findings=tuple(rows))


def _row(severity: str, found: Sequence[tuple]) -> FindingRow:
    worst, line = max(found, key=lambda pair: abs(pair[0].value))
    where = f"point {worst.point}" + ("" if line is None else f", line {line}")
    return FindingRow(severity, worst.sentence, where, count=len(found), point=worst.point)
