"""Scores of one pass, Table 2: static deviation, largest deviation, low frequency."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from kr270_milling.base.column import column


@dataclass(frozen=True)
class Scores:
    """Path deviation is perpendicular to the feed, positive to its left seen from +z of the workpiece."""

    #: [m], mean over the last quarter of the pass; NaN for a tool path
    static_deviation: float = column("static_deviation_um", 1e6, "static deviation", "um", digits=2, short="static")
    #: [m], largest magnitude from full engagement on
    max_deviation: float = column("max_deviation_um", 1e6, "largest deviation", "um", digits=2, short="max")
    #: [Hz], lowest lateral mode of the model; NaN for a tool path
    low_frequency: float = column("low_frequency_hz", 1.0, "low frequency", "Hz", digits=2)
    #: [Hz], undamped, of the pass; NaN if the pass does not ring, or for a tool path
    ringing_frequency: float = column("ringing_frequency_hz", 1.0, "ringing of the pass", "Hz", digits=2)
    #: damping ratio of the ringing
    ringing_damping: float = column("", 1.0, "its damping ratio", digits=3)


def path_deviation(actual: np.ndarray, target: np.ndarray, feed: np.ndarray) -> np.ndarray:
    """[m], (n,): actual minus target tool centre (n, 3) [m], perpendicular to the feed (n, 3) in the cutting plane."""
    left = np.column_stack([-feed[:, 1], feed[:, 0]])
    length = np.linalg.norm(left, axis=1, keepdims=True)
    left = left / np.where(length > 0, length, 1.0)
    return np.sum((actual - target)[:, :2] * left, axis=1)


def ringing_frequency(time: np.ndarray, displacement: np.ndarray) -> tuple[float, float]:
    """Undamped frequency [Hz] and damping ratio of a decaying vibration about a mean, by least squares.

    time [s], (n,), uniform; displacement [m], (n,). NaN, NaN where less than a nanometre rings.
    """
    if time.size < 16:
        return np.nan, np.nan
    start, centred = time - time[0], displacement - displacement[-displacement.size // 4 :].mean()
    scale = np.abs(centred).max()
    if scale < 1e-9:
        return np.nan, np.nan
    spectrum = np.abs(np.fft.rfft(centred * np.exp(-3.0 * start / start[-1]), 8 * time.size))
    guess = np.fft.rfftfreq(8 * time.size, start[1])[1:][np.argmax(spectrum[1:])]

    def rest(p):
        rate, omega = p
        decay = np.exp(-rate * start)
        basis = np.column_stack([decay * np.cos(omega * start), decay * np.sin(omega * start), np.ones_like(start)])
        shape, *_ = np.linalg.lstsq(basis, centred / scale, rcond=None)
        return basis @ shape - centred / scale

    fit = least_squares(rest, [2.0 / start[-1], 2 * np.pi * guess], x_scale=[1.0, 2 * np.pi * guess])
    natural = float(np.hypot(fit.x[0], fit.x[1]))
    return natural / (2 * np.pi), float(fit.x[0]) / natural


def score(
    time, actual, target, feed, full_engagement: float, low_frequency: float, displacement, straight: bool = True
) -> Scores:
    """Scores of a pass at times (n,) [s]; full_engagement [s]; displacement (n,) [m] is searched for ringing.

    straight: one feed direction for the whole pass. The mean over a last quarter that turns corners and closes on
    itself says nothing, and its course is no vibration about a mean: such scores are NaN.
    """
    deviation = path_deviation(actual, target, feed)
    engaged = time >= full_engagement - 1e-9
    engaged[-1] = True  # a pass that ends before it is engaged is scored at the last row
    largest = float(np.max(np.abs(deviation[engaged])))
    if not straight:
        return Scores(np.nan, largest, low_frequency, np.nan, np.nan)
    static = float(np.mean(deviation[-max(1, deviation.size // 4) :]))
    return Scores(static, largest, low_frequency, *ringing_frequency(time[engaged], displacement[engaged]))
