"""The decision on a compensated path, made once: terminal, JSON, report, manifest and programs print this object.

Its advice: which uncertainty limits the part, and which measurement would take it away. One unknown at a time is drawn,
all others are known, and the robot runs the corrected program. D_k is the deviation that makes walls and floors while
the tool cuts. The share of unknown k in the band is

    s_k = var D_k / sum_j var D_j   first-order shares of independent unknowns [Sobol1993]

The mean of D_k is no spread: ``robust`` plans for it, and an identified unknown has a narrow range and no share.

A robot whose unknown k is measured keeps the share 1 - s_k of the square of its error.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri

from kr270_milling.base.column import as_dict, column, computed
from kr270_milling.base.errors import MillingError
from kr270_milling.cell.cell import Cell
from kr270_milling.cell.jobs import at_once
from kr270_milling.cell.models import path_of
from kr270_milling.cell.plant import Plant, coarser, numbers_of, robot_of
from kr270_milling.decide.check import Checked
from kr270_milling.decide.part.assessment import Judgement, um_text
from kr270_milling.decide.part.surface import SLOPE
from kr270_milling.decide.verdict import NO_METHOD, MethodComparison, Verdict
from kr270_milling.path.trajectory import Trajectory
from kr270_milling.physics.compensation.methods import LEARNED
from kr270_milling.physics.motion.imperfections import Imperfections
from kr270_milling.physics.motion.milling_pass import PassResult

SHOWN = 3  #: unknowns in a line
#: name of each unknown: its keys of ``uncertainty``, and the measurement with its instrument and minutes (assumed)
UNKNOWNS: dict[str, tuple[tuple[str, ...], str]] = {
    "servo lag": (("servo_frequency", "servo_delay"), "a test move with a tracker (identify servo), 20 min"),
    "base": (("base_compliance",), "3 load tests with a dial gauge (identify compliance --base), 30 min"),
    "backlash": (
        ("backlash", "least_backlash"),
        "push and pull at the tool with a dial gauge (identify backlash), 30 min",
    ),
    "joint compliance": (("joint_compliance", "joint_compliances"), "12 load tests with a tracker, 90 min"),
    "force coefficients": (("force_coefficient", "force_coefficients"), "5 slots with a force sensor, 60 min"),
    "end edges": (("end_share",), "a plunge with a force sensor, 15 min"),
    "tool wear": (("tool_wear",), "a fresh tool, 5 min"),
    "tool": (("tool_stick_out", "tool_compliance"), "a load at the tool with a dial gauge, 15 min"),
    "frequency": (("frequency",), "a hammer test with an accelerometer, 30 min"),
    "damping": (("damping_ratio",), "a hammer test with an accelerometer, 30 min"),
    "joining": (("joining",), "a test move with a tracker, 20 min"),
    "place of the part": (("placement",), "touching off again with a probe, 10 min"),
}


@dataclass(frozen=True)
class Limit:
    """One unknown."""

    name: str = column("unknown")
    share: float = column("share")  #: of the band
    measurement: str = column("measurement")

    def within(self, shares: np.ndarray) -> int:
        """Robots within tolerance if this is measured; shares: errors of the robots as shares of the tolerance."""
        return int(np.sum(shares * np.sqrt(1.0 - self.share) <= 1.0))


def limits(
    cell: Cell, reference: Trajectory, count: int, progress: Callable[[int, int], object] | None = None
) -> tuple[Limit, ...]:
    """The unknowns of a cell along the reference of a program, the largest share first.

    count: robots for each unknown, at least two; progress(done, all): called after each robot.
    """
    model, assumed = coarser(cell), cell.uncertainty
    if assumed.learned.size:  # a measured part ties the unknowns to each other
        return ()
    ran = Plant(model, model, Imperfections()).run(reference)
    scored = _across(model, ran), np.any(ran.wrench != 0.0, axis=1)
    values = {key: getattr(assumed, key) for keys, _ in UNKNOWNS.values() for key in keys}
    nothing = {key: np.array([]) if isinstance(value, np.ndarray) else 0.0 for key, value in values.items()}
    known = assumed.replace(repeatability=0.0, **nothing)
    drawn = []
    for name, (keys, _) in UNKNOWNS.items():
        left = {key: values[key] for key in keys}
        if any(np.any(value) for value in left.values()):
            other = model.replace(uncertainty=known.replace(**left))
            drawn += [(name, robot_of(other, row)) for row in _hypercube(count, numbers_of(other))]
    ran_rows = []
    with ThreadPoolExecutor(at_once(path_of(model))) as pool:
        for row in pool.map(lambda one: _deviation(model, one[1], reference, scored), drawn):
            ran_rows.append(row)
            if progress:
                progress(len(ran_rows), len(drawn))
    size = {}
    for name in dict.fromkeys(name for name, _ in drawn):
        some = [row for (other, _), row in zip(drawn, ran_rows, strict=True) if other == name and row is not None]
        size[name] = float(np.mean(np.var(some, axis=0))) if len(some) > 1 else 0.0
    total = sum(size.values())
    rows = (Limit(name, value / total, UNKNOWNS[name][1]) for name, value in size.items() if total > 0.0)
    return tuple(sorted(rows, key=lambda row: -row.share))


def _hypercube(count: int, numbers: int) -> np.ndarray:
    """Numbers behind robots that cover each number evenly, (count, numbers): a Latin hypercube [McKay1979].

    Each number takes the middles of equally probable ranges, scaled to a variance of 1, in a random order that is
    hardly correlated with those of the six numbers before it: the numbers of an unknown are neighbours. So few robots
    know a variance that as many drawn ones know to a half.
    """
    # the seed of these robots is beyond those of verdicts and of ``robust``
    rng, levels = np.random.default_rng(1_000_001), ndtri((np.arange(count) + 0.5) / count)
    columns, orders, near = [levels / levels.std()], 100, 6
    while len(columns) < numbers:
        tried = rng.permuted(np.tile(columns[0], (orders, 1)), axis=1)
        columns.append(tried[np.argmin(np.square(tried @ np.transpose(columns[-near:])).sum(axis=1))])
    return np.column_stack(columns)


def _across(model: Cell, ran: PassResult) -> np.ndarray:
    """Weights (n, 2, 3) of the deviation that makes walls and floors, at the samples of a pass."""
    feed = path_of(model).target.sample_velocity(ran.time_ns)
    level = np.abs(feed[:, 2]) <= SLOPE * np.linalg.norm(feed, axis=1)
    weights = np.zeros((len(feed), 2, 3))
    weights[:, 0, :2] = np.column_stack([-feed[:, 1], feed[:, 0]])
    weights[:, 0] /= np.maximum(np.linalg.norm(feed[:, :2], axis=1), 1e-300)[:, None]
    weights[:, 1, 2] = level
    return weights


def _deviation(model: Cell, robot: Cell, reference: Trajectory, scored: tuple[np.ndarray, np.ndarray]):
    """Deviation [m] that makes walls and floors where the tool cuts, (k, 2); None where the robot fails.

    scored: weights of ``_across`` and the samples that cut, of the pass of the model.
    """
    weights, cutting = scored
    try:
        actual = Plant(model, robot).run(reference).actual
    except MillingError:
        return None
    return np.einsum("nij,nj->ni", weights[cutting], actual[cutting])


def measurements(rows: tuple[Limit, ...], shares: np.ndarray | None) -> list[str]:
    """Lines: what to measure, and how many more of the robots would meet the tolerance then; the best first.

    shares: errors of the simulated robots as shares of the tolerance, (n,); None: no tolerance is given.
    """
    if shares is None:
        return [f"measure: {row.name}, {row.measurement}" for row in rows[:SHOWN]]
    now = int(np.sum(shares <= 1.0))
    best = sorted(rows[:SHOWN], key=lambda row: -row.within(shares))
    return [
        f"measure: {row.name}, {row.measurement}: from {now} to about {row.within(shares)} of {shares.size} robots"
        for row in best
        if row.within(shares) > now
    ] or ["no measurement of one unknown alone brings more robots within the tolerance"]


YES, CAUTION, NO = "yes", "caution", "no"
ENOUGH, HALF = 0.9, 0.5  #: shares of the robots that must meet the tolerance for ``yes`` and for ``caution``


@dataclass(frozen=True)
class Decision:
    """Whether a compensated path is to be run.

    ``yes``: no stop, and at least 90 % of the robots meet the tolerance. ``no``: a stop, or the model or more than half
    of the robots miss the tolerance. ``caution``: everything else, also where the tolerance or the verdict is missing.
    """

    as_programmed: Judgement = column("as_programmed")
    compensated: Judgement = column("compensated")
    method: str = column("method")  #: that was run and is written; "none": the path as programmed
    stops: tuple[str, ...] = ()  #: sentences of the findings that forbid to run the path
    verdict: Verdict | None = None  #: of plants that are not the model; None: not run
    #: where the method was chosen by ``best``
    comparison: MethodComparison | None = column("comparison", default=None)
    notes: tuple[str, ...] = column("notes", default=())  #: what a user of the method must know
    backlash: str = column("backlash", default="")  #: whether the figures include the backlash of the joints
    limits: tuple[Limit, ...] = ()  #: the unknowns by their share of the band; empty: not known or not needed

    @computed("may_be_run")
    def may_be_run(self) -> bool:
        """Return whether no finding forbids it."""
        return not self.stops

    @computed("decision")
    def level(self) -> str:
        """``yes``, ``caution`` or ``no``."""
        if self.stops or self.compensated.passes is False:
            return NO
        if self.verdict is None or self.verdict.within is None or self.compensated.passes is None:
            return CAUTION
        share = self.verdict.within / len(self.verdict.compensated)
        return YES if share >= ENOUGH else CAUTION if share >= HALF else NO

    @property
    def exit_code(self) -> int:
        """0, or 1 for ``no``."""
        return int(self.level == NO)

    @computed("recommended_method")
    def recommended_method(self) -> str | None:
        """The method that a comparison recommends; None without a comparison."""
        if self.comparison:
            return self.comparison.best
        return self.verdict.compared if self.verdict else None

    @computed("quantity")
    def _quantity(self) -> str:
        return self.compensated.quantity

    @computed("limits")
    def _limits(self) -> list[dict]:
        shares = self.verdict.shares if self.verdict else None
        return [as_dict(row) | {"within": None if shares is None else row.within(shares)} for row in self.limits]

    @computed("sentence")
    def sentence(self) -> str:
        """Why, and what is missing."""
        model = self.compensated.sentence("on the model")
        if self.stops:
            more = f", and {len(self.stops) - 1} more" if len(self.stops) > 1 else ""
            return f"the path must not be run: {self.stops[0]}{more}; {model}"
        if math.isnan(self.compensated.error):
            return model
        parts = [model + self._plants]
        if self.compensated.passes is None:
            parts.append("no tolerance is given: set part.tolerance_um")
        if self.verdict is None:
            parts.append("no verdict of simulated robots: kr270_milling compensate --verdict 32 runs them")
        elif self.limits:
            parts += measurements(self.limits, self.verdict.shares)[:1]
        return "; ".join(parts)

    @property
    def _plants(self) -> str:
        """The plants, in the same quantity."""
        if self.verdict is None:
            return ""
        count, median = len(self.verdict.compensated), f"median {um_text(self.verdict.band('compensated')[1])}"
        if self.verdict.within is None:
            return f", {median} in {count} simulated robots"
        within = self.verdict.within
        return f" and in {within} of {count} simulated robots ({100 * within / count:.0f} %, {median})"

    @property
    def text(self) -> str:
        """One line: level and sentence."""
        return f"decision: {self.level}: {self.sentence}"

    @property
    def method_text(self) -> str:
        """One line: the method that is written, and the one that a comparison recommends."""
        if self.comparison:
            return f"recommended method: {self.comparison.sentence}"
        if self.method == NO_METHOD and math.isnan(self.compensated.error):
            return f"method: {NO_METHOD}, the tool only drills"
        chosen = f"method: {self.method}, as set"
        return f"{chosen}; recommended method: {self.recommended_method}" if self.recommended_method else chosen

    @property
    def headline(self) -> str:
        """One line with both passes."""
        backlash = f"; {self.backlash}" if self.backlash else ""
        return f"{self.text}{backlash}; as programmed: {self.as_programmed.words}; {self.method_text}"

    def lines(self) -> list[str]:
        """The lines that terminal, manifest and programs print."""
        more = [self.backlash] if self.backlash else []
        if self.limits and self.verdict:
            largest = ", ".join(f"{row.name} ({100 * row.share:.0f} %)" for row in self.limits[:SHOWN])
            more += [f"limits: {largest}", *measurements(self.limits, self.verdict.shares)[1:]]
        return [self.text, *more, f"as programmed: {self.as_programmed.words}", self.method_text, *self.notes]


def decided(
    before: Judgement, after: Judgement, method: str, checked: Checked, verdict: Verdict | None = None,
    comparison: MethodComparison | None = None, backlash: str = "", limits: tuple[Limit, ...] = (),
) -> Decision:  # fmt: skip
    """The decision on a pass as programmed and one along the reference of a method.

    checked: findings of the path of the second one; backlash: whether the figures include it.
    """
    needs_tracker = "learned needs a tracker on the real machine: here it learned from simulated passes"
    stops = tuple(finding.sentence for finding in checked.findings if finding.severity == "stop")
    notes = [needs_tracker] if method == LEARNED.name else []
    if after.error > before.error:
        errors = f"{um_text(after.error)} against {um_text(before.error)}"
        notes.append(f"{method} makes the part worse than no compensation ({errors})")
    return Decision(before, after, method, stops, verdict, comparison, tuple(notes), backlash, limits)
