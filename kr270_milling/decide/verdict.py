"""Does the compensation help when the plant is not the model? A Monte Carlo answer in one word and its bands."""

from __future__ import annotations

import contextlib
import dataclasses
import math
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np

from kr270_milling.base.blocks import return_memory
from kr270_milling.base.column import column, computed
from kr270_milling.base.errors import MillingError, ParameterError
from kr270_milling.cell.cell import Cell
from kr270_milling.cell.jobs import (
    ScoredPass,
    at_once,
    compensated,
    compensator,
    expected_deviations,
    long_pass,
    record_of,
    simulate,
)
from kr270_milling.cell.models import arm_model_of, cut_of, flat_floors, path_of
from kr270_milling.cell.plant import DIVERGED, Plant, coarser, cores, imperfect_arm, imperfect_course, perturbed
from kr270_milling.decide.part.assessment import (
    NORMAL_ERROR,
    PATH_DEVIATION,
    SURFACE_ERROR,
    Gauge,
    Judgement,
    gauge_of,
)
from kr270_milling.path.trajectory import Trajectory
from kr270_milling.physics.compensation.methods import LEARNED, methods
from kr270_milling.physics.motion.dynamics import ArmModel
from kr270_milling.physics.motion.milling_pass import PassResult, run_pass
from kr270_milling.physics.motion.scores import path_deviation

Row = TypeVar("Row")
Judging = Callable[[PassResult], Judgement]  #: a gauge, or a function that watches the passes, too

HELPS, INDIFFERENT, UNTRUSTED = "helps", "does not matter", "cannot be trusted here"
LEVELS = (0.05, 0.5, 0.95)
SAMPLES = 32
FEWEST = 8
SAME = 0.1  #: changes of the largest deviation by less than this share are none
SURE = 0.9  #: confidence with which more than this share do: 2 of 10, 3 of 20, 4 of 32 robots, and never 1 of 3 or more
TRACKED = f"{LEARNED.name}, with a tracker"  #: passes of the plant itself are measured and learned from
CHOOSING_SEED = 1_000_003  #: of the robots that compare programs, which neither a verdict nor ``robust`` draws
CHECKED = 2  #: robots whose quick passes are compared with full ones
NEAR = 0.1  #: assumed: difference of both, as a share of the tolerance or of what 95 % of the robots stay below
NO_METHOD = "none"  #: run the path as it was programmed


@dataclass(frozen=True, eq=False)
class Verdict:
    """The answer of the plants. Errors are the tolerance quantity [m], one a plant; NaN: the plant failed."""

    word: str = column("verdict")  #: "helps", "does not matter" or "cannot be trusted here"
    reason: str = column("reason")
    original: np.ndarray = column("")  #: (n,)
    compensated: np.ndarray = column("")  #: (n,)
    seed: int | None = column("seed")
    methods: dict[str, np.ndarray] = field(default_factory=dict)  #: errors by method, (n,)
    quantity: str = column("quantity", default=PATH_DEVIATION)  #: name of the errors
    shares: np.ndarray | None = None  #: errors of the compensated plants as shares of the tolerance, (n,); None: no
    #: tolerance is given
    #: [m], largest difference of quick and full passes of ``CHECKED`` robots; None: all passes are full
    shortcut: float | None = column("quick_passes_differ_um", 1e6, default=None)

    def __repr__(self) -> str:
        return f"<Verdict: {self.text}>"

    @property
    def recommended(self) -> str:
        """The method, planned on the model, that is no risk and leaves the least deviation to 95 % of the plants.

        "none" where no method makes the part better by 10 %. All robots of a method show whether it is a risk.
        """
        planned = {name: rows for name, rows in self.methods.items() if name != TRACKED}
        count = min(map(len, planned.values()), default=0)  # robots that run all of them
        before = self.original[:count]
        sound = {NO_METHOD: _high(before) * (1.0 - SAME)}
        for name, rows in planned.items():
            if judge_plants(self.original[: len(rows)], rows, 0.0)[0] != UNTRUSTED:
                sound[name] = _high(rows[:count])
        return min(sound, key=sound.__getitem__)

    @property
    def text(self) -> str:
        """The word with the band of what the compensation leaves."""
        low, middle, high = (1e6 * value for value in self.band("compensated"))
        quick = "" if self.shortcut is None else f"; quick passes, within {1e6 * self.shortcut:.2g} um of full ones"
        return f"{self.word} ({len(self.original)} robots: {middle:.3g} um, 5 to 95 % {low:.3g} to {high:.3g}{quick})"

    @computed("within_tolerance")
    def within(self) -> int | None:
        """Plants that meet the tolerance on the compensated trajectory; None without a tolerance."""
        return None if self.shares is None else int(np.sum(self.shares <= 1.0))

    def band(self, which: str) -> tuple[float, ...]:
        """5, 50 and 95 % of the error [m]; which: "original" or "compensated"."""
        return _band(getattr(self, which))

    @computed("*")
    def _counts(self) -> dict:
        return {"samples": len(self.original), "failed": int(np.isnan(self.compensated).sum())}

    @computed("recommended_method")
    def compared(self) -> str | None:
        """The recommended method; None where there is only one."""
        return self.recommended if len(self.methods) > 1 else None

    @computed("*", 1e6)
    def _bands(self) -> dict:
        bands = {name: _band(rows) for name, rows in {NO_METHOD: self.original, **self.methods}.items()}
        return {"methods_um": bands, "original_um": self.band("original"), "compensated_um": self.band("compensated")}


