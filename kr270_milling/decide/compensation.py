"""A compensation from the pass as programmed to the decision: what the command and the front door share."""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from kr270_milling.base.errors import MillingError
from kr270_milling.cell.cell import Cell
from kr270_milling.cell.jobs import ScoredPass, compensated, compensator, simulate
from kr270_milling.cell.plant import Plant
from kr270_milling.cell.saved_passes import SavedPasses
from kr270_milling.decide.check import Checked, check, check_weights
from kr270_milling.decide.decision import Decision, decided
from kr270_milling.decide.findings import Violation, violation
from kr270_milling.decide.load_reversals import backlash_statement
from kr270_milling.decide.part.assessment import PartAssessment, assess_all
from kr270_milling.decide.programs.written import written_pass, written_trajectory
from kr270_milling.decide.tolerance import judge
from kr270_milling.decide.verdict import (
    FEWEST,
    NO_METHOD,
    SAMPLES,
    Verdict,
    alternatives,
    compare_methods,
    cores,
    monte_carlo,
    plants_at_once,
)
from kr270_milling.physics.compensation.compensator import Compensator
from kr270_milling.physics.compensation.limiting import Limited
from kr270_milling.physics.compensation.method import Method
from kr270_milling.physics.compensation.methods import BEST, METHODS
from kr270_milling.physics.motion.scores import Scores

__all__ = [
    "NO_METHOD", "USUAL_BUDGET", "JudgedCompensation", "VerdictOrder", "compensate", "limit_sentence",
    "weights",
]  # fmt: skip


USUAL_BUDGET = 50.0  #: [s], of a verdict that is not asked for: within this time more than 8 plants run
LONGEST_VERDICT = 150.0  #: [s], of 8 plants that are not asked for; where 8 take longer no verdict is made
COMPARISON, PLANNING, SURFACES, COARSE = 1.0, 0.3, 0.1, 0.25  #: time as multiples of that of a pass, on the test piece
REPEATS = 3  #: passes that a method that repeats usually takes
LONGEST_PASS = USUAL_BUDGET / 2  #: [s]; after a longer one not even a first plant is tried


@dataclass(frozen=True)
class VerdictOrder:
    """How a verdict is wanted."""

    samples: int = SAMPLES  #: plants
    asked_for: bool = False  #: whether all plants run; else as many as there is time for, see ``_affordable``
    compare: bool = True  #: whether other methods are looked at
    seed: int = 1
    estimate: Callable[[int, float], None] = lambda *_: None  #: receives the plants and the seconds that are to come


@dataclass(frozen=True, eq=False)
class JudgedCompensation:
    """Both passes and the decision on them."""

    original: ScoredPass  #: of the original program as written
    planned: Scores  #: of the pass along the planned reference
    revised: ScoredPass  #: of the program as written; its reference is the planned one
    by: Compensator
    parts: tuple[PartAssessment, ...]  #: of both passes along a tool path
    checked: Checked  #: of the revised path
    decision: Decision
    motions: tuple[str, ...]  #: of the robot programs

    def lines(self) -> list[str]:
        """The decision and the findings, as terminal, manifest and programs print them."""
        return [*self.decision.lines(), *self.checked.findings_lines(), self.checked.counts]


def weights(
    cell: Cell, method: str | None = None, order: VerdictOrder | None = None
) -> dict[str, float | Callable[[float], float]]:
    """Time of each step of a compensation as a multiple of that of a pass.

    That of the verdict is a function of the seconds of a pass, since the verdict has a limit of time.
    """
    settings, chosen = cell.compensation, METHODS.get(method or cell.compensation.planned_method)
    passes = min(settings.max_passes, REPEATS) if settings.repeat or (chosen and chosen.repeats) else 1
    result: dict[str, float | Callable[[float], float]] = {"original": 1.0}
    if (method or settings.method) == BEST:
        result["comparison"] = COMPARISON
    result |= {"compensation": PLANNING + passes, "program as written": 1.0, "original program as written": 1.0}
    result |= {"surfaces": SURFACES} | check_weights(cell)
    del result["milling"]
    if order:
        result["verdict"] = lambda each: _verdict_seconds(cell, order, each)
    return result


def _verdict_seconds(cell: Cell, order: VerdictOrder, each: float) -> float:
    """Seconds of a verdict from those of a pass; 0 where none is made."""
    made = _affordable(cell, order, each)
    if made is None:
        return 0.0
    straight, plant = cell.programmed.straight, _plant_seconds(cell, made, each)
    whole = made.samples * plant
    if straight and made.compare:
        whole += each * FEWEST * 2 * REPEATS / cores()  # plants that learn
    return whole if made.asked_for else min(whole, max(USUAL_BUDGET, FEWEST * plant))


def _plant_seconds(cell: Cell, order: VerdictOrder, each: float) -> float:
    """Seconds of a simulated robot from those of a pass."""
    straight = cell.programmed.straight
    coarse = 1.0 if straight or cell.by_engagement else COARSE
    runs = (len(METHODS) if straight else 3) if order.compare else 2
    return each * coarse * runs / plants_at_once(cell)


