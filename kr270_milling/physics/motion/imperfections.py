"""Imperfections of a real cell that no model knows: noise of the sensors, repeatability, backlash, servo lag."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from kr270_milling.base.errors import ParameterError
from kr270_milling.base.record import Record, parameter
from kr270_milling.path.trajectory import Trajectory

LEAST_SERVO_FREQUENCY = 0.1  #: [Hz]; far slower motors do not follow at all, and the filter becomes singular


@dataclass(frozen=True, eq=False)
class Imperfections(Record):
    """YAML ``imperfections``, of the plant: what it adds to each pass, drawn from ``seed``."""

    pose_noise: float = parameter(
        0.0, unit="um", low=0.0, high=1e4, text="standard deviation of each measured tool position along each axis"
    )
    # ISO 9283: mean distance from the barycentre + 3 standard deviations of it, as data sheets state
    repeatability: float = parameter(
        0.0, unit="um", low=0.0, high=1e4, text="position repeatability (ISO 9283): shifts each pass as a whole"
    )
    backlash: np.ndarray = parameter(
        np.zeros(6),
        unit="arcsec",
        size=6,
        low=0.0,
        high=18000.0,
        text="backlash of each joint of this plant, which shows where the load on the joint reverses",
    )
    servo_frequency: float = parameter(
        0.0,
        unit="hz",
        low=0.0,
        high=1000.0,
        text="natural frequency of the second-order lag with which the motors follow a correction, from 0.1; 0: no lag",
    )
    servo_delay: float = parameter(
        0.0, unit="ms", low=0.0, high=1000.0, text="dead time before this lag; simulated robots have at least this one"
    )
    # assumed: the usual tuning without overshoot
    servo_damping: float = parameter(
        0.7, low=0.05, high=5.0, text="damping ratio of this lag, also of simulated robots"
    )
    # the rule of a controller is not public; slopes from the neighbours are assumed
    joining: float = parameter(
        0.0,
        low=0.0,
        high=1.0,
        text="motion between points: 0 as planned, 1 with slopes from their neighbours (SPLINE), blended corners (LIN)",
    )
    wrench: str = parameter(
        "noisy", choices=("none", "noisy", "exact"), text="of the cut, that the compensator receives off line"
    )
    # assumed: a force sensor of some kN between flange and spindle, at the exchange rate, offset and gravity taken off
    wrench_noise: float = parameter(
        2.0, unit="n", low=0.0, high=1e4, text="standard deviation of each measured force while the tool cuts; noisy"
    )
    seed: int = parameter(1, low=0, high=2**31 - 1, text="of noise and repeatability")
    first_pass: int = parameter(0, low=0, high=1_000_000, text="passes whose random numbers are drawn already")

    def check(self) -> None:
        if 0.0 < self.servo_frequency < LEAST_SERVO_FREQUENCY:
            raise ParameterError("servo_frequency_hz", self.servo_frequency, f"0, or {LEAST_SERVO_FREQUENCY:g} to 1000")

    def generator(self, number: int) -> np.random.Generator:
        """The random numbers of pass ``number``, from 0."""
        return np.random.default_rng([self.seed, self.first_pass + number])

    def shift(self, number: int) -> np.ndarray:
        """[m], (3,): by how much pass ``number`` as a whole lies beside the commanded one."""
        # distance of a Maxwell distribution with deviation 1 along each axis: mean 1.596 + 3 times its deviation 0.673
        deviation = self.repeatability / (np.sqrt(8.0 / np.pi) + 3.0 * np.sqrt(3.0 - 8.0 / np.pi))
        return deviation * self.generator(number).standard_normal(3)

    def measured(self, position: np.ndarray, number: int) -> np.ndarray:
        """Tool positions (n, 3) [m] of pass ``number`` as the tracker reports them."""
        if not self.pose_noise:
            return position
        generator = self.generator(number)
        generator.standard_normal(3)  # those of ``shift``
        return position + self.pose_noise * generator.standard_normal(position.shape)

    def sensed(self, wrench: np.ndarray, number: int) -> np.ndarray | None:
        """Wrenches (n, 6) [N, N m] of pass ``number`` as the force sensor reports them; None: there is no sensor.

        A period without a cut stays 0: its offset is the tare of the sensor.
        """
        if self.wrench == "none":
            return None
        if self.wrench == "exact" or not self.wrench_noise:
            return wrench
        # assumed: the noise of a moment is that of a force times 0.1 m
        size = self.wrench_noise * np.array([1.0] * 3 + [0.1] * 3)
        noise = np.random.default_rng([self.seed, self.first_pass + number, 1]).standard_normal(wrench.shape)
        return np.where(np.any(wrench, axis=1, keepdims=True), wrench + size * noise, 0.0)

    def lagged(self, reference: Trajectory, target: Trajectory) -> Trajectory:
        """The course of motors that follow the correction c = reference - target late, and the target at once.

        y'' + 2 zeta w y' + w^2 y = w^2 c(t - T): second order of frequency w with the dead time T, at rest before the
        pass. The lag along the programmed path is that of a pass without a correction: the controller plans with it.
        """
        if not (self.servo_frequency or self.servo_delay) or reference is target:
            return reference
        step = max(1_000_000, target.duration_ns // 900_000)  # 1 ms; 4 ms in an hour
        grid = np.append(np.arange(0, target.duration_ns, step), target.duration_ns)
        late = np.maximum(grid - round(1e9 * self.servo_delay), 0)
        correction = reference.sample(late) - target.sample(late)
        if self.servo_frequency:
            correction = second_order(correction, self.servo_frequency, self.servo_damping, 1e-9 * step)
        both = np.sort(np.concatenate([grid, target.time_ns]), kind="stable")  # two sorted rows: a merge
        time_ns = both[np.diff(both, prepend=-1) > 0]
        shift, rate = np.empty((2, time_ns.size, 3))
        _fill_between(grid, correction, time_ns, shift, rate)
        smooth = reference.velocity is not None
        return Trajectory(
            time_ns,
            target.sample(time_ns) + shift,
            reference.sample_orientation(time_ns),
            target.sample_velocity(time_ns) + rate if smooth else None,
            reference.frame,
        )


@njit(cache=True, error_model="numpy", nogil=True)
def _fill_between(grid, rows, times, shift, rate):
    """Fill rows (n, 3) at a grid [ns], and their rates by central differences [1/s], between them at times in order."""
    rates, last, k = np.empty(rows.shape), len(grid) - 1, 0
    for n in range(len(grid)):
        before, after = max(n - 1, 0), min(n + 1, last)
        h, g = grid[n] * 1e-9 - grid[before] * 1e-9, grid[after] * 1e-9 - grid[n] * 1e-9
        for i in range(3):
            if before == n or after == n:
                rates[n, i] = (rows[after, i] - rows[before, i]) / (h + g)
            else:
                middle = -g / (h * (h + g)) * rows[before, i] + (g - h) / (h * g) * rows[n, i]
                rates[n, i] = middle + h / (g * (h + g)) * rows[after, i]
    for n in range(len(times)):
        while k < last - 1 and grid[k + 1] <= times[n]:
            k += 1
        step, gone = grid[k + 1] - grid[k], times[n] - grid[k]
        for i in range(3):
            shift[n, i] = (rows[k + 1, i] - rows[k, i]) / step * gone + rows[k, i]
            rate[n, i] = (rates[k + 1, i] - rates[k, i]) / step * gone + rates[k, i]


def second_order(rows: np.ndarray, frequency: float, damping: float, step: float) -> np.ndarray:
    """Rows (n, k) through w^2 / (s^2 + 2 zeta w s + w^2), linear between samples ``step`` [s] apart, from rest.

    frequency: w / (2 pi) [Hz]; damping: zeta.
    """
    from scipy import signal  # takes longer to import than all else that a command needs

    w = 2.0 * np.pi * frequency
    plant = signal.TransferFunction([w * w], [1.0, 2.0 * damping * w, w * w])
    discrete = signal.cont2discrete((plant.num, plant.den), step, "foh")
    out = np.array(rows, float)
    _filter(discrete[0].ravel(), discrete[1], signal.lfilter_zi(discrete[0].ravel(), discrete[1]), out)
    return out


@njit(cache=True, nogil=True)
def _filter(b, a, at_rest, rows):
    """Replace rows (n, k) by their filter b / a of second order; at_rest: its states (2,) under a steady unit row."""
    for i in range(rows.shape[1]):
        first, second = at_rest[0] * rows[0, i], at_rest[1] * rows[0, i]
        for n in range(rows.shape[0]):
            value = rows[n, i]
            answer = b[0] * value + first
            answer = answer if abs(answer) > 1e-290 else 0.0  # a processor takes 20 times as long for denormal numbers
            first, second = second + b[1] * value - a[1] * answer, b[2] * value - a[2] * answer
            rows[n, i] = answer
