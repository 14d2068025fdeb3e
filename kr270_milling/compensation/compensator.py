"""The compensator: after each pass it revises the reference trajectory, until that no longer helps, Fig. 9."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import make_lsq_spline

from kr270_milling.base.record import Record, parameter
from kr270_milling.compensation.arm_fit import Identified
from kr270_milling.compensation.learning import Learner
from kr270_milling.compensation.lifted import Course
from kr270_milling.compensation.limiting import Bounds, Limited
from kr270_milling.compensation.methods import LIFTED, METHODS
from kr270_milling.compensation.response import ArmResponse
from kr270_milling.compensation.revision import PassRecord, corrected, held, revise
from kr270_milling.trajectory.trajectory import Trajectory

__all__ = ["Compensation", "Compensator", "noise_floor", "remaining_error"]

#: a pass that improves the largest error by less than this share, or by less than LEAST_STEP, ends the learning
LEAST_GAIN = 0.01
LEAST_STEP = 0.05e-6  #: [m]


@dataclass(frozen=True, eq=False)
class Compensation(Record):
    """YAML ``compensation``: how the reference trajectory is revised."""

    method: str = parameter(text="how the revised trajectory is made", choices=METHODS)
    relaxation: float = parameter(0.9, above=0.0, high=1.0, text="alpha of (32)")
    sag_compensated: bool = parameter(True, text="the controller already compensates the sag under the link weights")
    criterion: str = parameter(
        "min_max", text="what 'learned' and 'inverse' minimise", choices=("min_max", "least_squares")
    )
    interpolation: str = parameter(
        "spline", text="of 'inverse' and 'learned' between the knots", choices=("spline", "linear")
    )
    max_passes: int = parameter(12, low=1, high=1000, text="passes that 'learned' and ``repeat`` may take")
    repeat: bool = parameter(
        False, text="simulate and revise until the path error stops improving; 'learned' always does"
    )
    max_correction: float = parameter(
        2e-3, unit="mm", above=0.0, high=50.0, text="largest correction that is let through"
    )
    # 0.1 mm in 12 ms is 8.3 mm/s, an eighth of the paper's feed: loads build up in a tenth of a second and ask for
    # less, so what is faster is noise or a mistake. 12 ms is the interpolation cycle of a KR C4, 4 ms its fast one.
    max_change_per_tick: float = parameter(
        0.1e-3, unit="mm", above=0.0, high=50.0, text="largest change of the correction within one tick"
    )
    tick: float = parameter(12e-3, unit="ms", low=1.0, high=1000.0, text="cycle in which the controller takes it")

    @property
    def tick_ns(self) -> int:
        return round(self.tick * 1e9)


def remaining_error(target: Trajectory, ran: PassRecord) -> float:
    """Largest distance [m] of the tool from the target path, across the feed, over the scored part of a pass.

    Of a noisy measurement it is that of the spline through the knots of the target that is nearest to it.
    """
    error = ran.position - target.sample(ran.time_ns)
    if ran.noise:
        error = _smoothed(target.time, ran.time_ns * 1e-9, error)
    time, error = ran.time_ns[ran.scored], error[ran.scored]
    feed = target.sample_velocity(time)
    unit = feed / np.maximum(np.linalg.norm(feed, axis=1, keepdims=True), 1e-300)
    across = error - np.sum(error * unit, axis=1, keepdims=True) * unit
    return float(np.max(np.linalg.norm(across, axis=1)))


def _smoothed(knots: np.ndarray, time: np.ndarray, values: np.ndarray) -> np.ndarray:
    """The cubic spline on knots (k,) [s] that is nearest to the values (n, 3) at times (n,) [s], at these times."""
    place = np.searchsorted(time, knots[2:-2])
    inner = knots[2:-2][np.diff(place, prepend=1) > 0]  # one sample at least between two of them
    breaks = np.concatenate([np.repeat(time[0], 4), inner[inner < time[-1]], np.repeat(time[-1], 4)])
    return make_lsq_spline(time, values, breaks)(time)


def noise_floor(target: Trajectory, ran: PassRecord) -> float:
    """[m], what noise does to ``remaining_error``: the standard deviation of a spline with that many knots."""
    return ran.noise * math.sqrt(len(target) / max(len(target), ran.time_ns.size))


class Compensator:
    """Holds the target and the reference that the next pass should run.

    "mirror" hands the mean wrench (k, 6) at the target's knots to the function ``mirror``, which knows the arm;
    "inverse" and "learned" ask ``arm`` for its response along the target, without it they suppose that the tool follows
    the reference at once. Where nothing measured the wrench they take that of the model's own pass, ``predict``.
    ``cut`` tells what the process answers to a tool that strays from the target by (k, 3) [m] at times (k,) [ns].

    "learned", and with ``parameters.repeat`` every method, keeps the best reference so far and is ``finished`` when a
    pass brings less than 1 % or less than the noise, or max_passes are done; of any other method each pass
    simply revises the reference that it ran.
    """

    def __init__(
        self,
        parameters: Compensation,
        target: Trajectory,
        method: str | None = None,
        mirror: Callable[[Trajectory, np.ndarray], Trajectory] | None = None,
        arm: Callable[[Trajectory], ArmResponse] | None = None,
        predict: Callable[[Trajectory], PassRecord] | None = None,
        cut: Callable[[Trajectory, np.ndarray, np.ndarray], PassRecord] | None = None,
    ):
        self.parameters = parameters
        self.target = target
        self._mirror = mirror
        self._arm = arm
        self._predict = predict
        self._cut = cut
        self.method = method or parameters.method
        self.first: PassRecord | None = None  #: the pass along the target
        self.reset()

    def choose(self, method: str) -> Trajectory:
        """Go on with another method, from the pass along the target if there was one."""
        self.method = method
        self.reset()
        return self.revise(self.first) if self.first is not None else self.reference

    def reset(self) -> None:
        """Back to the target itself."""
        self.reference = self.target
        self.errors: tuple[float, ...] = ()  #: [m], remaining error of each pass
        self.limited: tuple[Limited, ...] = ()  #: where the correction of ``reference`` was limited
        self.finished = False
        self.note = ""  #: a sentence where no correction is made, or the model speaks against the one that is made
        self.learner: Learner | None = None  #: of "inverse" and "learned", from the first pass on
        self._best: tuple[float, Trajectory, tuple[Limited, ...]] = (math.inf, self.target, ())
        self._in_vain = 0  # passes in a row that brought nothing

    def resume(self, reference: Trajectory, finished: bool = False) -> None:
        """Go on from a pass along ``reference``; those before it are not known. finished: it is the best of them."""
        self.reference = reference
        self.finished = finished
        self._best = (math.inf, reference, ())

    @property
    def repeats(self) -> bool:
        return self.method == "learned" or self.parameters.repeat

    @property
    def most_passes(self) -> int | None:
        """How many passes it can ask for after the first one, where it repeats."""
        return self.parameters.max_passes if self.repeats else None

    @property
    def identified(self) -> Identified | None:
        """What was learned of the arm."""
        return self.learner.identified if self.learner else None

    @property
    def cut_off(self) -> float:
        """[m], what max_correction took away from the largest correction."""
        return max((part.missing for part in self.limited if part.kind == "size"), default=0.0)

    def revise(self, ran: PassRecord) -> Trajectory:
        """The reference for the next pass, from the pass that was run along the present one; raises RevisionError."""
        if not self.errors and self.reference is self.target:
            self.first = ran
        self.errors += (remaining_error(self.target, ran),)
        if self.repeats and self._is_best(ran):
            self.finished = True
            _, self.reference, self.limited = self._best
            if len(self.errors) > 1 and self.reference is self.target:
                self.note = f"{self.method} makes no pass better than the one without compensation: it is left out"
            return self.reference
        if self.method in LIFTED:
            self.learner = (self.learner or self.new_learner()).with_pass(ran, self.reference)
        self.reference, self.limited = self._revised(ran)
        if self.learner is not None:
            self._refuse_worse(self.learner)
        return self.reference

    def _revised(self, ran: PassRecord) -> tuple[Trajectory, tuple[Limited, ...]]:
        how, target = self.parameters, self.target
        bounds = Bounds(how.max_correction, how.max_change_per_tick, how.tick)
        if self.learner is not None:
            values, rates = self.learner.correction()
            return corrected(target, values, "linear" if rates is None else self.method, bounds, rates=rates)
        if self.method == "mirror" and self._mirror is not None:
            modified = self._mirror(target, ran.mean_wrench(target.time_ns))
            shift = modified.position - target.position
            return corrected(target, shift, "mirror", bounds, quaternion=modified.quaternion)
        return revise(self.method, target, self.reference, ran, bounds)

    def _refuse_worse(self, learner: Learner) -> None:
        """No correction whose predicted error is above that of no compensation."""
        predicted, none = learner.predicted(self.reference), learner.predicted(self.target)
        if predicted > none:
            self.reference, self.limited = self.target, ()
            self.note = (
                f"{self.method} would leave {1e6 * predicted:.3g} um where no compensation leaves "
                f"{1e6 * none:.3g} um: no correction is made"
            )

    def new_learner(self) -> Learner:
        """One that knows the model alone."""
        target, how = self.target, self.parameters
        course = Course(how.interpolation == "spline", target.standing, held(target))
        arm = self._arm(target) if self._arm else ArmResponse.rigid(len(target) - 1)
        cut = self._cut and functools.partial(self._cut, target)
        return Learner(target, arm, course, how.criterion, self._predict, cut)

    def _is_best(self, ran: PassRecord) -> bool:
        """Whether the best reference so far is not worth another revision.

        Of passes that the noise cannot tell apart the later one is better: it follows from more of them. One such pass
        may be bad luck, so a noisy measurement must bring nothing twice in a row.
        """
        error, best, floor = self.errors[-1], self._best[0], noise_floor(self.target, ran)
        first = len(self.errors) == 1
        if first or error < (best + floor if best < self.errors[0] else best):
            self._best = (min(error, best), self.reference, self.limited)
        worth = first or best - error > max(LEAST_GAIN * best, LEAST_STEP, floor)
        self._in_vain = 0 if worth else self._in_vain + 1
        return self.finished or self._in_vain > bool(floor) or len(self.errors) > self.parameters.max_passes

    def improve(self, first: PassRecord, run: Callable[[Trajectory], PassRecord]) -> Trajectory:
        """Revise from the first pass and, where the method repeats, run and revise on; returns the one to keep."""
        self.revise(first)
        while self.repeats and not self.finished:
            self.revise(run(self.reference))
        return self.reference
