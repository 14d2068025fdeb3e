"""What stands on the first screen of a report: the decision in words and numbers that are ready to be shown.

The report judges nothing itself: ``decision_block`` takes over what ``decision`` found.
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass

from kr270_milling.base.errors import MillingError
from kr270_milling.cell.cell import Cell
from kr270_milling.cell.jobs import ScoredPass
from kr270_milling.decision.check import Checked, check
from kr270_milling.decision.compensation import NO_METHOD, Decision
from kr270_milling.decision.findings import Finding
from kr270_milling.decision.part import PartAssessment
from kr270_milling.decision.tolerance import Judgement, judge

__all__ = ["Answer", "DecisionBlock", "ReportTable", "decision_block", "judged"]

MICRO = "µm"


@dataclass(frozen=True)
class Answer:
    """Whether one version of the path meets the tolerance."""

    passes: bool | None  #: None: no tolerance is given
    sentence: str = ""


@dataclass(frozen=True)
class DecisionBlock:
    """The answer to what was asked; what is None or empty is not known and is not shown."""

    as_programmed: Answer | None = None
    compensated: Answer | None = None
    may_be_run: bool | None = None
    recommended_method: str = ""
    verdict: str = ""  #: of plants that are not the model, with its band
    stability: str = ""  #: statement in one sentence
    findings: tuple[Finding, ...] = ()


@dataclass(frozen=True)
class ReportTable:
    """A table on the page; the first column is text, the others are texts that are set right-aligned."""

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    note: str = ""


def decision_block(decision: Decision, checked: Checked) -> DecisionBlock:
    """decision: of an original and a compensated pass; checked: findings of the path that is to be run."""
    return DecisionBlock(
        as_programmed=_answer(decision.as_programmed),
        compensated=_answer(decision.compensated),
        may_be_run=decision.may_be_run,
        recommended_method=decision.recommended_method,
        verdict=decision.verdict.text if decision.verdict else "",
        stability=_stated(checked),
        findings=checked.findings,
    )


def judged(cell: Cell, passes: Sequence[ScoredPass], parts: Sequence[PartAssessment]) -> DecisionBlock:
    """The decision on passes that come without one, as recordings do: the best of the others against the first.

    parts: their assessments. Where the path cannot be checked any more, nothing is said of whether it may be run.
    """
    known = parts if cell.path.file else [None] * len(passes)
    judgements = [judge(cell, ran, part) for ran, part in zip(passes, known, strict=True)]
    best = min(range(len(passes)), key=lambda k: (k == 0 < len(passes) - 1, judgements[k].error))
    checked = None
    with contextlib.suppress(MillingError, OSError):  # the tool path of a recording may be nowhere else
        checked = check(cell, passes[best].reference, ran=passes[best])
    compensated = judgements[best] if best else None
    better = compensated is not None and compensated.error < judgements[0].error
    return DecisionBlock(
        as_programmed=_answer(judgements[0]),
        compensated=_answer(compensated) if compensated else None,
        may_be_run=checked.may_be_run if checked else None,
        recommended_method="" if compensated is None else passes[best].name if better else NO_METHOD,
        stability=_stated(checked),
        findings=checked.findings if checked else (),
    )


def _stated(checked: Checked | None) -> str:
    return checked.stability.text.removeprefix("stability: ") if checked and checked.stability else ""


def _answer(judged: Judgement) -> Answer:
    left = f"{1e6 * judged.error:.1f} {MICRO} on wall or floor"
    if judged.passes is None:
        return Answer(None, f"{left}; part.tolerance_um says nothing")
    where = f" at {judged.feature}" if judged.feature else ""
    return Answer(judged.passes, f"{left}{where}, {1e6 * judged.tolerance:.0f} {MICRO} allowed")
