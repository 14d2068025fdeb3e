"""The first screen of a report: what was asked, the decision in words and numbers as tiles, the findings.

The report judges nothing itself: ``decision_block`` takes the ``Decision``.
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
from kr270_milling.decide.decision import CAUTION, NO, YES, Decision, decided
from kr270_milling.decide.findings import SEVERITIES, Finding
from kr270_milling.decide.part import PartAssessment
from kr270_milling.decide.tolerance import PATH_DEVIATION, Judgement, judge
from kr270_milling.show.report.tables import fixed_text, micro

TONES = {YES: "good", CAUTION: "caution", NO: "bad"}  #: of the tile

__all__ = ["DecisionBlock", "Tile", "ToleranceAnswer", "asked", "decision_block", "finding_rows", "judged", "tiles"]


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
    level: str = ""  #: "yes", "caution" or "no"
    sentence: str = ""  #: why
    method: str = ""  #: the method that was run, and why
    notes: tuple[str, ...] = ()  #: what a user of the method must know
    verdict: str = ""  #: of plants that are not the model, with its band
    stability: str = ""  #: statement in one sentence
    findings: tuple[Finding, ...] = ()
    rapid_moves: str = ""  #: what rapid moves remove, in one line
    label: str = "decision"  #: of its tile


def decision_block(decision: Decision, checked: Checked) -> DecisionBlock:
    """decision: of an original and a compensated pass; checked: findings of the path that is to be run."""
    return _block(decision.as_programmed, decision.compensated, checked, decision, decision.method_text)


def judged(cell: Cell, passes: Sequence[ScoredPass], parts: Sequence[PartAssessment]) -> DecisionBlock:
    """The decision on passes that come without one, as recordings do: the best of the others against the first.

    parts: their assessments. Where the path cannot be checked any more, the block has no decision.
    """
    judgements = [judge(cell, ran, part) for ran, part in zip(passes, parts, strict=True)]
    best = min(range(len(passes)), key=lambda k: (k == 0 < len(passes) - 1, judgements[k].error))
    decision = checked = None
    with contextlib.suppress(MillingError, OSError):  # the tool path of a recording may be nowhere else
        checked = check(cell, passes[best].reference, ran=passes[best])
        decision = decided(judgements[0], judgements[best], passes[best].name, checked)
    return _block(judgements[0], judgements[best] if best else None, checked, decision)


def _block(
    before: Judgement, after: Judgement | None, checked: Checked | None, decision: Decision | None, method: str = ""
) -> DecisionBlock:
    stability = checked.stability.text.removeprefix("stability: ") if checked and checked.stability else ""
    return DecisionBlock(
        as_programmed=_answer(before),
        compensated=_answer(after) if after else None,
        level=decision.level if decision else "",
        sentence=decision.sentence if decision else "",
        method=method,
        notes=decision.notes if decision else (),
        verdict=decision.verdict.text if decision and decision.verdict else "",
        stability=stability,
        findings=checked.findings if checked else (),
        rapid_moves=checked.rapid_text.removeprefix(f"{RAPID_MOVES}: ") if checked else "",
    )


def _answer(judged: Judgement) -> ToleranceAnswer:
    left = f"{judged.quantity} {1e6 * judged.error:.1f} µm"
    if judged.passes is None:
        return ToleranceAnswer(None, f"{left}; no tolerance is given: set part.tolerance_um")
    where = f" at {judged.feature}" if judged.feature else ""
    return ToleranceAnswer(judged.passes, f"{left}{where}, {1e6 * judged.tolerance:.0f} µm allowed")


def asked(cell: Cell, passes: Sequence[ScoredPass]) -> str:
    """The question, in one sentence."""
    speed = cell.tool.spindle_speed * 30 / np.pi
    cutter = f"a {cell.tool.diameter * 1e3:g} mm cutter with {cell.tool.teeth} teeth at {speed:.0f} rpm"
    then = "" if len(passes) == 1 else ", and what does compensation change"
    return f"How far off does {cell.arm.name} mill {cell.programmed.description} with {cutter}{then}?"


class Tile(NamedTuple):
    """tone: "good", "caution", "bad" or "plain"; the word says the same, so that the colour is not needed."""

    label: str
    word: str
    sentence: str
    tone: str = "plain"


def tiles(
    decision: DecisionBlock, names: Sequence[str], sizes: Sequence[float], quantity: str = PATH_DEVIATION
) -> list[Tile]:
    """The decision as tiles. sizes: tolerance quantity of the passes [m]; quantity: its name."""
    rows = []
    if decision.level:
        rows.append(Tile(decision.label, decision.level, micro(decision.sentence), TONES[decision.level]))
    rows.append(_judged("as programmed", decision.as_programmed, sizes[0], quantity))
    if len(names) > 1:
        best = min(range(1, len(names)), key=lambda k: sizes[k])
        less = 100 * (1 - sizes[best] / sizes[0]) if sizes[best] < sizes[0] else 0.0
        sentence = f"{quantity} of '{names[best]}', " + (f"{less:.1f} % less" if less else "no better")
        rows.append(_judged("compensated", decision.compensated, sizes[best], sentence))
    if decision.method:
        label, _, text = decision.method.partition(": ")
        word, _, why = text.partition(", ")
        rows.append(Tile(label, word, micro("; ".join([why, *decision.notes]))))
    elif decision.notes:
        rows.append(Tile("note", "", micro("; ".join(decision.notes))))
    if decision.verdict:
        word, _, band = decision.verdict.partition(" (")
        rows.append(Tile("verdict", word, micro(band.rstrip(")"))))
    if decision.rapid_moves:
        rows.append(Tile(RAPID_MOVES, "", micro(decision.rapid_moves)))
    if decision.stability:
        rows.append(Tile("stability", "", decision.stability))
    return rows


def _judged(label: str, judged: ToleranceAnswer | None, size: float, sentence: str) -> Tile:
    """size: the tolerance quantity [m], sentence: its name, for a path without a judgement."""
    amount = f"{fixed_text(size * 1e6, 2)} µm"
    if judged is None or judged.passes is None:
        return Tile(label, amount, f"{sentence}; no tolerance is given")
    word, tone = ("passes", "good") if judged.passes else ("fails", "bad")
    return Tile(label, word, judged.sentence or f"{sentence}: {amount}", tone)


def finding_rows(decision: DecisionBlock) -> list[dict]:
    """The worst first; where: the place in words."""
    rows = []
    for one in sorted(decision.findings, key=lambda f: SEVERITIES.index(f.severity)):
        point, line = one.where.point, one.where.line
        words = [one.where.feature, f"line {line}" if line else None, f"XP{point}" if point else None]
        where = ", ".join(filter(None, words))
        rows.append({**vars(one), "sentence": micro(one.sentence), "where": where, "point": point})
    return rows
