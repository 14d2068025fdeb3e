"""The decision that every output leads with: tolerance before and after, may it be run, by which method."""

from __future__ import annotations

from dataclasses import dataclass

from kr270_milling.cell.cell import Cell
from kr270_milling.cell.jobs import ScoredPass
from kr270_milling.decision.check import Checked
from kr270_milling.decision.part.assessment import PartAssessment
from kr270_milling.decision.tolerance import Judgement, judge_part, judge_straight_cut

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

    @property
    def headline(self) -> str:
        """One line."""
        run = "yes" if self.may_be_run else "no"
        if self.may_be_run and self.warnings:
            run += f", with {self.warnings} warning{'' if self.warnings == 1 else 's'}"
        return (
            f"as programmed: {self.as_programmed.words}; compensated: {self.compensated.words}; may be run: {run}; "
            f"recommended method: {self.recommended_method}"
        )

    def as_dict(self) -> dict:
        """For JSON."""
        return {
            "as_programmed": self.as_programmed.as_dict(),
            "compensated": self.compensated.as_dict(),
            "may_be_run": self.may_be_run,
            "recommended_method": self.recommended_method,
        }


def decide(
    cell: Cell,
    original: ScoredPass,
    revised: ScoredPass,
    parts: tuple[PartAssessment, ...],
    checked: Checked,
    recommended: str | None = None,
) -> Decision:
    """parts: assessments of both passes, empty for a straight cut; checked: of the revised path.

    recommended: the method that the verdict names; default: that of the revised pass where it makes the part better.
    """
    if parts:
        before, after = (judge_part(cell, part) for part in parts)
    else:
        before, after = (judge_straight_cut(cell, ran) for ran in (original, revised))
    if recommended is None:
        recommended = revised.name if after.error < before.error else NO_METHOD
    return Decision(before, after, checked.may_be_run, checked.count("warning"), recommended)
