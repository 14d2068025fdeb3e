"""The two sides of one pass, stepped by messages: what a robot node and a cutting node do between in and out.

A recording is recomputed with the same two classes, so what a node published can be demanded bit for bit.
"""

from __future__ import annotations

import math

import numpy as np

from kr270_milling.base.errors import MillingError
from kr270_milling.cutting import Cut
from kr270_milling.simulation.dynamics import ArmModel
from kr270_milling.simulation.exchange import Clock
from kr270_milling.simulation.milling_pass import CompliantArm
from kr270_milling.trajectory.trajectory import Trajectory

__all__ = ["CuttingSide", "ExchangeError", "RobotSide"]


class ExchangeError(MillingError):
    """A message that does not fit the exchange; stamp_ns is its stamp."""

    def __init__(self, stamp_ns: int, reason: str):
        self.stamp_ns, self.reason = stamp_ns, reason
        super().__init__(f"stamp {stamp_ns * 1e-9:.6f} s: {reason}")


class RobotSide:
    """Follows a reference trajectory: predicts the tool's position, is answered with a wrench, corrects."""

    def __init__(self, model: ArmModel, clock: Clock, reference: Trajectory, iterations: int = 1):
        self.clock, self.iterations = clock, iterations
        self.steps = clock.steps(reference.duration_ns)
        self.stamps = clock.stamp(np.arange(self.steps + 1))
        self.course = reference.sample(self.stamps)  #: [m], (steps + 1, 3)
        self.orientation = reference.sample_orientation(self.stamps)  #: (steps + 1, 4)
        self.correction = 0.0  #: [m], largest corrected minus predicted tool centre so far
        self._arm = CompliantArm(model, model.push(reference, self.stamps))
        self._whole_stamps: list[int] = self.stamps.tolist()  # an item of a list is had in a tenth of the time
        self._next = 0  # step whose wrench is awaited
        self._iteration = 0
        self.tool = self.course[0]  #: last predicted tool centre [m], (3,)
        self.awaited_ns = 0  #: stamp of the wrench that the robot waits for

    @property
    def done(self) -> bool:
        return self._next > self.steps

    @property
    def orientation_now(self) -> np.ndarray:
        """Quaternion (4,) that belongs to ``tool``."""
        return self.orientation[min(self._next, self.steps)]

    def answer(self, stamp_ns: int, wrench: np.ndarray) -> np.ndarray | None:
        """Take the wrench (6,) of the period that ends at the stamp; returns the corrected deflection (6,).

        None: the stamp is not the awaited one (a repeated answer), or the exchange of this period is to be repeated
        from the new ``tool``. Afterwards ``tool`` and ``awaited_ns`` are those of the next exchange.
        """
        if self.done or stamp_ns != self.awaited_ns:
            return None
        if self._next == 0:  # the pass starts at rest, out of load
            deflection = np.zeros(6)
        elif self._iteration + 1 < self.iterations:
            self._iteration += 1
            self.tool = self.course[self._next] + self._arm.predict(wrench)[:3]
            return None
        else:
            deflection = self._arm.correct(wrench)
            x, y, z = (self.course[self._next] + deflection[:3] - self.tool).tolist()
            self.correction = max(self.correction, math.sqrt(x * x + y * y + z * z))
        self._next, self._iteration = self._next + 1, 0
        if self._next <= self.steps:
            self.awaited_ns = self._whole_stamps[self._next]
            self.tool = self.course[self._next] + self._arm.predict()[:3]
        return deflection


class CuttingSide:
    """Answers each tool position with the mean wrench of the way to it; a repeated stamp gets the same answer."""

    def __init__(self, cut: Cut, clock: Clock):
        self.cut, self.clock = cut, clock
        self.step = -1  #: last step answered
        self._before = self._tool = np.zeros(3)  # tool centre of the step before, and of the last one
        self._wrench = np.zeros(6)

    def answer(self, stamp_ns: int, tool: np.ndarray) -> np.ndarray:
        """Wrench (6,) on the tool over the period that ends at the stamp with the tool centre (3,) there.

        Raises ExchangeError for a stamp that is neither the next nor the last one.
        """
        step = self.clock.step(stamp_ns)
        if step == 0 and self.step <= 0:
            self.step, self._tool, self._wrench = 0, np.array(tool), np.zeros(6)
        elif step == 0:
            raise ExchangeError(stamp_ns, "a new pass needs a fresh workpiece: configure the cutting process again")
        elif self.step < 0:
            raise ExchangeError(stamp_ns, "the pass is under way, but this cutting process has not seen its start")
        elif step == self.step + 1:
            self._sweep(step, self._tool, tool)
        elif step == self.step:
            if not np.array_equal(tool, self._tool):  # the exchange is iterated
                self.cut.restore()
                self._sweep(step, self._before, tool)
        elif step >= 0 and step < self.step:
            raise ExchangeError(stamp_ns, f"is older than the last one, {self.clock.stamp(self.step) * 1e-9:.6f} s")
        else:
            raise ExchangeError(stamp_ns, f"does not follow the last one, {self.clock.stamp(self.step) * 1e-9:.6f} s")
        return self._wrench

    def _sweep(self, step: int, start: np.ndarray, end: np.ndarray) -> None:
        n = self.clock.micro_steps
        self._wrench = self.cut.sweep(start, end, (step - 1) * n, n)
        self.step, self._before, self._tool = step, start, np.array(end)
