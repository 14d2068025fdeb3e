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

__all__ = ["Channel", "Comparison", "Pass", "Series", "compare"]

AGREES = 0.1  #: gains within it need no new identification: coefficients scatter by as much from batch to batch
RINGS_ALIKE = 0.05  #: share of the frequency
SURE = 2.0  #: standard deviations


@dataclass(frozen=True, eq=False)
class Series:
    """Vectors over time, workpiece axes."""

    time: np.ndarray  #: [s], (n,)
    values: np.ndarray  #: (n, 3)


@dataclass(frozen=True, eq=False)
class Pass:
    """What is known of one pass; of a measured one each series has a clock of its own."""

    force: Series | None  #: on the tool [N]
    tool: Series | None  #: tool centre [m]


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
    if measured.force is not None and simulated.force is not None:
        lags["force"], found = _forces(measured.force, simulated.force, revolution)
        channels += found
    if measured.tool is not None and simulated.tool is not None:
        time = simulated.tool.time
        lags["pose"], place = _places(measured.tool, simulated.tool)
        inside = np.isfinite(place).all(1)
        ours = path_deviation(simulated.tool.values, target, feed)[inside]
        theirs = path_deviation(place, target, feed)[inside]
        channels.append(_channel("deviation", "m", time[inside], theirs, ours, revolution))
        both = {"measured": theirs, "simulated": ours}
        count = _count(time, revolution)
        ringing = {k: ringing_frequency(time[inside], smoothed(v[:, None], count)[:, 0]) for k, v in both.items()}
    if not channels:
        raise InputError("compare", "the recording has neither a force nor a place of the tool to compare")
    return Comparison(channels, lags, ringing, advice(channels, ringing))


def _count(time: np.ndarray, revolution: float) -> int:
    return max(1, round(revolution / float(np.median(np.diff(time)))))


def _shift(what: str, measured: Series, simulated: Series, middle: np.ndarray, same_size: bool):
    """Step [s], lag in steps and [s], and both on even grids, less ``middle``."""
    step = float(np.median(np.diff(simulated.time)))
    theirs, ours = (resampled(p.time, p.values, step) - middle for p in (measured, simulated))
    lag, likeness = best_lag(theirs, ours, same_size)
    if likeness < LEAST_LIKENESS:
        raise NoOverlapError(what, likeness)
    return step, lag, lag * step + float(measured.time[0] - simulated.time[0]), theirs, ours


def _forces(measured: Series, simulated: Series, revolution: float) -> tuple[float, list[Channel]]:
    step, lag, seconds, theirs, ours = _shift("force", measured, simulated, np.zeros(3), same_size=False)
    first, last = max(0, -lag), min(len(ours), len(theirs) - lag)
    time = simulated.time[0] + step * np.arange(first, last)
    pairs = zip("xyz", theirs[first + lag : last + lag].T, ours[first:last].T, strict=True)
    return seconds, [_channel(f"force {axis}", "N", time, a, b, revolution) for axis, a, b in pairs if np.any(b)]


def _places(measured: Series, simulated: Series) -> tuple[float, np.ndarray]:
    """Lag [s], and the measured places at the simulated times, NaN where there are none."""
    middle = simulated.values.mean(0)  # squares of small numbers
    seconds = _shift("place of the tool", measured, simulated, middle, same_size=True)[2]
    at = simulated.time + seconds
    columns = [np.interp(at, measured.time, c, np.nan, np.nan) for c in measured.values.T]
    return seconds, np.stack(columns, -1)


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