def _band(rows: np.ndarray) -> tuple[float, ...]:
    """5, 50 and 95 % of rows (n,), NaN left out."""
    known = rows[np.isfinite(rows)]
    return tuple(np.quantile(known, LEVELS).tolist()) if known.size else (np.nan,) * 3


def _high(rows: np.ndarray) -> float:
    """What 95 % of the plants stay below [m]; one that failed counts as far off."""
    return float(np.quantile(np.nan_to_num(rows, nan=1.0), 0.95))


@dataclass(frozen=True)
class MethodComparison:
    """The methods compared by the linear response of drawn plants, and the method that is best."""

    best: str = column("best")
    sentence: str = column("reason")
    #: path deviation [m] that 95 % of the plants stay below, by method
    deviations: dict[str, float] = column("path_deviation_um", 1e6)


def compare_methods(cell: Cell, original: ScoredPass) -> MethodComparison:
    """Choose the method for ``compensation.method: best``, in seconds: no further pass is run.

    With a tracker the method is ``LEARNED``: it begins as ``inverse``, measures its passes, and keeps the best of them.
    """
    if cell.compensation.tracker:
        why = f"{LEARNED.name}, because compensation.tracker is true: a tracker measures each pass, the best is used"
        return MethodComparison(LEARNED.name, why, {})
    references = _references(cell, original)
    deviations = _expected(cell, {NO_METHOD: path_of(cell).target, **references})
    none = deviations[NO_METHOD]
    best = min(references, key=deviations.__getitem__, default=NO_METHOD)
    if best != NO_METHOD and deviations[best] > (1.0 - SAME) * none:
        best = NO_METHOD
    listed = ", ".join(f"{name} {1e6 * value:.3g}" for name, value in deviations.items() if name != best)
    why = (
        f"{best}, because 95 % of {FEWEST} simulated robots then have a path deviation of at most "
        f"{1e6 * deviations[best]:.3g} um by linear response ({listed})"
    )
    return MethodComparison(best, why, deviations)


def alternatives(cell: Cell, original: ScoredPass, method: str) -> dict[str, Trajectory]:
    """References of the other methods, planned on the same pass.

    Of a tool path, where each takes long: only the method that the linear model expects to leave the least on 8 plants.
    """
    references = _references(cell, original, method)
    if path_of(cell).straight or not references:
        return references
    deviations = _expected(cell, references)
    best = min(deviations, key=deviations.__getitem__)
    return {best: references[best]}


