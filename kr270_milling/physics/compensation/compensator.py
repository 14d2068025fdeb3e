"""The compensator: after each pass it revises the reference trajectory, until that no longer helps, Fig. 9."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from scipy.interpolate import make_lsq_spline

from kr270_milling.base.errors import ParameterError
from kr270_milling.path.trajectory import Trajectory
from kr270_milling.physics.compensation.learning import CellModels, Learner
from kr270_milling.physics.compensation.method import Correction, Method, RevisionTask
from kr270_milling.physics.compensation.methods import method_of
from kr270_milling.physics.compensation.revision import Bounds, Limited, PassRecord, corrected
from kr270_milling.physics.compensation.settings import CompensationSettings


def remaining_error(target: Trajectory, record: PassRecord) -> float:
    """Largest distance [m] of the tool from the target path, across the feed, over the scored part of a pass.

    A noisy measurement is replaced by its least-squares spline on the knots of the target.
    """
    error = record.position - target.sample(record.time_ns)
    if record.noise:
        error = _smoothed(target.time, record.time_ns * 1e-9, error)
    time, error = record.time_ns[record.scored], error[record.scored]
    feed = target.sample_velocity(time)
    unit = feed / np.maximum(np.linalg.norm(feed, axis=1, keepdims=True), 1e-300)
    across = error - np.sum(error * unit, axis=1, keepdims=True) * unit
    return float(np.max(np.linalg.norm(across, axis=1)))


def _smoothed(knots: np.ndarray, time: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Least-squares cubic spline on knots (k,) [s] of values (n, 3) at times (n,) [s], evaluated at these times."""
    place = np.searchsorted(time, knots[2:-2])
    inner = knots[2:-2][np.diff(place, prepend=1) > 0]  # at least one sample between two knots
    breaks = np.concatenate([np.repeat(time[0], 4), inner[inner < time[-1]], np.repeat(time[-1], 4)])
    return make_lsq_spline(time, values, breaks)(time)


def noise_floor(target: Trajectory, record: PassRecord) -> float:
    """Standard deviation [m] that the noise gives to ``remaining_error``, of a spline on the knots of the target."""
    return record.noise * math.sqrt(len(target) / max(len(target), record.time_ns.size))


