"""Places along a pass that all pictures share: so few that a page can hold them, so many that no maximum is lost."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

__all__ = ["BUCKETS", "envelope_index", "stations"]

BUCKETS = 500  #: along a series; a picture of some 900 pixels shows no more


def envelope_index(y: np.ndarray, buckets: int = BUCKETS) -> np.ndarray:
    """Rows of y (n,) that a picture of it needs: smallest and largest of each bucket, and both ends, in their order.

    At most 2 * buckets + 2 rows; every extremum of a bucket stays. NaN count as no value.
    """
    y = np.asarray(y, float)
    if y.size <= 2 * buckets + 2:
        return np.arange(y.size)
    edges = np.linspace(0, y.size, buckets + 1).astype(int)
    starts = edges[:-1]
    bucket = np.repeat(np.arange(buckets), np.diff(edges))
    rows = [np.array([0, y.size - 1])]
    for reduce, filler in ((np.minimum, np.inf), (np.maximum, -np.inf)):
        filled = np.where(np.isnan(y), filler, y)
        best = reduce.reduceat(filled, starts)
        first = np.flatnonzero(filled == best[bucket])
        rows.append(first[np.unique(bucket[first], return_index=True)[1]])
    return np.unique(np.concatenate(rows))


def stations(series: Sequence[np.ndarray], most: int = 2000) -> np.ndarray:
    """Rows, ascending, that serve several series (n,) at once: their envelopes joined, at most about ``most`` rows.

    All rows where there are no more than ``most``. The overall extrema of every series are always among them.
    """
    size = len(series[0])
    if size <= most:
        return np.arange(size)
    even = np.linspace(0, size - 1, most // 3).astype(int)
    buckets = max(16, most // (3 * len(series)))
    return np.unique(np.concatenate([even, *(envelope_index(y, buckets) for y in series)]))
