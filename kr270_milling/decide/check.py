"""All checks of one cell, and of a corrected trajectory in it; and of numbers that no arm, tool or placement has."""

from __future__ import annotations

import contextlib
import dataclasses
import math
import re
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np

from kr270_milling.base.column import column, computed, counted
from kr270_milling.base.errors import InputError
from kr270_milling.base.frames import lifted, tool_axis
from kr270_milling.cell.arm import joints_at_knots
from kr270_milling.cell.cell import Cell
from kr270_milling.cell.jobs import ScoredPass, simulate
from kr270_milling.cell.models import arm_of, path_of
from kr270_milling.cell.paths import CellPath
from kr270_milling.cell.plant import cores
from kr270_milling.cell.sections import Program, Tolerances
from kr270_milling.decide.check_arm import (
    arm_violations,
    corner_blending,
    correction_per_tick,
    correction_size,
    link_contacts,
    load_reversals,
    motion_violations,
    reach_violations,
)
from kr270_milling.decide.check_cut import Contacts, Residue, cut_violations, path_contacts, residue_of
from kr270_milling.decide.findings import SEVERITIES, Finding, gathered, placed, violation
from kr270_milling.decide.inputs import input_violations
from kr270_milling.decide.part.assessment import Judgement, assess, judge
from kr270_milling.decide.part.surface import rigid_workpiece
from kr270_milling.decide.programs.files import knot_feeds
from kr270_milling.decide.programs.points import ProgramBlocks, fixed_knots, program_blocks, program_points
from kr270_milling.decide.programs.written import drafted
from kr270_milling.decide.stability import Stability, chatter_violations, stability_statement
from kr270_milling.path.source_program import SourceProgram
from kr270_milling.path.trajectory import Trajectory, TrajectoryError
from kr270_milling.physics.cutting import CutModel
from kr270_milling.physics.motion.milling_pass import FLIGHT, PassError
from kr270_milling.physics.robot.errors import DeflectionError, EquilibriumError, UnstableLoadError

MOST_ROWS = 2**19  #: of the series of the simulated pass, some 220 bytes each: 35 min at 4 ms
WINDOW = 0.1  #: [s], over which the corrections of the mean force count: one period corrects the next


def exchange_share(path: CellPath, ran: ScoredPass, tolerances: Tolerances) -> tuple[float, str, list[Finding]]:
    """Return the largest correction of a predicted pose as a share of the length of the chip, its line, and findings.

    By the correction the chip geometry of one period was wrong. A share above its limit is a stop, unless the
    correction is below 5 % of the tolerance.

    The sweep of the teeth compares each correction with the feed per tooth. The mean force compares the root mean
    square over WINDOW with the feed of a period, or with that of a tooth where this is longer: material that one period
    missed is removed in the next, so that a single step of the force, as at an entry, changes one period alone.
    """
    negligible = 0.05  # share of the tolerance: a smaller correction is no stop, however slow the feed, as in a plunge
    scale = path.feed_rate * 2.0 * np.pi / (path.tool.spindle_speed * path.tool.teeth)
    correction, name, period = ran.result.correction, "feed per tooth", "exchange.period_ms"
    if not path.by_teeth:
        periods = max(1, round(WINDOW / path.exchange.period))
        correction = np.sqrt(np.convolve(correction**2, np.full(periods, 1.0 / periods), mode="same"))
        name, period = "feed per tooth or period, over 0.1 s", "exchange.engagement_period_ms"
        scale = max(scale, path.feed_rate * path.exchange.period)
    k = int(np.argmax(correction))
    share, warn, stop = float(correction[k]) / scale, path.exchange.warn_correction, path.exchange.stop_correction
    above = f": above {100 * warn:g} %, use a shorter {period}" if share > warn else ""
    text = f"exchange: largest correction of a predicted pose is {100 * share:.1f} % of the {name}{above}"
    tolerance = min(filter(None, tolerances.of()), default=0.0)
    if share <= stop or correction[k] <= negligible * tolerance:
        return share, text, []
    point = int(np.searchsorted(ran.reference.time_ns, ran.result.time_ns[min(k, len(ran.result.time_ns) - 1)])) + 1
    return share, text, [violation("exchange", share, stop, point, scale=name)]


RAPID_MOVES = "removed by rapid moves"


