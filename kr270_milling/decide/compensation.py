"""A compensation from the pass as programmed to the decision: what the command and the front door share."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import dataclass

from kr270_milling.cell.cell import Cell
from kr270_milling.cell.jobs import ScoredPass, compensated, compensator, simulate
from kr270_milling.cell.plant import Plant
from kr270_milling.decide.check import Checked, check
from kr270_milling.decide.findings import Violation, violation
from kr270_milling.decide.part.assessment import PartAssessment, assess_all
from kr270_milling.decide.programs.written import written_pass
from kr270_milling.decide.tolerance import Judgement, judge
from kr270_milling.decide.verdict import NO_METHOD, SAMPLES, Verdict, alternatives, monte_carlo
from kr270_milling.physics.compensation.compensator import Compensator
from kr270_milling.physics.compensation.limiting import Limited
from kr270_milling.physics.compensation.methods import Method

__all__ = [
    "BUDGET", "NO_METHOD", "USUAL_BUDGET", "Decision", "JudgedCompensation", "VerdictOrder", "compensate",
    "limit_sentence",
]  # fmt: skip


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


BUDGET = 300.0  #: [s], of a verdict that is asked for; beyond it fewer plants are run
USUAL_BUDGET = 50.0  #: [s], of one that nobody asks for; where 8 plants take longer it is left out
LONGEST_PASS = USUAL_BUDGET / 2  #: [s]; after a longer one not even a first plant is tried


@dataclass(frozen=True)
class VerdictOrder:
    """How a verdict is wanted."""

    samples: int = SAMPLES  #: plants
    asked_for: bool = False  #: whether it may take BUDGET, else USUAL_BUDGET or nothing
    compare: bool = True  #: whether other methods are looked at
    seed: int = 1
    estimate: Callable[[int, float], None] = lambda *_: None  #: is told how many plants in how many seconds are to come


@dataclass(frozen=True, eq=False)
class JudgedCompensation:
    """Both passes and what is to be thought of them."""

    original: ScoredPass
    planned: ScoredPass  #: along the planned reference
    revised: ScoredPass  #: of the program as written; its reference is the planned one
    by: Compensator
    parts: tuple[PartAssessment, ...]  #: of both passes along a tool path
    checked: Checked  #: of the revised path
    decision: Decision


def compensate(
    cell: Cell,
    method: str | Method | None = None,
    *,
    plant: Plant | None = None,
    motion: str | None = None,
    verdict: VerdictOrder | None = None,
    progress: Callable = lambda *_: contextlib.nullcontext(),
) -> JudgedCompensation:
    """Run the path, revise it by a method (default: that of the cell), run that, and judge both.

    plant: what runs the passes; motion: of the programs, LIN or SPLINE; progress(text, passes at most): a context that
    yields what a job calls to tell how far it is.
    """
    method = method or cell.compensation.method
    with progress("original") as report:
        original = simulate(cell, progress=report, plant=plant)
    by = compensator(cell, cell.target(), method)
    with progress(by.method, by.most_passes) as report:
        revised = compensated(cell, original, method, report, by, plant)
    with progress("program as written") as report:
        planned, revised = revised, written_pass(cell, revised, motion, plant, report)
    with progress("surfaces"):
        parts = () if cell.programmed.straight else assess_all(cell, (original, revised))
    limited = [
        violation("correction limited", p.wanted, p.wanted - p.missing, p.worst, said=limit_sentence(p, by))
        for p in by.limited
    ]
    checked = check(cell, revised.reference, motion, ran=revised, more=[*limited, *unlike(planned, revised)])
    with progress("verdict") as report:
        judged = _verdict(cell, original, revised, verdict, report) if verdict else None
    before, after = map(lambda ran, part: judge(cell, ran, part), (original, revised), parts or (None, None))
    recommended = revised.name if after.error < before.error else NO_METHOD
    if judged:
        recommended = judged.recommended
    decision = Decision(before, after, checked.may_be_run, checked.count("warning"), recommended, judged)
    return JudgedCompensation(original, planned, revised, by, parts, checked, decision)


def _verdict(cell: Cell, original: ScoredPass, revised: ScoredPass, order: VerdictOrder, report) -> Verdict | None:
    """What plants drawn from the uncertainties say; None where nobody asked for it and it would take too long."""
    if not order.asked_for and original.result.wall_time > LONGEST_PASS:
        return None
    others = alternatives(cell, original, revised.name) if order.compare else {}
    return monte_carlo(
        cell, revised.reference, order.samples, order.seed, budget=BUDGET if order.asked_for else USUAL_BUDGET,
        give_up=not order.asked_for, progress=report, estimate=order.estimate, method=revised.name, others=others,
    )  # fmt: skip


WRITTEN_SHARE = 0.2  #: share of the planned deviation by which that of the written program may differ
WRITTEN_STEP = 0.5e-6  #: [m], differences below it come from the 0.1 um of the points


def unlike(planned: ScoredPass, written: ScoredPass) -> list[Violation]:
    """A violation where planned and written program differ by more than a share of the planned deviation."""
    plan, error = planned.scores.max_deviation, written.scores.max_deviation
    if abs(error - plan) <= max(WRITTEN_SHARE * plan, WRITTEN_STEP):
        return []
    return [violation("written program", error, plan)]


def limit_sentence(part: Limited, by: Compensator) -> str:
    """What was not let through and, where most of it is for the arm's own inertia, at which feed it would be."""
    if by.learner is None or by.learner.inertia(part.time) < 0.5 * part.wanted:
        return part.sentence
    return f"{part.sentence}; in reach at about {100 * part.feed_share:.0f} % of the programmed feed there"
