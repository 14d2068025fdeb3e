"""The segments between the knots of a path, each in equal parts in which deviations are averaged."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

__all__ = ["Segments", "cubic_coefficients"]

LONGEST = 3e-3  #: [s], of a part: a tenth of the period of a mode at 33 Hz
FEWEST, MOST = 4, 16  #: parts in a segment


@dataclass(frozen=True, eq=False)
class Segments:
    """The m segments between m + 1 knots. The middle of a part stands for it."""

    time_ns: np.ndarray  #: knots [ns], (m + 1,)
    parts: int  #: of each segment

    @classmethod
    def of(cls, time_ns: np.ndarray) -> Segments:
        typical = float(np.median(np.diff(time_ns))) * 1e-9
        return cls(time_ns, int(np.clip(np.ceil(typical / LONGEST - 1e-9), FEWEST, MOST)))

    def __len__(self) -> int:
        return self.time_ns.size - 1

    @property
    def duration(self) -> np.ndarray:
        """[s], (m,)"""
        return np.diff(self.time_ns) * 1e-9

    @property
    def place(self) -> np.ndarray:
        """Middle of each part from the start of its segment [s], (m, parts)."""
        return self.duration[:, None] * ((np.arange(self.parts) + 0.5) / self.parts)

    @property
    def powers(self) -> np.ndarray:
        """1, t, t^2 / 2, t^3 / 6 at these places, (m, parts, 4)."""
        place = self.place
        return np.stack([np.ones_like(place), place, place**2 / 2.0, place**3 / 6.0], axis=-1)

    @property
    def middle_ns(self) -> np.ndarray:
        """Middle of each part [ns], (m, parts)."""
        return self.time_ns[:-1, None] + np.rint(self.place * 1e9).astype(np.int64)

    def part_of(self, time_ns: np.ndarray) -> np.ndarray:
        """Number of the part, counted over all segments, in which each time [ns] lies; (n,)."""
        segment = np.clip(np.searchsorted(self.time_ns, time_ns, side="right") - 1, 0, len(self) - 1)
        share = (time_ns - self.time_ns[segment]) / np.diff(self.time_ns)[segment]
        return segment * self.parts + np.clip((share * self.parts).astype(int), 0, self.parts - 1)

    def mean(self, time_ns: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Mean of samples (n, d) in each part, (m, parts, d); interpolated where no sample lies in a part."""
        size, part = len(self) * self.parts, self.part_of(time_ns)
        count = np.maximum(np.bincount(part, minlength=size), 1)[:, None]
        mean = np.stack([np.bincount(part, v, size) for v in values.T], axis=1) / count
        empty = np.bincount(part, minlength=size) == 0
        if empty.any():
            at = self.middle_ns.ravel()[empty]
            mean[empty] = np.stack([np.interp(at, time_ns, v) for v in values.T], axis=1)
        return mean.reshape(len(self), self.parts, values.shape[1])

    def middle(self, time_ns: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Samples (n, d) in the middle of each part, (m, parts, d), with as little noise as their mean has.

        Taylor: mean = v + v' <t> + v'' <t^2> / 2 over the times t of the samples from the middle; v' and v'' come from
        the means of the neighbouring parts.
        """
        mean = self.mean(time_ns, values).reshape(-1, values.shape[1])
        off = (time_ns - self.middle_ns.ravel()[self.part_of(time_ns)])[:, None] * 1e-9
        first, second = self.mean(time_ns, np.hstack([off, off**2 / 2.0])).reshape(-1, 2).T
        time = self.middle_ns.ravel() * 1e-9
        slope = np.gradient(mean, time, axis=0)
        bend = np.gradient(slope, time, axis=0)
        return (mean - slope * first[:, None] - bend * second[:, None]).reshape(len(self), self.parts, -1)


def cubic_coefficients(time_ns: np.ndarray, value: np.ndarray, rate: np.ndarray | None) -> np.ndarray:
    """c, v, a, j of c + v t + a t^2 / 2 + j t^3 / 6 on each segment, (m, 4, d).

    The Hermite cubics through values (m + 1, d) with rates (m + 1, d); straight lines where there are no rates.
    """
    step = (np.diff(time_ns) * 1e-9)[:, None]
    move = np.diff(value, axis=0) / step
    if rate is None:
        return np.stack([value[:-1], move, np.zeros_like(move), np.zeros_like(move)], axis=1)
    first, last = rate[:-1], rate[1:]
    bend = (6.0 * move - 4.0 * first - 2.0 * last) / step
    jerk = 6.0 * (first + last - 2.0 * move) / step**2
    return np.stack([value[:-1], first, bend, jerk], axis=1)