def _references(cell: Cell, original: ScoredPass, without: str = "") -> dict[str, Trajectory]:
    """References of the recommended methods. A method that repeats takes passes of the plant itself: it is left out."""
    references, by = {}, compensator(cell, path_of(cell).target)
    by.first = record_of(cell, original)
    for name, method in methods().items():
        if name != without and not method.repeats and getattr(method, "recommended", True):
            with contextlib.suppress(MillingError):
                references[name] = by.choose(name)
    return references


def _expected(cell: Cell, references: dict[str, Trajectory]) -> dict[str, float]:
    """Path deviation [m] that 95 % of ``FEWEST`` plants stay below, by the linear response of each plant."""
    quick, rng = coarser(cell), np.random.default_rng(0)
    plants = [perturbed(quick, rng) for _ in range(FEWEST)]
    with ThreadPoolExecutor(cores()) as pool:
        rows = np.array(list(pool.map(lambda plant: expected_deviations(plant, list(references.values())), plants)))
    return dict(zip(references, np.quantile(rows, 0.95, axis=0).tolist(), strict=True))


def each_robot(
    nominal: Cell, robots: int, seed: int, job: Callable[[int, Cell], Row], count: Callable[[int], object]
) -> list[Row]:
    """Draw robots and return the result of a job for each, in the order of drawing; count(done): after each robot."""
    rng, rows = np.random.default_rng(seed), []
    return_memory()
    drawn, threads = [perturbed(nominal, rng) for _ in range(robots)], at_once(path_of(nominal))
    pool = ThreadPoolExecutor(threads)
    try:  # one after the other in this thread, which uses the memory again that earlier passes gave back
        for row in (map if threads == 1 else pool.map)(job, range(robots), drawn):
            rows.append(row)
            count(len(rows))
    finally:  # after an interrupt only the robots that run are waited for
        pool.shutdown(cancel_futures=True)
    return rows


def errors_as_programmed(
    cell: Cell, robots: int, seed: int, part: Future[tuple], pool: Executor
) -> tuple[Cell, Future[Gauge], list[Future[tuple[float, float]]]]:
    """Begin with the robots of ``monte_carlo`` along the programmed path, beside other work.

    Return the cell from which they are drawn, its gauge, and for each robot error [m] and share of the tolerance. part:
    of ``rigid_part``.
    """
    nominal, target, rng = coarser(cell), path_of(cell).target, np.random.default_rng(seed)

    def judging() -> Gauge:
        gauge, cut, _ = part.result()
        alike = nominal.stock is cell.stock and long_pass(path_of(cell))  # errors differ by 0.4 um
        return gauge if nominal is cell else gauge_of(nominal, cut if alike else None)

    def errors(plant: Cell) -> tuple[float, float]:
        model = arm_model_of(plant, target)
        return _errors(plant, model, target, target, 0, gauge.result(), nominal is not cell)

    gauge = pool.submit(judging)
    return nominal, gauge, [pool.submit(errors, perturbed(nominal, rng)) for _ in range(robots)]


def _tracked(cell: Cell, plant: Cell, gauge: Gauge) -> float:
    """The error [m] of a plant whose own passes are measured and learned from; NaN where that fails."""
    try:
        cuts = Plant(cell, plant)
        learned = compensated(cell, simulate(cell, plant=cuts), LEARNED, plant=cuts)
        return gauge(learned.result).error
    except MillingError:
        return np.nan


