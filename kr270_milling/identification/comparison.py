"""A measured pass beside the simulated one: force, place of the tool, deviation, and what to identify anew."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kr270_milling.base.errors import InputError
from kr270_milling.identification.alignment import (
    LEAST_LIKENESS,
    Line,
    NoOverlapError,
    best_lag,
    line_through,
    resampled,
    smoothed,
)
from kr270_milling.simulation.scores import path_deviation, ringing_frequency

__all__ = ["Channel", "Comparison", "Pass", "compare"]

AGREES = 0.1  #: gains within it need no new identification: coefficients scatter by as much from batch to batch
RINGS_ALIKE = 0.05  #: share of the frequency
SURE = 2.0  #: standard deviations


@dataclass(frozen=True, eq=False)
class Pass:
    """Series of one pass; workpiece axes. Of a measured pass each has a clock of its own, and may be None."""

    force_time: np.ndarray | None  #: [s], (n,)
    force: np.ndarray | None  #: on the tool [N], (n, 3)
    tool_time: np.ndarray | None  #: [s], (m,)
    tool: np.ndarray | None  #: tool centre [m], (m, 3)

    def forces(self) -> tuple[np.ndarray, np.ndarray]:
        """Times and forces; raises InputError where there are none."""
        return _both("forces", self.force_time, self.force)

    def places(self) -> tuple[np.ndarray, np.ndarray]:
        """Times and tool centres; raises InputError where there are none."""
        return _both("places of the tool", self.tool_time, self.tool)


def _both(what: str, time: np.ndarray | None, values: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    if time is None or values is None:
        raise InputError("compare", f"there are no {what} to compare with")
    return time, values


@dataclass(frozen=True, eq=False)
class Channel:
    """One quantity, both on the clock of the simulation."""

    name: str
    unit: str
    time: np.ndarray  #: [s], (n,)
    measured: np.ndarray  #: (n,)
    simulated: np.ndarray  #: (n,)
    line: Line  #: of the series smoothed over a revolution


@dataclass(frozen=True, eq=False)
class Comparison:
    """What differs, and what to do."""

    channels: list[Channel]
    lags: dict[str, float]  #: [s] of the measured clock behind the simulated one, "force" and "pose"
    ringing: dict[str, tuple[float, float]]  #: frequency [Hz] and damping ratio, "measured" and "simulated"
    advice: list[str]


def compare(measured: Pass, simulated: Pass, target, feed, revolution: float) -> Comparison:
    """target (m, 3) [m] and feed (m, 3) of the simulated tool's times; revolution [s] of the spindle.

    Raises InputError without a measured series, NoOverlapError for one of another pass.
    """
    channels: list[Channel] = []
    lags, ringing = {}, {}
    if measured.force is not None:
        lags["force"], found = _forces(measured, simulated, revolution)
        channels += found
    if measured.tool is not None:
        lags["pose"], time, place = _places(measured, simulated)
        inside = np.isfinite(place).all(1)
        ours = path_deviation(simulated.places()[1], target, feed)[inside]
        theirs = path_deviation(place, target, feed)[inside]
        channels.append(_channel("deviation", "m", time[inside], theirs, ours, revolution))
        ringing = {
            "measured": ringing_frequency(time[inside], smoothed(theirs[:, None], _count(time, revolution))[:, 0]),
            "simulated": ringing_frequency(time[inside], smoothed(ours[:, None], _count(time, revolution))[:, 0]),
        }
    if not channels:
        raise InputError("compare", "the recording has neither a force nor a place of the tool to compare")
    return Comparison(channels, lags, ringing, advice(channels, ringing))


def _count(time: np.ndarray, revolution: float) -> int:
    return max(1, round(revolution / float(np.median(np.diff(time)))))


def _forces(measured: Pass, simulated: Pass, revolution: float) -> tuple[float, list[Channel]]:
    (their_time, force), (our_time, our_force) = measured.forces(), simulated.forces()
    step = float(np.median(np.diff(our_time)))
    theirs, ours = resampled(their_time, force, step), resampled(our_time, our_force, step)
    lag, likeness = best_lag(theirs, ours, same_size=False)
    if likeness < LEAST_LIKENESS:
        raise NoOverlapError("force", likeness)
    first, last = max(0, -lag), min(len(ours), len(theirs) - lag)
    time = our_time[0] + step * np.arange(first, last)
    pairs = zip("xyz", theirs[first + lag : last + lag].T, ours[first:last].T, strict=True)
    found = [_channel(f"force {axis}", "N", time, a, b, revolution) for axis, a, b in pairs if np.any(b)]
    return lag * step + float(their_time[0] - our_time[0]), found


def _places(measured: Pass, simulated: Pass) -> tuple[float, np.ndarray, np.ndarray]:
    """Lag [s], the simulated times, and the measured places at them, NaN where there are none."""
    (their_time, place), (our_time, our_place) = measured.places(), simulated.places()
    step = float(np.median(np.diff(our_time)))
    theirs, ours = resampled(their_time, place, step), resampled(our_time, our_place, step)
    middle = ours.mean(0)  # squares of small numbers
    lag, likeness = best_lag(theirs - middle, ours - middle, same_size=True)
    if likeness < LEAST_LIKENESS:
        raise NoOverlapError("place of the tool", likeness)
    shift = lag * step + float(their_time[0] - our_time[0])
    columns = [np.interp(our_time + shift, their_time, c, np.nan, np.nan) for c in place.T]
    return shift, our_time, np.stack(columns, -1)


def _channel(name: str, unit: str, time, measured, simulated, revolution: float) -> Channel:
    count = _count(time, revolution)
    both = smoothed(np.column_stack([measured, simulated]), count)
    line = line_through(both[:, 0], both[:, 1], max(3, len(time) // count))
    return Channel(name, unit, time, np.asarray(measured), np.asarray(simulated), line)


def advice(channels: list[Channel], ringing: dict) -> list[str]:
    """What to identify anew, in sentences."""
    said = []
    largest = max((float(np.abs(c.simulated).mean()) for c in channels if c.unit == "N"), default=0.0)
    forces = [c for c in channels if c.unit == "N" and np.abs(c.simulated).mean() > 0.2 * largest]
    off = [c for c in forces if _differs(c.line, 1.0)]
    said += [f"{c.name} is {_gain(c.line)} times the simulated one: `identify forces`" for c in off]
    deviation = next((c for c in channels if c.name == "deviation"), None)
    if deviation is not None:
        weights = [float(np.abs(c.simulated).mean()) for c in forces]
        expected = float(np.average([c.line.gain for c in forces], weights=weights)) if forces else 1.0
        if _differs(deviation.line, expected):
            ratio = deviation.line.gain / expected
            cause = "`identify compliance`" if forces else "`identify compliance`, or forces, which were not measured"
            said.append(f"the deviation is {ratio:.2f} times what the measured forces explain: {cause}")
    if all(np.isfinite(values).all() for values in ringing.values()) and ringing:
        (ours, damping), (theirs, its) = ringing["simulated"], ringing["measured"]
        if abs(theirs / ours - 1.0) > RINGS_ALIKE or abs(its / damping - 1.0) > 0.5:
            said.append(
                f"the tool rings at {theirs:.2f} Hz with a damping ratio of {its:.3f}, simulated {ours:.2f} Hz and "
                f"{damping:.3f}: `identify damping`"
            )
    return said or ["measurement and simulation agree: nothing to identify anew"]


def _differs(line: Line, expected: float) -> bool:
    away = abs(line.gain - expected)
    return away > AGREES * max(expected, 0.1) and away > SURE * line.gain_sigma


def _gain(line: Line) -> str:
    return f"{line.gain:.2f} +- {SURE * line.gain_sigma:.2f}"