class Compensator:
    """The target, and the reference that the next pass runs.

    method: a name of METHODS or a ``Method`` object (default: that of ``parameters``); models: what the method may use
    of arm and cut.

    A method that repeats, and with ``parameters.repeat`` every method, keeps the best reference so far. It is
    ``finished`` when a pass improves the error by less than 1 % or less than the noise, when it leaves less than the
    share ``enough`` of the first error, or after max_passes. Any other method only revises the reference of the last
    pass.
    """

    def __init__(
        self,
        parameters: CompensationSettings,
        target: Trajectory,
        method: str | Method | None = None,
        models: CellModels | None = None,
    ):
        self.parameters = parameters
        self.target = target
        self.models = models or CellModels()
        self.chosen = method_of(method or parameters.planned_method)  #: the method object
        self.first: PassRecord | None = None  #: the pass along the target
        self.enough = 0.0
        self.reset()

    @property
    def method(self) -> str:
        """The name of the method."""
        return self.chosen.name

    def choose(self, method: str | Method) -> Trajectory:
        """Change the method and return its reference, revised from the pass along the target if there was one."""
        shared = self.learner is not None and self.learner.only is self.first
        self.chosen = method_of(method)
        self.reset(self.learner if shared else None)
        return self.revise(self.first) if self.first is not None else self.reference

    def reset(self, learner: Learner | None = None) -> None:
        """Return to the target itself."""
        self.reference = self.target
        self.errors: tuple[float, ...] = ()  #: [m], remaining error of each pass
        self.limited: tuple[Limited, ...] = ()  #: where the correction of ``reference`` was limited
        self.finished = False
        self.note = ""  #: why no correction is made, or why the best pass is the one without compensation
        self.learner = learner  #: the experience of a method that learns, from the first pass on
        self._best: tuple[float, Trajectory, tuple[Limited, ...]] = (math.inf, self.target, ())
        self._in_vain = 0  # passes in a row without improvement

    def resume(self, reference: Trajectory, finished: bool = False) -> None:
        """Continue from a pass along ``reference`` after unknown passes. finished: ``reference`` is the best."""
        self.reference = reference
        self.finished = finished
        self._best = (math.inf, reference, ())

    @property
    def repeats(self) -> bool:
        return self.chosen.repeats or self.parameters.repeat

    @property
    def most_passes(self) -> int | None:
        """Most passes after the first one; None where the method does not repeat."""
        return self.parameters.max_passes if self.repeats else None

    @property
    def identified(self) -> dict | None:
        """The arm as fitted to the passes."""
        return self.learner.identified if self.learner else None

    @property
    def best(self) -> Trajectory:
        """The best reference so far of a method that repeats."""
        return self._best[1]

    @property
    def cut_off(self) -> float:
        """[m], what max_correction took away from the largest correction."""
        return max((part.missing for part in self.limited if part.kind == "size"), default=0.0)

    def revise(self, record: PassRecord) -> Trajectory:
        """Return the reference for the next pass from the pass along the present one; raise ModelError."""
        if not self.errors and self.reference is self.target:
            self.first = record
        self.errors += (remaining_error(self.target, record),)
        if self.repeats and self._is_best(record):
            self.finished = True
            _, self.reference, self.limited = self._best
            if len(self.errors) > 1 and self.reference is self.target:
                self.note = f"{self.method} makes no pass better than the one without compensation: it is left out"
            return self.reference
        parameters, target = self.parameters, self.target
        bounds = Bounds(parameters.max_correction, parameters.max_change_per_tick, parameters.tick)
        task = RevisionTask(
            target, self.reference, record, self.models, parameters.criterion, parameters.smooth, self.learner
        )
        correction = self.chosen.revise(task)
        if not isinstance(correction, Correction):
            kind = type(correction).__name__
            raise ParameterError(f"method {self.method}", kind, "a Correction, which revise must return")
        shape, knots = np.shape(correction.offset), (len(target), 3)
        if shape != knots or not np.isfinite(correction.offset).all():
            given = shape if shape != knots else "not finite"
            raise ParameterError(f"method {self.method}: offset", given, f"finite [m], of the shape {knots}")
        self.learner = correction.learner
        self.reference, self.limited = corrected(
            target, correction.offset, correction.smooth, bounds, quaternion=correction.quaternion
        )
        if self.learner is not None:
            self._refuse_worse(self.learner)
        return self.reference

    def _refuse_worse(self, learner: Learner) -> None:
        """Make no correction whose predicted error is above that of no compensation."""
        predicted, none = learner.predicted(self.reference, self.target)
        if predicted > none:
            self.reference, self.limited = self.target, ()
            self.note = (
                f"{self.method} would leave {1e6 * predicted:.3g} um where no compensation leaves "
                f"{1e6 * none:.3g} um: no correction is made"
            )

    def _is_best(self, record: PassRecord) -> bool:
        """Return whether the best reference so far is not worth another revision.

        If passes differ by less than the noise, the later pass is better, because it follows from more passes. One
        such pass may be bad luck, so a noisy measurement needs two passes in a row without improvement.
        """
        error, best, floor = self.errors[-1], self._best[0], noise_floor(self.target, record)
        first = len(self.errors) == 1
        if first or error < (best + floor if best < self.errors[0] else best):
            self._best = (min(error, best), self.reference, self.limited)
        least_step = 0.05e-6  # [m]: an improvement of the largest error by less, or by less than 1 %, ends the learning
        worth = first or best - error > max(0.01 * best, least_step, floor)
        self._in_vain = 0 if worth else self._in_vain + 1
        few = not first and error <= self.enough * self.errors[0]
        return self.finished or few or self._in_vain > bool(floor) or len(self.errors) > self.parameters.max_passes

    def improve(self, first: PassRecord, run: Callable[[Trajectory], PassRecord]) -> Trajectory:
        """Return the best reference: revise from the first pass and, where the method repeats, run and revise again."""
        self.revise(first)
        while self.repeats and not self.finished:
            self.revise(run(self.reference))
        if self.learner is not None:
            self.learner.forget()
        return self.reference
