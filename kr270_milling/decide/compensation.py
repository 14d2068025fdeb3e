"""A compensation from the pass as programmed to the decision: what the command and the front door share."""

from __future__ import annotations

import contextlib
import dataclasses
import math
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from kr270_milling.base.blocks import return_memory
from kr270_milling.base.column import computed
from kr270_milling.base.errors import MillingError
from kr270_milling.cell.cell import Cell
from kr270_milling.cell.jobs import (
    PLANNED,
    ScoredPass,
    compensated,
    compensator,
    cut_along,
    long_pass,
    record_of,
    simulate,
)
from kr270_milling.cell.models import path_of, removal_of
from kr270_milling.cell.plant import DIVERGED, Plant
from kr270_milling.cell.stage import Removal, places_apart
from kr270_milling.decide.check import Checked, check
from kr270_milling.decide.check_arm import backlash_statement
from kr270_milling.decide.check_cut import spring_back
from kr270_milling.decide.decision import CAUTION, ENOUGH, NO, YES, Decision, Limit, decided, limits
from kr270_milling.decide.findings import Finding, violation
from kr270_milling.decide.levers import QUICK, scheduled
from kr270_milling.decide.part.assessment import Gauge, PartAssessment, assess_all, judge, rigid_part, um_text
from kr270_milling.decide.part.surface import stations_of
from kr270_milling.decide.programs.written import written_pass, written_trajectory
from kr270_milling.decide.stability import stability_statement
from kr270_milling.decide.verdict import (
    CHOOSING_SEED,
    NO_METHOD,
    SAME,
    Verdict,
    alternatives,
    compare_methods,
    drawn_errors,
    errors_as_programmed,
    monte_carlo,
)
from kr270_milling.path.trajectory import Trajectory
from kr270_milling.physics.compensation.compensator import Compensator
from kr270_milling.physics.compensation.method import Method
from kr270_milling.physics.compensation.methods import BEST
from kr270_milling.physics.compensation.revision import Limited
from kr270_milling.physics.motion.scores import Scores


@dataclass(frozen=True, eq=False)
class Compensated:
    """Both passes and the decision on them."""

    original: ScoredPass  #: pass of the original program as written
    planned: ScoredPass  #: pass along the planned reference; a long pass without its series
    revised: ScoredPass  #: pass of the program as written; its reference is the planned one
    by: Compensator
    parts: tuple[PartAssessment, ...]  #: both passes along a tool path
    checked: Checked  #: findings of the revised path
    decision: Decision
    motions: tuple[str, ...]  #: motions of the robot programs
    cell: Cell  #: with the feeds of ``compensation.feed``
    feeds: dict | None = None  #: of ``scheduled``


def compensate(
    cell: Cell,
    method: str | Method | None = None,
    *,
    plant: Plant | None = None,
    motions: Sequence[str] = (),
    robots: int = 0,
    seed: int = 1,
    former: Trajectory | None = None,
    feeds: dict | None = None,
    progress: Callable = lambda *_: contextlib.nullcontext(),
) -> Compensated:
    """Run the path, revise it by a method (default: that of the cell), run that, and judge both.

    The method ``best`` compares the methods and runs the best of them. plant: what runs the passes; motions: of the
    programs, LIN or SPLINE; robots: number of simulated robots of the verdict, drawn from ``seed``; 0: no verdict.
    former: the reference of the last measured part, which stays where a new one promises the robots no gain.
    feeds: summary of the feeds that the path of the cell has already, of ``scheduled``.
    progress(name, passes at most, text): a context that yields a function for the progress of a step. Other methods
    are compared where none was compared before, unless the pass is long: that keeps its series, 180 MB an hour.
    """
    method, robots = (method or cell.compensation.method, robots) if path_of(cell).mills else (NO_METHOD, 0)
    if feeds is None and cell.compensation.scheduled and path_of(cell).mills:
        with progress("feeds") as report:
            planning = NO_METHOD if method == NO_METHOD else QUICK  # the others take several times as long
            cell, feeds = scheduled(cell, planning, (*motions, cell.krl.motion)[0], report)
    beside = ThreadPoolExecutor(1)
    try:  # what the program alone decides is computed beside the learning, which goes from pass to pass
        return _compensated(cell, method, plant, motions, robots, seed, former, feeds, progress, beside)
    finally:
        beside.shutdown(cancel_futures=True)


