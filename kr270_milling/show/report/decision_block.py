"""The first screen of a report: what was asked, the decision in words and numbers as tiles, the findings.

The report judges nothing itself: ``decision_block`` takes over what ``decision`` found.
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from kr270_milling.base.errors import MillingError
from kr270_milling.cell.cell import Cell
from kr270_milling.cell.jobs import ScoredPass
from kr270_milling.decide.check import RAPID_MOVES, Checked, check
from kr270_milling.decide.compensation import NO_METHOD, Decision
from kr270_milling.decide.findings import SEVERITIES, Finding
from kr270_milling.decide.part import PartAssessment
from kr270_milling.decide.tolerance import Judgement, judge
from kr270_milling.show.report.tables import fixed_text, micro

__all__ = ["ToleranceAnswer", "DecisionBlock", "Tile", "asked", "decision_block", "finding_rows", "judged", "tiles"]


@dataclass(frozen=True)
class ToleranceAnswer:
    """Whether one version of the path meets the tolerance."""

    passes: bool | None  #: None: no tolerance is given
    sentence: str = ""


@dataclass(frozen=True)
class DecisionBlock:
    """The answer to what was asked; what is None or empty is not known and is not shown."""

    as_programmed: ToleranceAnswer | None = None
    compensated: ToleranceAnswer | None = None
    may_be_run: bool | None = None
    recommended_method: str = ""
    verdict: str = ""  #: of plants that are not the model, with its band
    stability: str = ""  #: statement in one sentence
    findings: tuple[Finding, ...] = ()
    rapid_moves: str = ""  #: what rapid moves remove, in one line


def decision_block(decision: Decision, checked: Checked) -> DecisionBlock:
    """decision: of an original and a compensated pass; checked: findings of the path that is to be run."""
    verdict = decision.verdict.text if decision.verdict else ""
    return _block(decision.as_programmed, decision.compensated, checked, decision.recommended_method, verdict)


def judged(cell: Cell, passes: Sequence[ScoredPass], parts: Sequence[PartAssessment]) -> DecisionBlock:
    """The decision on passes that come without one, as recordings do: the best of the others against the first.

    parts: their assessments. Where the path cannot be checked any more, nothing is said of whether it may be run.
    """
    judgements = [judge(cell, ran, part) for ran, part in zip(passes, parts, strict=True)]
    best = min(range(len(passes)), key=lambda k: (k == 0 < len(passes) - 1, judgements[k].error))
    checked = None
    with contextlib.suppress(MillingError, OSError):  # the tool path of a recording may be nowhere else
        checked = check(cell, passes[best].reference, ran=passes[best])
    if not best:
        return _block(judgements[0], None, checked)
    better = judgements[best].error < judgements[0].error
    return _block(judgements[0], judgements[best], checked, passes[best].name if better else NO_METHOD)


def _block(before: Judgement, after: Judgement | None, checked: Checked | None, method="", verdict="") -> DecisionBlock:
    stability = checked.stability.text.removeprefix("stability: ") if checked and checked.stability else ""
    may_be_run, findings = (checked.may_be_run, checked.findings) if checked else (None, ())
    rapid_moves = checked.rapid_text.removeprefix(f"{RAPID_MOVES}: ") if checked else ""
    compensated = _answer(after) if after else None
    return DecisionBlock(_answer(before), compensated, may_be_run, method, verdict, stability, findings,
                         rapid_moves)  # fmt: skip


def _answer(judged: Judgement) -> ToleranceAnswer:
    left = f"{1e6 * judged.error:.1f} µm on wall or floor"
    if judged.passes is None:
        return ToleranceAnswer(None, f"{left}; part.tolerance_um says nothing")
    where = f" at {judged.feature}" if judged.feature else ""
    return ToleranceAnswer(judged.passes, f"{left}{where}, {1e6 * judged.tolerance:.0f} µm allowed")


def asked(cell: Cell, passes: Sequence[ScoredPass]) -> str:
    """The question, in one sentence."""
    speed = cell.tool.spindle_speed * 30 / np.pi
    how = f"a {cell.tool.diameter * 1e3:g} mm cutter with {cell.tool.teeth} teeth at {speed:.0f} rpm"
    then = "" if len(passes) == 1 else ", and what does compensation change"
    return f"How far off does {cell.arm.name} mill {cell.programmed.description} with {how}{then}?"


class Tile(NamedTuple):
    """tone: "good", "bad" or "plain"; the word says the same, so that the colour is not needed."""

    label: str
    word: str
    sentence: str
    tone: str = "plain"


def tiles(decision: DecisionBlock, names: Sequence[str], sizes: Sequence[float]) -> list[Tile]:
    """The decision; what nobody decided is said to be open. sizes: largest deviations of the passes [m]."""
    found = [_judged("as programmed", decision.as_programmed, sizes[0], "largest deviation")]
    if len(names) > 1:
        best = min(range(1, len(names)), key=lambda k: sizes[k])
        less = 100 * (1 - sizes[best] / sizes[0]) if sizes[best] < sizes[0] else 0.0
        said = f"largest deviation of '{names[best]}', " + (f"{less:.1f} % less" if less else "no better")
        found.append(_judged("compensated", decision.compensated, sizes[best], said))
    if decision.may_be_run:
        found.append(Tile("may be run", "yes", "no finding forbids it", "good"))
    elif decision.may_be_run is not None:
        stops = sum(f.severity == "stop" for f in decision.findings)
        found.append(Tile("may be run", "no", f"{stops} finding{'s' * (stops != 1)} forbid it", "bad"))
    if decision.recommended_method:
        why = "run the path as it was programmed" if decision.recommended_method == NO_METHOD else ""
        found.append(Tile("recommended method", decision.recommended_method, why))
    if decision.verdict:
        word, _, band = decision.verdict.partition(" (")
        found.append(Tile("verdict", word, micro(band.rstrip(")"))))
    if decision.rapid_moves:
        found.append(Tile(RAPID_MOVES, "", micro(decision.rapid_moves)))
    if decision.stability:
        found.append(Tile("stability", "", decision.stability))
    return found


def _judged(label: str, judged: ToleranceAnswer | None, size: float, said: str) -> Tile:
    """size: the largest deviation [m], said: what it is, for a path that nobody judged."""
    amount = f"{fixed_text(size * 1e6, 2)} µm"
    if judged is None or judged.passes is None:
        return Tile(label, amount, f"{said}; no tolerance is given")
    word, tone = ("passes", "good") if judged.passes else ("fails", "bad")
    return Tile(label, word, judged.sentence or f"{said}: {amount}", tone)


def finding_rows(decision: DecisionBlock) -> list[dict]:
    """The worst first; where: the place in words."""
    found = []
    for one in sorted(decision.findings, key=lambda f: SEVERITIES.index(f.severity)):
        point, line = one.where.point, one.where.line
        words = [one.where.feature, f"line {line}" if line else None, f"XP{point}" if point else None]
        where = ", ".join(filter(None, words))
        found.append({**vars(one), "sentence": micro(one.sentence), "where": where, "point": point})
    return found
