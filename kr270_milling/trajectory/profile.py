"""Speed along a path with limited acceleration and jerk: S-shaped ramps between constant speeds.

A ramp from v0 to v1 raises the acceleration at the jerk j, holds it at most at a, and lowers it again: it lasts
2 sqrt(|v1 - v0| / j) while the acceleration stays below a, |v1 - v0| / a + a / j otherwise, and covers the mean speed
times that. Every ramp starts and ends without acceleration, so ramps can be joined in any order.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

__all__ = ["Ramps", "ramp_time", "reachable", "vertex_speeds", "peak_speeds"]


def ramp_time(change, acceleration: float, jerk: float) -> np.ndarray:
    """Shortest duration [s] of a ramp by ``change`` [m/s]."""
    change = np.abs(change)
    gentle = 2 * np.sqrt(change / jerk)
    return np.where(change <= acceleration**2 / jerk, gentle, change / acceleration + acceleration / jerk)


def reachable(speed: float, length: float, acceleration: float, jerk: float) -> float:
    """The highest speed [m/s] that a ramp from ``speed`` reaches within ``length`` [m]; closed form."""
    edge = acceleration**2 / jerk  # change of speed at which the acceleration just reaches its limit
    if length <= (2 * speed + edge) * acceleration / jerk:
        # (2 v + x^2) x = length sqrt(j) with x^2 the change of speed: the one real root of a cubic
        p, q = 2 * speed, length * math.sqrt(jerk)
        if p <= 1e-12 * q ** (2 / 3):
            x = q ** (1 / 3)
        else:
            x = 2 * math.sqrt(p / 3) * math.sinh(math.asinh(1.5 * q / p * math.sqrt(3 / p)) / 3)
        return speed + x * x
    half = speed + edge / 2
    return speed - half + math.sqrt(half**2 + 2 * acceleration * length - 2 * speed * edge)


def vertex_speeds(cap: np.ndarray, length: np.ndarray, acceleration: float, jerk: float) -> np.ndarray:
    """Highest speeds [m/s], (m+1,), at the ends of m segments, below ``cap`` (m+1,) and within reach of each other."""
    speeds, lengths = cap.tolist(), length.tolist()
    for i, distance in enumerate(lengths):
        if speeds[i + 1] > speeds[i]:
            speeds[i + 1] = min(speeds[i + 1], reachable(speeds[i], distance, acceleration, jerk))
    for i in range(len(lengths) - 1, -1, -1):
        if speeds[i] > speeds[i + 1]:
            speeds[i] = min(speeds[i], reachable(speeds[i + 1], lengths[i], acceleration, jerk))
    return np.array(speeds)


def peak_speeds(first, last, cap, length, acceleration: float, jerk: float) -> np.ndarray:
    """Highest speed [m/s], (m,), within each segment that leaves room for the ramps at both ends."""

    def room(peak):
        up, down = ramp_time(peak - first, acceleration, jerk), ramp_time(peak - last, acceleration, jerk)
        return length - (first + peak) / 2 * up - (peak + last) / 2 * down

    low, high = np.maximum(first, last), np.array(cap, float)
    fits = room(high) >= 0
    for _ in range(60):
        middle = (low + high) / 2
        good = room(middle) >= 0
        low, high = np.where(good, middle, low), np.where(good, high, middle)
    return np.where(fits, cap, low)


@dataclass(frozen=True, eq=False)
class Ramps:
    """Phases of motion along a path, one after the other from time 0; a cruise is a ramp between equal speeds."""

    duration: np.ndarray  #: [s], (p,)
    first: np.ndarray  #: [m/s], (p,), speed at the start of the phase
    last: np.ndarray  #: [m/s], (p,), speed at its end
    edge: np.ndarray  #: (p,), share of the phase in which the acceleration rises, and again falls; 0 < edge <= 1/2

    @classmethod
    def make(cls, duration, first, last, acceleration: float, jerk: float) -> Ramps:
        change = np.abs(np.asarray(last) - first)
        steep = change > acceleration**2 / jerk
        edge = np.where(steep, acceleration / jerk / np.where(steep, ramp_time(change, acceleration, jerk), 1.0), 0.5)
        return cls(np.asarray(duration, float), np.asarray(first, float), np.asarray(last, float), edge)

    @property
    def start(self) -> np.ndarray:
        """[s], (p + 1,)"""
        return np.concatenate([[0.0], np.cumsum(self.duration)])

    def sample(self, time: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Distance [m], speed [m/s] and acceleration [m/s^2] at times [s], (m,)."""
        start = self.start
        travelled = np.concatenate([[0.0], np.cumsum((self.first + self.last) / 2 * self.duration)])
        k = np.clip(np.searchsorted(start, time, side="right") - 1, 0, len(self.duration) - 1)
        duration = np.where(self.duration[k] > 0, self.duration[k], 1.0)
        u = np.clip((time - start[k]) / duration, 0, 1)
        edge, change = self.edge[k], self.last[k] - self.first[k]
        scale = 1 / (1 - edge)
        v, rest = u, 1 - u
        slope = scale * np.minimum(1, np.minimum(u, rest) / edge)
        speed = np.where(u < edge, v**2 / (2 * edge), v - edge / 2) * scale
        speed = np.where(rest < edge, 1 - scale * rest**2 / (2 * edge), speed)
        way = np.where(u < edge, v**3 / (6 * edge), edge**2 / 6 + (v - edge) * v / 2) * scale
        way = np.where(rest < edge, u - 0.5 + scale * rest**3 / (6 * edge), way)
        distance = travelled[k] + duration * (self.first[k] * u + change * way)
        return distance, self.first[k] + change * speed, change * slope / duration
