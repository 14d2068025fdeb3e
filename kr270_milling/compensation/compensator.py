"""The compensator: after each pass it revises the reference trajectory, until that no longer helps, Fig. 9."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable

import numpy as np

from kr270_milling.base.errors import MillingError
from kr270_milling.compensation.limiting import Limited
from kr270_milling.compensation.parameters import Compensation
from kr270_milling.compensation.revision import PassRecord, corrected, revise
from kr270_milling.trajectory.trajectory import Trajectory

__all__ = ["Compensator", "EarlierReference", "PassListener", "remaining_error"]

#: a pass that improves the largest error by less than this share ends the learning
LEAST_GAIN = 0.01


class EarlierReference(MillingError):
    """The best reference is that of a pass before the first one that is known here."""

    def __init__(self):
        super().__init__("the best reference trajectory is that of an earlier pass, which is not known")


def remaining_error(target: Trajectory, ran: PassRecord) -> float:
    """Largest distance [m] of the tool from the target path, across the feed, over the scored part of a pass."""
    time = ran.time_ns[ran.scored]
    error, feed = ran.position[ran.scored] - target.sample(time), target.sample_velocity(time)
    unit = feed / np.maximum(np.linalg.norm(feed, axis=1, keepdims=True), 1e-300)
    across = error - np.sum(error * unit, axis=1, keepdims=True) * unit
    return float(np.max(np.linalg.norm(across, axis=1)))


class Compensator:
    """Holds the target and the reference that the next pass should run.

    "mirror" hands the mean wrench (k, 6) at the target's knots to the function ``mirror``, which knows the arm.
    "learned", and with ``parameters.repeat`` every method, keeps the best reference so far and is ``finished`` when a
    pass brings less than 1 % or max_passes are done; else each pass simply revises the reference that it ran.
    """

    def __init__(
        self,
        parameters: Compensation,
        target: Trajectory,
        method: str | None = None,
        mirror: Callable[[Trajectory, np.ndarray], Trajectory] | None = None,
    ):
        self.parameters, self.target = parameters, target
        self._mirror = mirror
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
        self.errors: list[float] = []  #: [m], remaining error of each pass
        self.limited: tuple[Limited, ...] = ()  #: where the correction of ``reference`` was limited
        self.finished = False
        self._best = (math.inf, self.target, ())

    def resume(self, reference: Trajectory, errors: tuple[float, ...], finished: bool) -> None:
        """Go on from a later pass along ``reference``; errors [m] of the passes before it, whose references are not
        known here, unless it is ``finished`` and this is the best of them."""
        self.reference = reference
        self.errors = list(errors)
        self.finished = finished
        best = min(errors, default=math.inf)
        self._best = (best, reference if finished or not errors else None, ())

    @property
    def repeats(self) -> bool:
        return self.method == "learned" or self.parameters.repeat

    @property
    def cut_off(self) -> float:
        """[m], what max_correction took away from the largest correction."""
        return max((found.missing for found in self.limited if found.kind == "size"), default=0.0)

    def revise(self, ran: PassRecord) -> Trajectory:
        """The reference for the next pass, from the pass that was run along the present one."""
        if not self.errors:
            self.first = ran
        self.errors.append(remaining_error(self.target, ran))
        if self.repeats and self._is_best():
            self.finished, (_, self.reference, self.limited) = True, self._best
            if self.reference is None:
                raise EarlierReference
            return self.reference
        how = self.parameters
        limits = {
            "max_correction": how.max_correction,
            "max_change": how.max_change_per_tick,
            "tick": how.tick,
        }
        if self.method == "mirror":
            modified = self._mirror(self.target, ran.mean_wrench(self.target.time_ns))
            shift = modified.position - self.target.position
            found = corrected(self.target, shift, "mirror", quaternion=modified.quaternion, **limits)
        else:
            found = revise(self.method, self.target, self.reference, ran, criterion=how.criterion, **limits)
        self.reference, self.limited = found
        return self.reference

    def _is_best(self) -> bool:
        """Whether the best reference so far is not worth another revision."""
        previous = self._best[0]
        if self.errors[-1] < previous:
            self._best = (self.errors[-1], self.reference, self.limited)
        improved = len(self.errors) == 1 or self.errors[-1] < (1.0 - LEAST_GAIN) * previous
        return self.finished or not improved or len(self.errors) > self.parameters.max_passes

    def improve(self, first: PassRecord, run: Callable[[Trajectory], PassRecord]) -> Trajectory:
        """Revise from the first pass and, where the method repeats, run and revise on; returns the one to keep."""
        self.revise(first)
        while self.repeats and not self.finished:
            self.revise(run(self.reference))
        return self.reference


class PassListener:
    """Gathers what is heard of one pass and knows when it is complete; a later start begins anew."""

    def __init__(self, end_ns: int):
        self.end_ns = end_ns
        self.start_over()

    def start_over(self) -> None:
        self.stamps: list[int] = []
        self.items: list = []
        self.ignored = 0  #: messages that were older than the last one, or came before the start

    def copy(self) -> PassListener:
        """An independent one in the same state."""
        other = copy.copy(self)
        other.stamps = list(self.stamps)
        other.items = list(self.items)
        return other

    def hear(self, stamp_ns: int, item) -> bool:
        """True when the pass is complete with this item; a repeated stamp replaces its item."""
        if stamp_ns == 0:
            self.start_over()
        if stamp_ns != 0 and (not self.stamps or stamp_ns < self.stamps[-1] or self.stamps[-1] >= self.end_ns):
            self.ignored += 1
            return False
        if self.stamps and stamp_ns == self.stamps[-1]:
            self.items[-1] = item
            return False
        self.stamps.append(stamp_ns)
        self.items.append(item)
        return stamp_ns >= self.end_ns
