"""Compare a measured pass with the simulated pass: force, tool position, deviation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import fftconvolve

from kr270_milling.base.errors import InputError, ModelError
from kr270_milling.physics.motion.scores import path_deviation, ringing_frequency
from kr270_milling.studies.identification.signals import resampled

#: "force" on the tool [N] and "pose", its centre [m], as far as there are: times [s], (n,), and vectors in workpiece
#: axes, (n, 3); the series of a measured pass have separate clocks
ComparedSeries = dict[str, tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True)
class LinearFit:
    """measured = gain * simulated + offset, by least squares."""

    gain: float
    gain_sigma: float
    offset: float
    residual: float  #: root mean square


def _smoothed(values: np.ndarray, count: int) -> np.ndarray:
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
    least_overlap = 0.6  # share of the shorter series that both must have in common
    enough = overlap > least_overlap * min(len(measured), len(simulated))
    place = int(np.argmax(np.where(enough, score, -np.inf)))
    return place - (len(simulated) - 1), float(likeness[place])


def _slide(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """sum_i a[i + lag] b[i] over columns, for lags from -(len(b) - 1) to len(a) - 1."""
    return fftconvolve(a, b[::-1], axes=0).sum(1)


def line_through(measured: np.ndarray, simulated: np.ndarray, independent: int) -> LinearFit:
    """Gain and offset of (n,) numbers; independent: number of independent ones among them (they are smoothed)."""
    a = np.column_stack([simulated, np.ones_like(simulated)])
    (gain, offset), *_ = np.linalg.lstsq(a, measured, rcond=None)
    left = measured - a @ [gain, offset]
    spread = np.sum((simulated - simulated.mean()) ** 2) * independent / len(simulated)
    sigma = np.sqrt(np.mean(left**2) / max(spread, 1e-300))
    return LinearFit(float(gain), float(sigma), float(offset), float(np.sqrt(np.mean(left**2))))


@dataclass(frozen=True, eq=False)
class ComparedChannel:
    """A quantity, measured and simulated, on the clock of the simulation."""

    name: str
    unit: str
    time: np.ndarray  #: [s], (n,)
    measured: np.ndarray  #: (n,)
    simulated: np.ndarray  #: (n,)
    line: LinearFit  #: from the series smoothed over a revolution


def compare(
    measured: ComparedSeries, simulated: ComparedSeries, target, feed, revolution: float
) -> tuple[list[ComparedChannel], dict[str, float], dict[str, tuple[float, float]]]:
    """Return channels on one clock, lags of the measured clocks, and the ringing of both deviations.

    The lags [s] are those of the measured clock behind the simulated one, of "force" and "pose"; the ringing is
    frequency [Hz] and damping ratio, "measured" and "simulated".

    target (m, 3) [m] and feed (m, 3) of the simulated tool's times; revolution [s] of the spindle.

    Raises InputError without a measured series, ModelError for one of another pass.
    """
    channels: list[ComparedChannel] = []
    lags: dict[str, float] = {}
    ringing: dict[str, tuple[float, float]] = {}
    both = measured.keys() & simulated.keys()
    if "force" in both:
        time, ours = simulated["force"]
        lags["force"], force = _aligned("force", measured["force"], (time, ours), same_size=False)
        inside = np.isfinite(force).all(1)
        channels += [
            _channel(f"force {axis}", "N", time[inside], force[inside, k], ours[inside, k], revolution)
            for k, axis in enumerate("xyz")
            if np.any(ours[inside, k])
        ]
    if "pose" in both:
        time, centre = simulated["pose"]
        lags["pose"], place = _aligned("place of the tool", measured["pose"], (time, centre), same_size=True)
        inside, count = np.isfinite(place).all(1), _count(time, revolution)
        theirs = path_deviation(place, target, feed)[inside]
        ours = path_deviation(centre, target, feed)[inside]
        time = time[inside]
        channels.append(_channel("deviation", "m", time, theirs, ours, revolution))
        deviations = {"measured": theirs, "simulated": ours}
        ringing = {k: ringing_frequency(time, _smoothed(v[:, None], count)[:, 0]) for k, v in deviations.items()}
    if not channels:
        raise InputError("compare", "the recording has neither a force nor a place of the tool to compare")
    return channels, lags, ringing


def _count(time: np.ndarray, revolution: float) -> int:
    """Samples of a revolution."""
    return max(1, round(revolution / float(np.median(np.diff(time)))))


def _aligned(what: str, measured, simulated, same_size: bool) -> tuple[float, np.ndarray]:
    """Lag [s], and the measured vectors at the simulated times, (n, 3), NaN where there are none."""
    (measured_time, vectors), (time, values) = measured, simulated
    step = float(np.median(np.diff(time)))
    middle = values.mean(0) if same_size else 0.0  # squares of small numbers
    theirs, ours = (resampled(at, rows, step) - middle for at, rows in (measured, simulated))
    lag, likeness = best_lag(theirs, ours, same_size)
    least_likeness = 0.5  # below it two series are not of the same pass
    if likeness < least_likeness:
        raise ModelError(
            f"the measured {what} does not resemble the simulated one at any lag (best correlation {likeness:.2f}): "
            "check the topic, the axes of the sensor and the cell"
        )
    seconds = lag * step + float(measured_time[0] - time[0])
    at = time + seconds
    return seconds, np.stack([np.interp(at, measured_time, c, np.nan, np.nan) for c in vectors.T], -1)


def _channel(name: str, unit: str, time, measured, simulated, revolution: float) -> ComparedChannel:
    count = _count(time, revolution)
    both = _smoothed(np.column_stack([measured, simulated]), count)
    line = line_through(both[:, 0], both[:, 1], max(3, len(time) // count))
    return ComparedChannel(name, unit, time, measured, simulated, line)