@dataclass(frozen=True, eq=False)
class Checked:
    """The findings, the worst first."""

    findings: tuple[Finding, ...] = column("findings")
    points: int = column("points")
    program: SourceProgram = column("")  #: contents of the file of the path beside its moves
    ran: ScoredPass | None = column("", default=None)  #: the simulated pass; None: the arm cannot make it
    #: programmed path; None: the arm cannot follow it
    stability: Stability | None = column("stability", default=None)
    residue: Residue | None = column("simulated_pass", default=None)
    #: each rapid move through material; None: the arm cannot make the path
    rapid_moves: tuple[Finding, ...] | None = column("rapid_moves", default=None)
    exchange: tuple[float, str] | None = None  #: largest correction of a predicted pose as a share, and its line
    #: each reversal, with its jump; None: no pass was simulated
    load_reversals: tuple[Finding, ...] | None = column("load_reversals", default=None)
    #: robot program; None: the arm cannot make the path, or no program holds it
    blocks: ProgramBlocks | None = column("program", default=None)
    tolerance: Judgement | None = column("", default=None)  #: errors of the part; None: ``check`` simulated no pass

    def __repr__(self) -> str:
        return f"<Checked: {self.summary}>"

    @computed("may_be_run")
    def may_be_run(self) -> bool:
        """Return whether there is no stop."""
        return not self.count("stop")

    @computed("*")
    def _counts(self) -> dict[str, int]:
        return {f"{severity}s": self.count(severity) for severity in SEVERITIES}

    @computed("largest_pose_correction_share")
    def _share(self) -> float | None:
        return self.exchange[0] if self.exchange else None

    @computed("read_over")
    def _words(self) -> list[dict]:
        return [{"word": word, "count": count} for word, count in self.program.read_over]

    def count(self, severity: str) -> int:
        """Findings of that severity, like ones counted once."""
        return sum(f.severity == severity for f in self.findings)

    @property
    def summary(self) -> str:
        """Return points, counts, and the statement about the run, in one line."""
        verdict = "may be run, after a test in T1" if self.may_be_run else "must not be run"
        return f"{self.counts}: the path {verdict}"

    @property
    def counts(self) -> str:
        """Points, stops and warnings."""
        return f"{self.points} points, " + ", ".join(counted(self.count(s), s) for s in ("stop", "warning"))

    def lines(self, short: bool = False) -> list[str]:
        """Return a line for each finding, then the summary; short: stops, warnings, stability and the summary."""
        if not short:
            return [*self.findings_lines(), self.summary]
        serious = [f"{f.severity:8} {f.text}" for f in self.findings if f.severity != "note"]
        return [*serious, *([self.stability.text] if self.stability else []), self.summary]

    def findings_lines(self) -> list[str]:
        """Return a line for each finding, and those about the whole path."""
        findings = (f"{f.severity:8} {f.text}" for f in self.findings)
        statements = [part.text if part else "" for part in (self.stability, self.residue, self.blocks)]
        statements.insert(2, self.exchange[1] if self.exchange else "")
        return [*filter(None, (self.program.summary, *findings, self.rapid_text, *statements))]

    @computed("removed_by_rapid_moves_mm3")
    def rapid_volume_mm3(self) -> float | None:
        """Return the volume that rapid moves remove; None where the arm cannot make the path."""
        return None if self.rapid_moves is None else sum((f.amounts["volume_mm3"] for f in self.rapid_moves), 0.0)

    @property
    def rapid_text(self) -> str:
        """Return the volume, and the lines of the program that remove it, in one line."""
        most_lines = 10  # lines of the program in the text about rapid moves
        if self.rapid_moves is None:
            return f"{RAPID_MOVES}: not known, the arm cannot make the path"
        lines = list(dict.fromkeys(str(f.where.line) for f in self.rapid_moves if f.where.line))
        more = f" and {len(lines) - most_lines} more" if len(lines) > most_lines else ""
        where = f" (line{'s' * (len(lines) > 1)} {', '.join(lines[:most_lines])}{more})" if lines else ""
        return f"{RAPID_MOVES}: {self.rapid_volume_mm3:.4g} mm3{where}"


