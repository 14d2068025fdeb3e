"""Passes in a series of stamps."""

from __future__ import annotations

import bisect
from collections.abc import Sequence

__all__ = ["PassCounter"]


class PassCounter:
    """Counts the passes in a series of stamps [ns]: a pass begins at a start, or when the stamp returns to 0."""

    def __init__(self, starts: Sequence[int] = ()):
        self.number, self._last = 0, 0
        self._returns = 0
        self._starts = starts

    def begins(self, stamp: int) -> bool:
        last, self._last = self._last, stamp
        if last <= 0:
            return False
        returned = stamp == 0 and (not self._starts or self._starts[0] == 0)
        again = returned or (bool(self._starts) and self._passed(stamp) > self._passed(last))
        self.number += again
        self._returns += returned
        return again

    @property
    def index(self) -> int:
        """Number of the pass among all starts, also where the first passes have no stamp in the series."""
        return self._returns + self._passed(self._last)

    def _passed(self, stamp: int) -> int:
        """Number of starts up to a stamp."""
        return bisect.bisect_right(self._starts, stamp)