def monte_carlo(
    cell: Cell,
    revised: Trajectory,
    samples: int = SAMPLES,
    seed: int = 1,
    *,
    progress: Callable[[int, int], None] | None = None,
    method: str = "compensated",
    others: dict[str, Trajectory] | None = None,
    gauge: Gauge | None = None,
    started: tuple[Cell, Future[Gauge], list[Future]] | None = None,
) -> Verdict:
    """Run ``samples`` plants drawn from ``cell.uncertainty`` along the cell's target and along the revised trajectory.

    progress(done, total): in plants, where a plant that learns counts more.
    method: the name of the revised trajectory; others: trajectories of other methods, to recommend one: the first 8
    plants run them, of a straight cut all, whose first 8 also learn from their own passes. The numbers do not depend on
    the number of threads. Along a tool path the passes are quick (``coarser``). Where the errors of ``CHECKED`` robots
    differ from those of full passes by more than ``NEAR``, all passes are full. started: of ``errors_as_programmed``.
    """
    if not (hasattr(samples, "__index__") and samples >= 1):
        raise ParameterError("samples", samples, "a whole number of at least 1")
    target, straight = path_of(cell).target, path_of(cell).straight
    references, full_gauge = {method: revised, **(others or {})}, gauge or gauge_of(cell)
    learning = FEWEST if others and straight else 0  # plants that also learn
    comparing = samples if straight else FEWEST  # plants that also run the other methods

    def work(number: int) -> int:
        # time of the learning of a plant, as a multiple of that of its other passes
        return number + 8 * min(number, learning)

    def count(done: int) -> None:
        if progress:
            progress(work(done), work(samples))

    def drawn(nominal: Cell) -> list[tuple[np.ndarray, float | None]]:
        same = nominal.stock is cell.stock and nominal.exchange is cell.exchange  # maps and stamps
        known: dict[int, Future] = {}
        if started and nominal is started[0]:
            gauge = started[1].result()
            known = {k: errors for k, errors in enumerate(started[2]) if not errors.cancel()}
        else:
            gauge = full_gauge if same else gauge_of(nominal)

        def run(k: int, plant: Cell) -> tuple[np.ndarray, float | None]:
            chosen = list(references.values()) if k < comparing else [revised]
            rows = run_sample(plant, target, (target, *chosen), gauge, quick=nominal is not cell, known=known.get(k))
            return rows, _tracked(cell, plant, gauge) if k < learning else None

        return each_robot(nominal, samples, seed, run, count)

    quick, difference = started[0] if started else coarser(cell), None
    robots = drawn(quick)
    rows = np.stack([row[:2] for row, _ in robots])
    if quick is not cell:

        def full_error(_: int, robot: Cell) -> float:
            return float(run_sample(robot, target, [revised], full_gauge, 1)[0, 0])

        full = np.array(each_robot(cell, min(CHECKED, samples), seed, full_error, lambda done: None))
        both = rows[: len(full), 1, 0]
        alike = np.isnan(full) & np.isnan(both)  # fails either way
        difference = float(np.where(alike, 0.0, np.abs(full - both)).max())
        if not difference <= NEAR * max(*cell.tolerances.of(), _high(rows[:, 1, 0])):
            robots, difference = drawn(cell), None
            rows = np.stack([row[:2] for row, _ in robots])
    methods = {name: np.array([row[k, 0] for row, _ in robots if k < len(row)]) for k, name in enumerate(references, 1)}
    tracked = [value for _, value in robots if value is not None]
    if tracked:
        methods[TRACKED] = np.array(tracked)
    surface = SURFACE_ERROR if flat_floors(cell) else NORMAL_ERROR
    quantity, shares = (PATH_DEVIATION if straight else surface), rows[:, 1, 1]
    before, after = rows[:, 0, 0], rows[:, 1, 0]
    word, reason = judge_plants(before, after, cell.uncertainty.matters_above, quantity)
    given = bool(np.isfinite(rows[..., 1]).any())
    return Verdict(word, reason, before, after, seed, methods, quantity, shares if given else None, difference)