def _affordable(cell: Cell, order: VerdictOrder, each: float) -> VerdictOrder | None:
    """The part of an order for which there is time; each [s]: of a pass.

    What was asked for is made, unless the tool only drills: nothing is judged. Else 8 plants compare no other methods
    where this would take longer than USUAL_BUDGET, and none run where they would take longer than LONGEST_VERDICT.
    """
    if not cell.programmed.mills:
        return None
    if order.asked_for:
        return order
    if FEWEST * _plant_seconds(cell, order, each) > USUAL_BUDGET:
        order = replace(order, compare=False)
    too_long = FEWEST * _plant_seconds(cell, order, each) > LONGEST_VERDICT or each > LONGEST_PASS
    return None if too_long else order


def compensate(
    cell: Cell,
    method: str | Method | None = None,
    *,
    plant: Plant | None = None,
    motions: Sequence[str] = (),
    verdict: VerdictOrder | None = None,
    progress: Callable = lambda *_: contextlib.nullcontext(),
    saved: SavedPasses | None = None,
) -> JudgedCompensation:
    """Run the path, revise it by a method (default: that of the cell), run that, and judge both.

    The method ``best`` compares the methods and runs the best of them. plant: what runs the passes; motions: of the
    programs, LIN or SPLINE; progress(name, passes at most, text): a context that yields a function for the progress of
    a step, see ``weights``; saved: finished passes of an interrupted run.
    """
    method = (method or cell.compensation.method) if cell.programmed.mills else NO_METHOD
    with progress("original") as report:
        original = simulate(cell, progress=report, plant=plant)
    comparison = None
    if method == BEST:
        with progress("comparison"):
            comparison = compare_methods(cell, original)
        method = comparison.best
    by = compensator(cell, cell.target(), None if method == NO_METHOD else method)
    motions = tuple(motions) or (cell.program.motion if by.chosen.smooth else "LIN",)
    motion = "LIN" if "LIN" in motions else motions[0]  # LIN motions are blended
    planned = revised = original
    if method != NO_METHOD:
        with progress("compensation", by.most_passes, by.method) as report:
            planned = compensated(cell, original, method, report, by, plant, saved)
        with progress("program as written") as report:
            revised = written_pass(cell, planned, motion, plant, report)
    with progress("original program as written") as report:
        begin = time.perf_counter()
        programmed = written_pass(cell, original, motion, plant, report)
        each = time.perf_counter() - begin
    if method == NO_METHOD:
        planned = revised = replace(programmed, name=NO_METHOD)
    order = verdict and _affordable(cell, verdict, each)
    compared = original if order and order.compare and comparison is None else None
    plan = planned.scores
    by.first = None
    del original, planned  # the series of a pass of an hour fill 180 MB
    with progress("surfaces"):
        parts = () if cell.programmed.straight else assess_all(cell, (programmed, revised))
    limited = [
        violation("correction limited", p.wanted, p.wanted - p.missing, p.worst, said=limit_sentence(p, by))
        for p in by.limited
    ]
    checked = check(
        cell, revised.reference, motion, revised, progress,
        [*limited, *unlike(plan, revised.scores, cell.program.tolerance)],
    )  # fmt: skip
    judged: Verdict | None = None
    with progress("verdict") as report:
        if order is not None:
            judged = _verdict(cell, compared, revised, order, report, motion)
    before, after = map(lambda ran, part: judge(cell, ran, part), (programmed, revised), parts or (None, None))
    backlash = backlash_statement(cell, checked.load_reversals, bool(judged))
    decision = decided(before, after, revised.name, checked, judged, comparison, backlash)
    return JudgedCompensation(programmed, plan, revised, by, parts, checked, decision, motions)


def _verdict(
    cell: Cell, original: ScoredPass | None, revised: ScoredPass, order: VerdictOrder, report, motion: str
) -> Verdict | None:
    """The verdict of plants drawn from the uncertainties; None where it was not asked for and would take too long.

    original: the pass on which other methods are planned for comparison; None: no comparison; motion: of the written
    programs, which the plants run.
    """
    others = alternatives(cell, original, revised.name) if original else {}
    programs = {}
    for name, run in others.items():
        with contextlib.suppress(MillingError):
            programs[name] = written_trajectory(cell, run, motion if run.velocity is not None else "LIN")
    program = written_trajectory(cell, revised.reference, motion)
    budget, longest = (math.inf, math.inf) if order.asked_for else (USUAL_BUDGET, LONGEST_VERDICT)
    return monte_carlo(
        cell, program, order.samples, order.seed, budget=budget, longest=longest, progress=report,
        estimate=order.estimate, method=revised.name, others=programs,
    )  # fmt: skip


WRITTEN_SHARE = 0.2  #: share of the planned deviation by which that of the written program may differ
WRITTEN_STEP = 0.5e-6  #: [m], differences below it come from the 0.1 um of the points


def unlike(planned: Scores, written: Scores, tolerance: float) -> list[Violation]:
    """A violation where planned and written program differ by more than a share of the planned deviation.

    tolerance [m]: by which the points of the program may leave the planned path. After a step of the path by it, an
    arm with little damping swings by twice of it.
    """
    plan, error = planned.max_deviation, written.max_deviation
    if abs(error - plan) <= max(WRITTEN_SHARE * plan, 2.0 * tolerance + WRITTEN_STEP):
        return []
    return [violation("written program", error, plan)]


def limit_sentence(part: Limited, by: Compensator) -> str:
    """What was not let through and, where most of it is for the arm's own inertia, at which feed it would be."""
    if by.learner is None or by.learner.inertia(part.time) < 0.5 * part.wanted:
        return part.sentence
    return f"{part.sentence}; in reach at about {100 * part.feed_share:.0f} % of the programmed feed there"