def check(
    cell: Cell,
    reference: Trajectory | None = None,
    motion: str | None = None,
    ran: ScoredPass | None = None,
    progress: Callable = lambda *_: contextlib.nullcontext(),
    more: Iterable[Finding] = (),
) -> Checked:
    """Check the cell's own path, or a corrected one; motion: LIN or SPLINE.

    Default: LIN for a correction in straight lines of a smooth path, as compensate writes it, else that of ``program``.

    ran: the pass along it, if it was simulated already; more: violations that are known already. progress(name): a
    context that yields a function for the progress of a step. Where the arm cannot make the path, nothing is simulated.
    Raises InputError for a path that cannot be read or misses the stock, and for a reference of another path.
    """
    arm_errors = DeflectionError, UnstableLoadError, EquilibriumError  # an arm that cannot bear its load
    fed = path_of(cell).fed
    programmed = path_of(cell).target if fed is None else fed.trajectory
    run = programmed if reference is None else reference
    arm, path = arm_of(cell), path_of(cell)
    results, joints = reach_violations(arm, run)
    about: dict[str, Any] = {}  # what follows where the arm can make the path
    reachable = joints is not None and not results
    if joints is not None and not reachable:
        results += motion_violations(arm.arm, cell.limits, run, joints)
    if reachable and reference is None:
        run = path.target  # slowed down to what the joints can do
    del joints  # ``_of_program`` frees them
    results += [*input_violations(cell), *more]
    if reachable:
        planned = fed.trajectory if fed else path.target
        if path.target.duration_ns > 1.1 * planned.duration_ns:  # less shows in no chip
            results.append(violation("slowed", 1e-9 * path.target.duration_ns, 1e-9 * planned.duration_ns))
        straight = run.velocity is None and path.target.velocity is not None
        robot_program = cell.krl.replace(motion=motion or ("LIN" if straight else cell.krl.motion))
        results += _correction(cell, path.target, run, robot_program)
        periods = path.clock.steps(run.duration_ns)
        every = ran.result.every if ran else max(1, math.ceil(periods / MOST_ROWS))
        with ThreadPoolExecutor(max(1, cores() - 1)) as pool:  # beside the pass, which has a core for itself
            contacts = pool.submit(path_contacts, cell, run)
            motion_of_arm = pool.submit(motion_violations, arm.arm, cell.limits, run, arm.joints(run))
            rigid = pool.submit(rigid_workpiece, cell, every) if not path.straight else None
            size, statement = pool.submit(_of_program, cell, run, robot_program), pool.submit(stability_statement, cell)
            links = pool.submit(link_contacts, arm, cell.tool.stick_out, cell.workpiece, cell.stock, run)
            ran, cut, about["tolerance"] = _cut(cell, run, ran, contacts, rigid, progress)
            about["ran"], (about["blocks"], ends) = ran, size.result()
            results = [*motion_of_arm.result(), *results, *links.result(), *cut, *ends]
            if robot_program.motion == "LIN" and not robot_program.blend_distance and about["blocks"]:
                results.append(violation("no blending", about["blocks"].points, int(path.target.standing.sum())))
            about["rapid_moves"] = tuple(placed(path, run, f) for f in cut if f.what == "rapid in material")
            with contextlib.suppress(*arm_errors), progress("stability"):  # the pass reports the same error
                about["stability"] = statement.result()
                results += chatter_violations(about["stability"], run.time)
        if ran:
            shown, more_findings = _of_pass(cell, run, ran, about.get("stability"))
            results += more_findings
            about |= shown
    program = fed.toolpath.program if fed else SourceProgram()
    return Checked(gathered(path, run, results), len(run), program, **about)


def _of_program(cell: Cell, run: Trajectory, robot_program: Program) -> tuple[ProgramBlocks | None, list[Finding]]:
    """Return the size of the blocks of the program as ``compensate`` writes it, None where no program holds it.

    With the findings about approach and retract of its parts.
    """
    layout, parts = None, [(0, len(run) - 1)]
    with contextlib.suppress(TrajectoryError):
        _, layout, parts, _ = drafted(cell, run, robot_program.motion)
    ends = end_violations(cell, run, parts)
    joints_at_knots.cache_clear()  # of a long program they take 100 MB
    return program_blocks(robot_program, path_of(cell).target, run, *layout) if layout else None, ends