def judge_plants(
    original: np.ndarray, compensated: np.ndarray, matters_above: float, quantity: str = PATH_DEVIATION
) -> tuple[str, str]:
    """The verdict and its reason from the errors [m], (n,), of the same plants on both trajectories.

    In this order: surely more than 5 % of the robots fail on the compensated trajectory and not on the original: cannot
    be trusted. 95 % of the originals stay below ``matters_above`` [m] and 95 % of the compensated as well: does not
    matter. 90 % of the robots change by less than 10 %: does not matter. Surely more than 5 % become worse: cannot be
    trusted. Half of them gain less than 10 %: does not matter. Else it helps. See ``surely_more``.
    """
    failing = 0.05  # share of robots that may fail or become worse on the compensated trajectory
    lost = np.isnan(compensated) & np.isfinite(original)
    if surely_more(int(lost.sum()), lost.size, failing):
        return UNTRUSTED, f"{lost.sum()} of {lost.size} robots fail on the compensated trajectory"
    both = np.isfinite(original) & np.isfinite(compensated)
    if not both.any():
        return UNTRUSTED, "no robot survives either trajectory"
    before, after = original[both], compensated[both]
    worst = max(np.quantile(before, 0.95), np.quantile(after, 0.95))
    if worst < matters_above:
        return INDIFFERENT, f"95 % of the robots stay below {1e6 * worst:.3g} um either way"
    low, middle, high = np.quantile(after / np.maximum(before, 1e-300), LEVELS)
    share = f"the {quantity} becomes {100 * middle:.0f} % of what it was ({100 * low:.0f} to {100 * high:.0f} %)"
    if low > 1.0 - SAME and high < 1.0 + SAME:
        return INDIFFERENT, share
    worse = int(np.sum(after >= before))
    if surely_more(worse, after.size, failing):
        return UNTRUSTED, f"{share}: {worse} of {after.size} robots become worse"
    if middle > 1.0 - SAME:
        return INDIFFERENT, share
    return HELPS, share


def surely_more(hits: int, count: int, share: float) -> bool:
    """Return whether the lower limit of the interval of Clopper and Pearson (``SURE``, one side) exceeds a share.

    P(at least ``hits`` of ``count``) = 1 - SURE at the limit   [ClopperPearson1934]
    """
    from scipy.stats import binom  # takes longer to import than all else that a command needs

    return bool(binom.sf(hits - 1, count, share) < 1.0 - SURE)


def drawn_errors(
    cell: Cell,
    references: Sequence[Trajectory],
    robots: int,
    seed: int,
    count: Callable[[int], object] = lambda done: None,
    first: int = 0,
) -> np.ndarray:
    """Errors [m] of drawn robots along references of a program, and their shares of the tolerance, (robots, k, 2).

    count(done): called after each robot; first: number of the first pass of a robot.
    """
    nominal, target = coarser(cell), path_of(cell).target
    gauge = gauge_of(nominal)

    def errors(_: int, robot: Cell) -> np.ndarray:
        return run_sample(robot, target, references, gauge, first, nominal is not cell)

    return np.array(each_robot(nominal, robots, seed, errors, count))


def run_sample(
    plant: Cell,
    target: Trajectory,
    references: Sequence[Trajectory],
    gauge: Judging,
    first: int = 0,
    quick: bool = False,
    known: Future | None = None,
) -> np.ndarray:
    """The error [m] of one plant along k references, and its share of the tolerance, (k, 2).

    NaN where the plant does not survive a reference; a share is also NaN without a tolerance. The references are
    corrections of one target: the arm's model along the target holds for all. first: number of the first pass, on which
    the repeatability depends; quick: see ``run_pass``; known: error and share along the first reference.
    """
    rows = np.full((len(references), 2), np.nan)
    with contextlib.suppress(MillingError):
        model = arm_model_of(plant, target)
        for k, reference in enumerate(references):
            if k == 0 and known:
                rows[k] = known.result()
            else:
                rows[k] = _errors(plant, model, target, reference, first + k, gauge, quick)
    return rows


def _errors(
    plant: Cell,
    model: ArmModel,
    target: Trajectory,
    reference: Trajectory,
    number: int,
    gauge: Judging,
    quick: bool,
) -> tuple[float, float]:
    """The error [m] of a pass, by its number, and its share of the tolerance; NaN where the plant is unstable."""
    cut = cut_of(plant)
    ran = run_pass(
        imperfect_arm(plant, reference, model), cut, path_of(plant).clock, target,
        imperfect_course(plant, reference, number, target), plant.exchange.iterations,
        silent=path_of(plant).drilling_at, quick=quick,
    )  # fmt: skip
    if np.abs(path_deviation(ran.actual, ran.target, target.sample_velocity(ran.time_ns))).max() >= DIVERGED:
        return math.nan, math.nan
    heights = None if path_of(plant).straight else cut.map_heights()[2]
    judged = gauge(dataclasses.replace(ran, heights=heights))
    return judged.error, judged.share
