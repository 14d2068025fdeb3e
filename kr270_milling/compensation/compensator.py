"""The compensator: after each pass it revises the reference trajectory, until that no longer helps, Fig. 9."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from kr270_milling.compensation.parameters import Compensation
from kr270_milling.compensation.revision import PassRecord, revise
from kr270_milling.trajectory.trajectory import Trajectory

__all__ = ["Compensator", "PassListener", "remaining_error"]

#: a pass that improves the largest error by less than this share ends the learning
LEAST_GAIN = 0.01


def remaining_error(target: Trajectory, ran: PassRecord) -> float:
    """Largest distance [m] of the tool from the target path, across the feed, over the scored part of a pass."""
    scored = ran.time_ns >= min(ran.scored_from_ns, int(ran.time_ns[-1]))
    time = ran.time_ns[scored]
    error, feed = ran.position[scored] - target.sample(time), target.sample_velocity(time)
    unit = feed / np.maximum(np.linalg.norm(feed, axis=1, keepdims=True), 1e-300)
    across = error - np.sum(error * unit, axis=1, keepdims=True) * unit
    return float(np.max(np.linalg.norm(across, axis=1)))


class Compensator:
    """Holds the target and the reference that the next pass should run.

    "mirror" hands the mean wrench (k, 6) at the target's knots to the function ``mirror``, which knows the arm.
    "linear" and "spline" revise from the pass along the target and repeat that after every further pass; "learned"
    keeps the best reference so far and is ``finished`` when a pass brings less than 1 % or max_passes are done.
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
        self.cut_off = 0.0  #: [m], what max_correction took away from the largest correction
        self.finished = False
        self._best = (math.inf, self.target)

    def revise(self, ran: PassRecord) -> Trajectory:
        """The reference for the next pass, from the pass that was run along the present one."""
        if not self.errors:
            self.first = ran
        self.errors.append(remaining_error(self.target, ran))
        if self.method == "learned":
            previous = self._best[0]
            if self.errors[-1] < previous:
                self._best = (self.errors[-1], self.reference)
            learned = len(self.errors) > 1 and not self.errors[-1] < (1.0 - LEAST_GAIN) * previous
            if self.finished or learned or len(self.errors) > self.parameters.max_passes:
                self.finished, self.reference = True, self._best[1]
                return self.reference
        if self.method == "mirror":
            self.reference = self._mirror(self.target, ran.mean_wrench(self.target.time_ns))
            return self.reference
        self.reference, self.cut_off = revise(
            self.method,
            self.target,
            self.reference,
            ran,
            criterion=self.parameters.criterion,
            max_correction=self.parameters.max_correction,
        )
        return self.reference

    def improve(self, first: PassRecord, run: Callable[[Trajectory], PassRecord]) -> Trajectory:
        """Revise from the first pass and, with "learned", run and revise on; returns the reference to keep."""
        self.revise(first)
        while self.method == "learned" and not self.finished:
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