def end_violations(cell: Cell, run: Trajectory, parts: Sequence[tuple[int, int]]) -> list[Finding]:
    """The findings about approach and retract of a robot program along a trajectory that the arm can follow.

    parts: first and last knot of each part of the program, which have these moves each.
    """
    arm, safe, spacing = arm_of(cell), float(cell.stock.max[2]) + cell.krl.safe_height, 5e-3  # [m]
    joints, findings = arm.joints(run), []
    for knot, name in [*((first, "approach") for first, _ in parts), *((last, "retract") for _, last in parts)]:
        place, axis = run.position[knot], tool_axis(run.quaternion[knot])
        rise = float(np.linalg.norm(lifted(place, axis, safe) - place))
        if rise < 1e-6:
            continue
        way = np.linspace(0.0, rise, 3 + math.ceil(rise / spacing))[1:]
        time_ns = np.rint(1e9 * (way - way[0]) / max(cell.krl.approach_feed, 1e-3)).astype(np.int64)
        lift = Trajectory(time_ns, place + way[:, None] * axis, np.tile(run.quaternion[knot], (len(way), 1)))
        there = dataclasses.replace(arm, near=tuple(joints[knot]))
        results, reached = arm_violations(there, cell.limits, lift)
        if reached is not None and not any(finding.what == "joint limit" for finding in results):
            results += link_contacts(there, cell.tool.stick_out, cell.workpiece, cell.stock, lift)
        for finding in results:
            words = re.sub(r" (at|between|\() ?points? [\d toand]*\d\)?", "", finding.sentence)
            where = dataclasses.replace(finding.where, point=knot + 1)
            sentence = f"{name} of the robot program: {words}"
            findings.append(dataclasses.replace(finding, sentence=sentence, where=where))
    return findings


def _of_pass(
    cell: Cell, run: Trajectory, ran: ScoredPass, stability: Stability | None
) -> tuple[dict[str, Any], list[Finding]]:
    """Return reversals of the load, exchange and vibration of a simulated pass, as fields of ``Checked``; findings."""
    path = path_of(cell)
    jumps = load_reversals(arm_of(cell), path, run, ran)
    share, text, findings = exchange_share(path, ran, cell.tolerances)
    residue = residue_of(cell, ran.result)
    if residue.word == "grows":
        if stability and stability.word_at(path, residue.time) == "stable":
            residue = dataclasses.replace(residue, word="remains")
        point = int(np.clip(np.searchsorted(run.time, residue.time), 0, len(run) - 1)) + 1
        kind = "growing vibration" if residue.word == "grows" else "remaining vibration"
        findings.append(violation(kind, residue.residue, residue.limit, point, percent=100 * residue.residue))
    reversals = tuple(placed(path, run, jump) for jump in jumps)
    return {"load_reversals": reversals, "exchange": (share, text), "residue": residue}, [*jumps, *findings]


def _cut(
    cell: Cell,
    run: Trajectory,
    ran: ScoredPass | None,
    contacts: Future[Contacts],
    rigid: Future[CutModel] | None,
    progress: Callable,
) -> tuple[ScoredPass | None, list[Finding], Judgement | None]:
    """The pass along ``run``, simulated and judged where it was not yet, and what it shows."""
    try:
        if ran is None:
            with progress("milling") as report:
                ran = simulate(cell, run, "checked", report, most_rows=MOST_ROWS, quick=True)
    except PassError as error:
        point = int(np.searchsorted(run.time, error.at)) + 1
        failed = violation("deflection", error.deflection, FLIGHT, point, sentence=str(error))
    except DeflectionError as error:
        failed = violation("joint deflection", error.deflection, error.limit, sentence=str(error))
    except (UnstableLoadError, EquilibriumError) as error:
        failed = violation("load on the arm", error.load_factor, 1.0, sentence=str(error))
    else:
        with progress("stock and fixtures"):
            cut = cut_violations(cell, run, ran, contacts.result())
            return ran, cut, judge(cell, ran, assess(cell, ran, cut=rigid.result()) if rigid else None)
    return None, [failed, *(finding for part in contacts.result() for finding in part)], None


def _correction(cell: Cell, target: Trajectory, run: Trajectory, robot_program: Program) -> list[Finding]:
    if not np.array_equal(target.time_ns, run.time_ns):
        raise InputError("reference", f"its times are not those of the {len(target)} points of this cell's path")
    if run is target:
        return []
    settings = cell.compensation
    results = correction_size(target, run, settings.tick_ns, settings.max_correction)
    results += correction_per_tick(target, run, settings.tick_ns, settings.max_change_per_tick)
    if robot_program.motion == "LIN":
        fixed = fixed_knots(target.standing, knot_feeds(path_of(cell), len(target)))
        points = program_points(robot_program, target, run, fixed)
        results += corner_blending(target, run, robot_program.blend_distance, cell.limits.blending_share, *points)
    return results
