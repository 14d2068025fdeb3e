"""The correction as a function of the place on the path: progress, limits and ramps.

The progress is the projection of the commanded point onto the programmed path, in a window ahead of the last progress.
Override changes and stops therefore do not shift the correction, and a path may cross itself.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kr270_milling.base.errors import InputError
from kr270_milling.base.table import Table, read_table
from kr270_milling.live.rsi.telegram import UNITS
from kr270_milling.path.toolpath import PathProgress

SHIFT = ("dX_mm", "dY_mm", "dZ_mm", "dA_deg", "dB_deg", "dC_deg")
PLACE = ("X_mm", "Y_mm", "Z_mm")
MISSED = 3  #: cycles without a telegram after which the correction starts from zero


@dataclass(frozen=True, eq=False)
class CorrectionTable:
    """The programmed path and its correction at the same places."""

    time: np.ndarray  #: [s], (n,)
    position: np.ndarray  #: [m], (n, 3), in $BASE
    correction: np.ndarray  #: X, Y, Z [m], A, B, C [rad], (n, 6), absolute, in $BASE


def read_corrections(path) -> CorrectionTable:
    """Read a table of RSI offsets with the places X_mm, Y_mm, Z_mm, as ``compensate`` writes it; raise InputError."""
    table: Table = read_table(path, ("time_s", *SHIFT, *PLACE), ("time_s", *SHIFT, *PLACE), whole=True)
    time = table.number("time_s")
    table.refuse(np.diff(time, prepend=-np.inf) <= 0.0, "time_s must increase")
    result = CorrectionTable(time, 1e-3 * table.numbers(PLACE), UNITS * table.numbers(SHIFT))
    if len(time) < 2 or not np.any(np.diff(result.position, axis=0)):
        raise InputError(path, "needs two different places")
    return result


class Corrector:
    """Progress on the path, and the correction to apply in each cycle. One object serves one run of the program.

    cycle: 0.004 or 0.012 [s]; size, angle, rate: limits of the displacement [m], of the rotation [rad], and of the
    change of the displacement [m/s], to which that of the rotation is in proportion; ramp: time [s] from no correction
    to the full one; reach: no correction farther from the path [m].
    """

    def __init__(
        self,
        table: CorrectionTable,
        cycle: float,
        size: float = 1e-3,
        angle: float = float(np.radians(0.5)),
        rate: float = 20e-3,
        ramp: float = 0.2,
        reach: float = 1e-3,
    ):
        self.path = path = PathProgress(table.position, reach)
        self._value = np.append(table.correction[:-1][path.moved[1:]], table.correction[-1:], axis=0)  # last of a rest
        self.angle = angle
        self._size, self._ramp, self._share_of_size = size, cycle / ramp, cycle * rate / size  # in a cycle
        self.applied = np.zeros(6)
        self.share = 0.0  #: applied share of the wanted correction, 0 to 1
        self.reason = "waiting for the start of the path"  #: why the correction is what it is
        self.limited = 0  #: cycles in which a limit reduced the correction
        self._started = False

    def step(self, point: np.ndarray, cycles: int = 1) -> np.ndarray:
        """Return the correction (6,) for the commanded point [m], (3,); cycles: since the last telegram."""
        path = self.path
        distance = path.advance(point)
        missed = cycles > MISSED
        near = distance <= path.reach
        if missed:
            self.share, self.reason = 0.0, f"{cycles - 1} cycles without a telegram"
        elif near:
            self._started = True
            self.reason = "end of the path" if path.progress >= path.length else "on the path"
        elif self._started:
            self.reason = f"{1e3 * distance:.1f} mm from the path"
        change = self._ramp if near and not missed else -self._ramp
        self.share = min(max(self.share + change, 0.0), 1.0)
        way = path.distance
        index = int(np.clip(np.searchsorted(way, path.progress, side="right") - 1, 0, len(way) - 2))
        part = (path.progress - way[index]) / (way[index + 1] - way[index])
        self.applied = self._limit(self.share * ((1.0 - part) * self._value[index] + part * self._value[index + 1]))
        return self.applied

    def _limit(self, wanted: np.ndarray) -> np.ndarray:
        """Bound the size, then the change since the last cycle, separately for the displacement and the angles."""
        result, reduced = np.empty(6), False
        for part, most in ((slice(0, 3), self._size), (slice(3, 6), self.angle)):
            bounded = _shortened(wanted[part], most)
            change = _shortened(bounded - self.applied[part], most * self._share_of_size)
            result[part] = self.applied[part] + change
            reduced |= bool(np.abs(result[part] - wanted[part]).max() > 1e-9)
        self.limited += reduced
        return result


def _shortened(vector: np.ndarray, most: float) -> np.ndarray:
    size = float(np.linalg.norm(vector))
    return vector if size <= most else vector * (most / size)
