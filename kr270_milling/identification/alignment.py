"""Two series of the same thing on two clocks: the lag between them, and how much larger one is than the other."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import fftconvolve

from kr270_milling.base.errors import MillingError

__all__ = ["Line", "NoOverlapError", "best_lag", "line_through", "resampled", "smoothed"]

LEAST_OVERLAP = 0.6  #: share of the shorter series that both must have in common
LEAST_LIKENESS = 0.5  #: below it two series are not of the same pass


class NoOverlapError(MillingError):
    """The series do not resemble each other at any lag."""

    def __init__(self, what: str, likeness: float):
        self.what, self.likeness = what, likeness
        super().__init__(
            f"the measured {what} does not resemble the simulated one at any lag (best correlation {likeness:.2f}): "
            "check the topic, the axes of the sensor and the cell"
        )


@dataclass(frozen=True)
class Line:
    """measured = gain * simulated + offset, by least squares."""

    gain: float
    gain_sigma: float
    offset: float
    residual: float  #: root mean square


def resampled(time: np.ndarray, values: np.ndarray, step: float) -> np.ndarray:
    """On an even grid from the first to the last time, (m, columns)."""
    grid = time[0] + step * np.arange(int((time[-1] - time[0]) / step + 1e-9) + 1)
    return np.stack([np.interp(grid, time, column) for column in values.T], -1)


def smoothed(values: np.ndarray, count: int) -> np.ndarray:
    """Moving mean over ``count`` samples, the same length; the ends are means of fewer."""
    kernel = np.ones((max(1, count), 1))
    weight = fftconvolve(np.ones((len(values), 1)), kernel, "same", axes=0)
    return fftconvolve(values, kernel, "same", axes=0) / weight


def best_lag(measured: np.ndarray, simulated: np.ndarray, same_size: bool) -> tuple[int, float]:
    """Samples by which the simulation must be shifted to lie on the measurement, and their correlation there.

    measured (n, k), simulated (m, k), one step. same_size: the sum of squared differences decides, as for places;
    else the coefficient sum(m s) / sqrt(sum m^2 sum s^2) over the overlap, which does not mind a gain.
    """
    product = _slide(measured, simulated)
    squares_m = _slide(measured**2, np.ones_like(simulated))
    squares_s = _slide(np.ones_like(measured), simulated**2)
    overlap = _slide(np.ones((len(measured), 1)), np.ones((len(simulated), 1)))
    likeness = product / np.sqrt(np.maximum(squares_m * squares_s, 1e-300))
    score = -(squares_m + squares_s - 2 * product) / np.maximum(overlap, 1.0) if same_size else likeness
    enough = overlap > LEAST_OVERLAP * min(len(measured), len(simulated))
    place = int(np.argmax(np.where(enough, score, -np.inf)))
    return place - (len(simulated) - 1), float(likeness[place])


def _slide(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """sum_i a[i + lag] b[i] over columns, for lags from -(len(b) - 1) to len(a) - 1."""
    return fftconvolve(a, b[::-1], axes=0).sum(1)


def line_through(measured: np.ndarray, simulated: np.ndarray, independent: int) -> Line:
    """One gain and one offset of (n,) numbers; independent: how many of them count as such (they are smoothed)."""
    a = np.column_stack([simulated, np.ones_like(simulated)])
    (gain, offset), *_ = np.linalg.lstsq(a, measured, rcond=None)
    left = measured - a @ [gain, offset]
    spread = np.sum((simulated - simulated.mean()) ** 2) * independent / len(simulated)
    sigma = np.sqrt(np.mean(left**2) / max(spread, 1e-300))
    return Line(float(gain), float(sigma), float(offset), float(np.sqrt(np.mean(left**2))))
