"""Limits of the correction: its size, and its change from one tick of the controller to the next."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

__all__ = ["Limited", "limit_change", "limit_size", "resting", "steepest"]

AT_REST = 1e-9  #: [m/s] slower is standing still


@dataclass(frozen=True)
class Limited:
    """Neighbouring knots whose correction was limited; points are counted from 1, as in the robot program."""

    kind: str  #: "size" [m] or "change" [m/s]
    first: int  #: point
    last: int  #: point
    worst: int  #: point that lost most
    time: float  #: [s], of the worst one
    wanted: float  #: there
    allowed: float

    @property
    def sentence(self) -> str:
        where = f"point {self.first}" if self.first == self.last else f"points {self.first} to {self.last}"
        unit, what = ("mm", "the correction") if self.kind == "size" else ("mm/s", "the change of the correction")
        amount = f"from {1e3 * self.wanted:.4g} to {1e3 * self.allowed:.4g} {unit}"
        return f"{what} is limited at {where}: at point {self.worst} ({self.time:.3f} s) {amount}"


def resting(velocity: np.ndarray | None, count: int) -> np.ndarray:
    """(n,) True where a trajectory with knot velocities (n, 3) [m/s] stands still at a knot."""
    return np.zeros(count, bool) if velocity is None else ~(np.abs(velocity) > AT_REST).any(axis=1)


def limit_size(time: np.ndarray, knots: np.ndarray, largest: float) -> tuple[np.ndarray, list[Limited]]:
    """Corrections (n, 3) [m], shortened to ``largest`` [m] where they are longer; time [s], (n,)."""
    size = np.linalg.norm(knots, axis=1)
    found = _runs("size", time, size, np.full(size.size, largest), 0)
    return (knots * np.minimum(1.0, largest / np.maximum(size, 1e-300))[:, None] if found else knots), found


def limit_change(time: np.ndarray, knots: np.ndarray, rate: np.ndarray) -> tuple[np.ndarray, list[Limited]]:
    """Corrections (n, 3) [m] that change by no more than ``rate`` (n - 1,) [m/s] from knot to knot.

    The mean of what follows as fast as it may and of what starts as early as it must: without lag on the whole, and
    unchanged where nothing is to be limited. Found are the knots at the ends of the steps that were too large.
    """
    step = np.diff(time)
    found = _runs("change", time, np.linalg.norm(np.diff(knots, axis=0), axis=1) / step, rate, 1)
    if not found:
        return knots, found
    most = rate * step
    return 0.5 * (_follow(knots, most) + _follow(knots[::-1], most[::-1])[::-1]), found


def _follow(knots: np.ndarray, most: np.ndarray) -> np.ndarray:
    followed = knots.copy()
    gaps = np.linalg.norm(np.diff(knots, axis=0), axis=1)
    behind = False
    for k in range(1, len(knots)):
        if not behind and gaps[k - 1] <= most[k - 1]:
            continue
        gap = knots[k] - followed[k - 1]
        length = float(np.sqrt(gap @ gap))
        behind = length > most[k - 1]
        if behind:
            followed[k] = followed[k - 1] + gap * (most[k - 1] / length)
    return followed


def steepest(time: np.ndarray, knots: np.ndarray, rates: np.ndarray | None) -> np.ndarray:
    """Largest rate [m/s], (n - 1,), of corrections (n, 3) [m] between knots: chords, or cubics of slopes ``rates``."""
    step = np.diff(time)[:, None]
    move = np.diff(knots, axis=0) / step
    if rates is None:
        return np.linalg.norm(move, axis=1)
    u = np.linspace(0.0, 1.0, 9)[:, None, None]  # of a quadratic; the bound needs no more than a few percent
    first, last = rates[:-1], rates[1:]
    speed = first + 2.0 * u * (3.0 * move - 2.0 * first - last) + 3.0 * u**2 * (first + last - 2.0 * move)
    return np.linalg.norm(speed, axis=2).max(axis=0)


def _runs(kind: str, time, value, most, offset: int) -> list[Limited]:
    """One Limited for each run of values above ``most``; value[k] belongs to the knot k + offset."""
    over = ~(value <= most * (1.0 + 1e-9))
    edges = np.flatnonzero(np.diff(np.concatenate([[False], over, [False]]).astype(np.int8))).reshape(-1, 2)
    found = []
    for start, stop in edges.tolist():
        worst = start + int(np.argmax(value[start:stop] - most[start:stop]))
        k = worst + offset
        found.append(
            Limited(
                kind, start + offset + 1, stop + offset, k + 1, float(time[k]), float(value[worst]), float(most[worst])
            )
        )
    return found
