"""Limits of the correction: its size, and its change from one tick of the controller to the next."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kr270_milling.base.column import column


@dataclass(frozen=True)
class Bounds:
    """Limits of a correction."""

    max_correction: float = np.inf  #: [m]
    max_change: float = np.inf  #: [m], within each tick
    tick: float = 12e-3  #: [s], of the controller


UNBOUNDED = Bounds()


@dataclass(frozen=True)
class Limited:
    """Neighbouring knots whose correction was limited; points are counted from 1, as in the robot program."""

    kind: str = column("kind")  #: "size" or "change"
    first: int = column("first")  #: point
    last: int = column("last")  #: point
    worst: int = column("worst")  #: point that lost most
    time: float = column("time_s")  #: [s], of the worst one
    wanted: float = column("wanted_um", 1e6)  #: [m], size of the correction there
    missing: float = column("missing_um", 1e6)  #: [m], the part of it that is left out; more where the sign turns

    @property
    def feed_share(self) -> float:
        """Share of the programmed feed at which the limit would about hold, where the inertia of the arm asks for it.

        Of a correction of which a part is left.
        A path that is run at the share f accelerates with f^2 and so does the correction c = r'' / omega^2; its change
        in a tick goes with f^3.
        """
        remaining = 1.0 - self.missing / self.wanted
        return remaining ** (1.0 / 2.0 if self.kind == "size" else 1.0 / 3.0)

    @property
    def sentence(self) -> str:
        where = f"point {self.first}" if self.first == self.last else f"points {self.first} to {self.last}"
        why = "is too large" if self.kind == "size" else "changes too fast"
        left = f"{1e6 * self.missing:.1f} of {1e6 * self.wanted:.1f} um are left out"
        if self.missing >= self.wanted:
            wanted = f"{1e6 * self.wanted:.1f} um are wanted"
            left = f"{wanted}, and the correction is {1e6 * self.missing:.1f} um away from them,"
        return f"the correction {why} at {where}: {left} at point {self.worst} ({self.time:.3f} s)"


def limit_change(knots: np.ndarray, most: np.ndarray) -> np.ndarray:
    """Corrections (n, 3) [m] that change by no more than ``most`` (n - 1,) [m] from knot to knot.

    The mean of what follows as fast as it may and of what starts as early as it must: without lag on the whole, and
    unchanged where nothing is to be limited.
    """
    if np.all(np.linalg.norm(np.diff(knots, axis=0), axis=1) <= most):
        return knots
    return 0.5 * (_follow(knots, most) + _follow(knots[::-1], most[::-1])[::-1])


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


def describe(kind: str, time: np.ndarray, wanted: np.ndarray, allowed: np.ndarray) -> tuple[Limited, ...]:
    """Return a Limited for each run of knots whose correction (n, 3) [m] was changed; time [s], (n,)."""
    missing, size = np.linalg.norm(wanted - allowed, axis=1), np.linalg.norm(wanted, axis=1)
    # 1 nm less of a correction is no limitation
    edges = np.flatnonzero(np.diff(np.concatenate([[0], missing > 1e-9, [0]]))).reshape(-1, 2)
    worst = [start + int(np.argmax(missing[start:stop])) for start, stop in edges.tolist()]
    return tuple(
        Limited(kind, start + 1, stop, k + 1, float(time[k]), float(size[k]), float(missing[k]))
        for (start, stop), k in zip(edges.tolist(), worst, strict=True)
    )
