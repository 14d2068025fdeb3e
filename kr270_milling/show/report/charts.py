"""Charts as data: curves on panels, with what is marked on them, and how a long series is thinned for a picture.

The page draws them; here are only numbers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

BUCKETS = 500  #: along a series; a picture of some 900 pixels shows no more


@dataclass(frozen=True, eq=False)
class Curve:
    """colour: number of the series, 0 is the original pass; look: "", "thin", "dash", "points" or "area"."""

    name: str
    x: np.ndarray
    y: np.ndarray
    colour: int = 0
    look: str = ""
    text: str = ""  #: at the last point
    legend: bool = True


@dataclass(frozen=True, eq=False)
class Panel:
    """Pair of axes."""

    x_label: str
    y_label: str
    curves: Sequence[Curve]
    title: str = ""
    x_range: tuple[float, float] | None = None
    y_range: tuple[float, float] | None = None
    log: bool = False
    equal: bool = False  #: both axes have the same scale
    shade: tuple[float, float] | None = None  #: stretch of x that is shaded
    uprights: Sequence[tuple[float, str]] = ()  #: marked places of x
    levels: Sequence[tuple[float, str]] = ()  #: marked heights


@dataclass(frozen=True, eq=False)
class Chart:
    """name: of its element on the page; of_paper: the figure of the paper that it corresponds to, or ""."""

    name: str
    title: str
    of_paper: str
    caption: str
    panels: Sequence[Panel]
    columns: int = 1  #: columns of panels, where the screen is wide


def curve(name: str, x, y, colour: int = 0, look: str = "", **more) -> Curve:
    """A series of any length, thinned without loss of extrema."""
    rows = envelope_index(y)
    return Curve(name, np.asarray(x)[rows], np.asarray(y)[rows], colour, look, **more)


def envelope_index(y: np.ndarray, buckets: int = BUCKETS) -> np.ndarray:
    """Rows of y (n,) that a picture of it needs: smallest and largest of each bucket, and both ends, in their order.

    At most 2 * buckets + 2 rows; every extremum of a bucket stays. NaN count as no value.
    """
    y = np.asarray(y, float)
    if y.size <= 2 * buckets + 2:
        return np.arange(y.size)
    edges = np.linspace(0, y.size, buckets + 1).astype(int)
    bucket = np.repeat(np.arange(buckets), np.diff(edges))
    rows = [np.array([0, y.size - 1])]
    for reduce, filler in ((np.minimum, np.inf), (np.maximum, -np.inf)):
        filled = np.where(np.isnan(y), filler, y)
        first = np.flatnonzero(filled == reduce.reduceat(filled, edges[:-1])[bucket])
        rows.append(first[np.unique(bucket[first], return_index=True)[1]])
    return np.unique(np.concatenate(rows))


def stations(series: Sequence[np.ndarray], most: int = 2000) -> np.ndarray:
    """Rows, ascending, that serve several series (n,) at once: their envelopes joined, about ``most`` rows at most.

    All rows where there are no more. The overall extrema of every series are always among them.
    """
    size = len(series[0])
    if size <= most:
        return np.arange(size)
    even = np.linspace(0, size - 1, most // 3).astype(int)
    buckets = max(16, most // (3 * len(series)))
    return np.unique(np.concatenate([even, *(envelope_index(y, buckets) for y in series)]))


def moving_mean(values: np.ndarray, window: int) -> np.ndarray:
    """Centred mean over ``window`` rows of values (n,); at the ends over the rows that exist."""
    ones = np.ones(max(1, min(window, values.size)))
    return np.convolve(values, ones, "same") / np.convolve(np.ones(values.size), ones, "same")


def amplitude_spectrum(values: np.ndarray, step: float) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies [Hz] and single-sided amplitudes of values (n,) sampled every ``step`` [s].

    The mean is removed, the window is Hann's. A sine of amplitude a at a frequency of the list shows as a.
    """
    window = np.hanning(values.size + 1)[:-1]
    amplitude = np.abs(np.fft.rfft((values - values.mean()) * window)) * 2.0 / max(window.sum(), 1e-300)
    return np.fft.rfftfreq(values.size, step)[1:], amplitude[1:]


def thinned_spectrum(
    frequency: np.ndarray, amplitude: np.ndarray, high: float, bins: int = BUCKETS
) -> tuple[np.ndarray, np.ndarray]:
    """Up to ``high`` [Hz], the largest amplitude of each bin of a logarithmic axis: no line of the spectrum is lost."""
    inside = frequency <= high
    frequency, amplitude = frequency[inside], amplitude[inside]
    if frequency.size <= bins:
        return frequency, amplitude
    place = np.log(frequency / frequency[0]) / np.log(frequency[-1] / frequency[0])
    number = np.minimum((place * bins).astype(int), bins - 1)
    order = np.lexsort((-amplitude, number))
    first = order[np.unique(number[order], return_index=True)[1]]
    return frequency[first], amplitude[first]