def _compensated(
    cell: Cell,
    method: str | Method,
    plant: Plant | None,
    motions: Sequence[str],
    robots: int,
    seed: int,
    former: Trajectory | None,
    feeds: dict | None,
    progress: Callable,
    beside: Executor,
) -> Compensated:
    """See ``compensate``; beside: a thread for what does not wait for the learning."""
    target = path_of(cell).target
    rigid = beside.submit(rigid_part, cell)
    with progress("original") as report:
        original = simulate(cell, progress=report, plant=plant)
    comparison = None
    if method == BEST:
        with progress("comparison"):
            comparison = compare_methods(cell, original)
        method = comparison.best
    by = compensator(cell, target, None if method == NO_METHOD else method)
    motions = tuple(motions) or (cell.krl.motion if by.chosen.smooth else "LIN",)
    motion = "LIN" if "LIN" in motions else motions[0]  # LIN motions are blended
    planned, started = original, None
    if not plant:
        if long_pass(path_of(cell)):  # the series fill 200 MB an hour, and the record 70 MB of them
            original = replace(original, result=None, record=record_of(cell, original))  # type: ignore[arg-type]
        as_programmed = beside.submit(written_pass, cell, original, motion)
    if not path_of(cell).straight:
        by.models = replace(by.models, cut=lambda path: rigid.result()[2] or cut_along(cell, path))
        beside.submit(stability_statement, cell)
        started = errors_as_programmed(cell, robots, seed, rigid, beside) if robots else None
    if method != NO_METHOD:
        with progress("compensation", by.most_passes, by.method) as report:
            planned = compensated(cell, original, method, report, by, plant)
        if former is not None:
            chosen, reason = better_program(cell, former, planned.reference)
            if reason:
                by.note, by.limited = reason, ()
                name = FORMER if chosen is former else PROGRAMMED
                planned = simulate(cell, chosen, name, progress=report, plant=plant)
    with progress("programs as written") as report:
        revised = planned if method == NO_METHOD else written_pass(cell, planned, motion, plant, report)
        # of a plant in this order: each pass has its number
        programmed = written_pass(cell, original, motion, plant, report) if plant else as_programmed.result()
    if method == NO_METHOD:
        planned = revised = replace(programmed, name=NO_METHOD)
    compared = original if robots and comparison is None and not long_pass(path_of(cell)) else None
    plan = planned
    if long_pass(path_of(cell)):
        plan = replace(planned, result=None)  # type: ignore[arg-type]
    by.first = None
    del original, planned
    return_memory()
    with progress("surfaces"):
        gauge = rigid.result()[0]
        parts = () if path_of(cell).straight else assess_all(cell, (programmed, revised), gauge)
    limited = [
        violation("correction limited", p.wanted, p.wanted - p.missing, p.worst, sentence=limit_sentence(p, by))
        for p in by.limited
    ]
    checked = check(
        cell,
        revised.reference,
        motion,
        revised,
        progress,
        [*limited, *unlike(plan.scores, revised.scores, cell.krl.tolerance)],
    )
    judged: Verdict | None = None
    if robots:
        with progress("verdict") as report:
            judged = _verdict(cell, compared, revised, robots, seed, report, motion, gauge, started)
    before, after = map(lambda ran, part: judge(cell, ran, part), (programmed, revised), parts or (None, None))
    rows: tuple[Limit, ...] = ()
    if judged and judged.within is not None and judged.within < ENOUGH * robots and checked.may_be_run:
        with progress("limits") as report:
            program = written_trajectory(cell, revised.reference, motion)
            # six robots of each unknown know the larger shares to a fifth
            rows = limits(cell, program, max(2, robots // 5), report)
    shares = cell.uncertainty.least_backlash, cell.uncertainty.backlash
    backlash = backlash_statement(cell.arm.backlash, shares, checked.load_reversals, bool(judged))
    decision = decided(before, after, revised.name, checked, judged, comparison, backlash, rows)
    return Compensated(programmed, plan, revised, by, parts, checked, decision, motions, cell, feeds)


def better_program(cell: Cell, former: Trajectory, planned: Trajectory) -> tuple[Trajectory, str]:
    """Return the reference that is no risk, and the reason where it is not the planned one.

    The planned one must leave half of the robots 10 % less error than the former one, and 90 % of them no more. The
    path as programmed replaces both where half of the robots have 10 % less error with it.
    """
    target = path_of(cell).target
    rows = np.nan_to_num(drawn_errors(cell, (former, planned, target), PLANNED, CHOOSING_SEED)[..., 0], nan=DIVERGED)
    (before, after, none), (worst, worst_after, _) = np.quantile(rows, (0.5, ENOUGH), axis=0)
    chosen, reason = planned, ""
    if after > (1.0 - SAME) * before:
        reason = (
            f"the former program stays: a new one leaves {um_text(after)} and not {um_text(before)}, no gain of 10 %"
        )
    elif worst_after > worst:
        reason = f"the former program stays: a new one leaves a tenth of the robots more than {um_text(worst_after)}"
    if reason:
        chosen = former
    if none < (1.0 - SAME) * (before if reason else after):
        return (
            target,
            f"the path as programmed is better: it leaves {um_text(none)}, and the former program {um_text(before)}",
        )
    return chosen, reason


def _verdict(
    cell: Cell,
    original: ScoredPass | None,
    revised: ScoredPass,
    robots: int,
    seed: int,
    report,
    motion: str,
    gauge: Gauge,
    started: tuple | None,
) -> Verdict:
    """Return the verdict of simulated robots.

    original: the pass on which other methods are planned for comparison; None: no comparison; motion: of the written
    programs, which the robots run.
    """
    others = alternatives(cell, original, revised.name) if original else {}
    programs = {}
    for name, run in others.items():
        with contextlib.suppress(MillingError):
            programs[name] = written_trajectory(cell, run, motion if run.velocity is not None else "LIN")
    program = written_trajectory(cell, revised.reference, motion)
    about: dict = dict(method=revised.name, others=programs, gauge=gauge, started=started)
    return monte_carlo(cell, program, robots, seed, progress=report, **about)


FORMER, PROGRAMMED = "former", "as_programmed"  #: names of a program that stays, and of one without a correction


def unlike(planned: Scores, written: Scores, tolerance: float) -> list[Finding]:
    """A violation where planned and written program differ by more than a share of the planned deviation.

    tolerance [m]: by which the points of the program may leave the planned path. After a step of the path by it, an
    arm with little damping swings by twice of it.
    """
    plan, error = planned.max_deviation, written.max_deviation
    written_share = 0.2  # share of the planned deviation by which that of the written program may differ
    written_step = 0.5e-6  # [m], differences below it come from the 0.1 um of the points
    if abs(error - plan) <= max(written_share * plan, 2.0 * tolerance + written_step):
        return []
    return [violation("written program", error, plan)]


def limit_sentence(part: Limited, by: Compensator) -> str:
    """Return the part of a correction that was cut off; if inertia dominates, also the feed at which it would fit."""
    if by.learner is None or part.missing >= part.wanted or by.learner.inertia(part.time) < 0.5 * part.wanted:
        return part.sentence
    return f"{part.sentence}; in reach at about {100 * part.feed_share:.0f} % of the programmed feed there"


Done = TypeVar("Done")


def in_turn(
    cells: Sequence[Cell], job: Callable[[Cell], Done], passed: Callable[[Done], ScoredPass | None]
) -> list[tuple[Cell, Done]]:
    """Do a job for the tools of a program in their order; a cell without other tools stays unchanged.

    passed: the pass of a job, whose workpiece the next tool begins with; None: the pass must not be run, and the tool
    leaves its programmed part. Returns each cell, on its workpiece, and the result of its job.
    """
    done: list[tuple[Cell, Done]] = []
    earlier: tuple[Removal, ...] = cells[0].stage.earlier if cells[0].stage else ()
    for next_cell in cells:
        cell = next_cell.after(earlier)
        result = job(cell)
        done.append((cell, result))
        if cell is not cells[-1] and len(done) < len(cells):
            earlier += (_removal(cell, passed(result)),)
    return done


def _removal(cell: Cell, ran: ScoredPass | None) -> Removal:
    """Return the material that the tool of a cell removes in a pass; None: on its programmed path."""
    programmed = removal_of(cell)
    if ran is None:
        return programmed
    path, result = stations_of(path_of(cell), ran.result.time_ns), ran.result
    same_place = 1e-9  # [m]
    moved = np.linalg.norm(np.diff(result.actual, axis=0), axis=1) > same_place
    actual = np.ascontiguousarray(result.actual[np.concatenate([[True], moved])])
    # a pass by teeth has ten times as many places: the first of each stretch and that of the largest deflection
    stretch, line = np.floor(path.distance / places_apart(programmed.radius)), path_of(cell).line_at(result.time_ns)
    stretch = np.cumsum((np.diff(stretch, prepend=-1) != 0) | (np.diff(line, prepend=-1) != 0))
    starts = np.flatnonzero(np.diff(stretch, prepend=0))
    largest = np.lexsort((-np.linalg.norm(result.deflection[:, :3], axis=1), stretch))[starts]
    rows = np.unique(np.concatenate([starts, largest, np.flatnonzero(np.diff(line, append=-1))]))
    few = np.ascontiguousarray(result.actual[rows])
    return dataclasses.replace(programmed, actual=actual, few=few, spring_back=spring_back(cell, ran))


@dataclass(frozen=True)
class DecisionOnTools:
    """The decision on a program with several tools: that of the worst tool."""

    tools: tuple[tuple[str, Decision], ...]  #: decisions by name of the tool, in the order of the program

    @classmethod
    def of(cls, jobs: Sequence[tuple[Cell, Compensated]]) -> DecisionOnTools:
        """The decision on the compensations of all tools; jobs: as ``in_turn`` returns them."""
        return cls(tuple((cell.stage.tool, done.decision) for cell, done in jobs if cell.stage))

    @computed("decision")
    def level(self) -> str:
        """``yes``, ``caution`` or ``no``. A tool without a wall or floor that stays is judged by its stops alone."""
        levels = [tool.level for _, tool in self.tools if tool.level == NO or not math.isnan(tool.compensated.error)]
        return next((level for level in (NO, CAUTION, YES) if level in levels), CAUTION)

    @property
    def worst(self) -> tuple[str, Decision]:
        """The tool that decides: of those of this level the first with a stop, else that with the largest share."""
        same = [pair for pair in self.tools if pair[1].level == self.level]
        shares = [math.inf if tool.stops else np.nan_to_num(tool.compensated.share, nan=-1.0) for _, tool in same]
        return same[int(np.argmax(shares))]

    @property
    def exit_code(self) -> int:
        """0, or 1 for ``no``."""
        return int(self.level == NO)

    @computed("may_be_run")
    def may_be_run(self) -> bool:
        """Return whether no tool has a stop."""
        return all(tool.may_be_run for _, tool in self.tools)

    @computed("deciding_tool")
    def _deciding_tool(self) -> str:
        return self.worst[0]

    @computed("sentence")
    def sentence(self) -> str:
        """Return the reason, with the name of the tool."""
        name, decision = self.worst
        return f"{name}: {decision.sentence}"

    @property
    def text(self) -> str:
        """Return level and sentence in one line."""
        return f"decision: {self.level}: {self.sentence}"

    def lines(self, tool: str = "") -> list[str]:
        """The decision, then the lines of each tool, or of one."""
        lines = [self.text]
        for name, one in self.tools:
            if tool in ("", name):
                lines += [f"{name}: {line}" for line in (f"{one.level}: {one.sentence}", *one.lines()[1:])]
        return lines
