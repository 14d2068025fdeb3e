"""The decision that every output leads with: tolerance before and after, may it be run, by which method."""

from __future__ import annotations

from dataclasses import dataclass

from kr270_milling.cell.cell import Cell
from kr270_milling.cell.jobs import ScoredPass
from kr270_milling.decision.check import Checked
from kr270_milling.decision.part.assessment import PartAssessment
from kr270_milling.decision.tolerance import Judgement, judge
from kr270_milling.decision.verdict import Verdict

__all__ = ["NO_METHOD", "Decision", "decide"]

NO_METHOD = "none"  #: run the path as it was programmed


@dataclass(frozen=True)
class Decision:
    """What to do with a compensated path."""

    as_programmed: Judgement
    compensated: Judgement
    may_be_run: bool
    warnings: int
    recommended_method: str  #: "none": the compensation does not make the part better
    verdict: Verdict | None = None  #: of plants that are not the model; None: nobody asked, or it would take long

    @property
    def headline(self) -> str:
        """One line."""
        run = "yes" if self.may_be_run else "no"
        if self.may_be_run and self.warnings:
            run += f", with {self.warnings} warning{'' if self.warnings == 1 else 's'}"
        verdict = f"; verdict: {self.verdict.text}" if self.verdict else ""
        return (
            f"as programmed: {self.as_programmed.words}; compensated: {self.compensated.words}; may be run: {run}"
            f"{verdict}; recommended method: {self.recommended_method}"
        )

    def as_dict(self) -> dict:
        """For JSON."""
        return {
            "as_programmed": self.as_programmed.as_dict(),
            "compensated": self.compensated.as_dict(),
            "may_be_run": self.may_be_run,
            "recommended_method": self.recommended_method,
            "verdict": self.verdict and self.verdict.word,
        }


def decide(
    cell: Cell,
    original: ScoredPass,
    revised: ScoredPass,
    parts: tuple[PartAssessment, ...],
    checked: Checked,
    verdict: Verdict | None = None,
) -> Decision:
    """parts: assessments of both passes, empty for a straight cut; checked: of the revised path.

    Without a verdict the method of the revised pass is recommended where it makes the part better.
    """
    before, after = map(lambda ran, part: judge(cell, ran, part), (original, revised), parts or (None, None))
    better = revised.name if after.error < before.error else NO_METHOD
    recommended = verdict.recommended if verdict else better
    return Decision(before, after, checked.may_be_run, checked.count("warning"), recommended, verdict)
