"""Check that the exchange between arm and cut was fine enough in a simulated pass."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kr270_milling.cell.jobs import ScoredPass
from kr270_milling.cell.paths import CellPath
from kr270_milling.decide.findings import Violation, violation

__all__ = ["ExchangeShare", "exchange_share"]


WINDOW = 0.1  #: [s], over which the corrections of the mean force count: one period corrects the next


@dataclass(frozen=True)
class ExchangeShare:
    """The largest correction of a predicted pose, by which the chip geometry of one period was wrong."""

    share: float  #: share of the scale
    scale: str  #: name of the length that the corrections are compared with
    warn: float  #: share above which it is reported
    stop: float  #: share above which the pass has no meaning
    point: int  #: number of the next point of the path, from 1
    period: str  #: key of the exchange period of this model of the cut

    @property
    def text(self) -> str:
        """Return one line."""
        above = f": above {100 * self.warn:g} %, use a shorter {self.period}" if self.share > self.warn else ""
        return (
            f"exchange: largest correction of a predicted pose is {100 * self.share:.1f} % of the {self.scale}{above}"
        )

    def violations(self) -> list[Violation]:
        """A stop where the share is above its limit."""
        if self.share <= self.stop:
            return []
        return [violation("exchange", self.share, self.stop, self.point, scale=self.scale)]


def exchange_share(path: CellPath, ran: ScoredPass) -> ExchangeShare:
    """Return the largest correction of the poses that the arm predicted in a pass, as a share of the chip's length.

    The sweep of the teeth compares each correction with the feed per tooth. The mean force compares the root mean
    square over WINDOW with the feed of a period, or with that of a tooth where this is longer: material that one period
    missed is removed in the next, so that a single step of the force, as at an entry, changes one period alone.
    """
    scale = path.feed_rate * 2.0 * np.pi / (path.tool.spindle_speed * path.tool.teeth)
    correction, name, period = ran.result.correction, "feed per tooth", "exchange.period_ms"
    if not path.by_teeth:
        periods = max(1, round(WINDOW / path.exchange.period))
        correction = np.sqrt(np.convolve(correction**2, np.full(periods, 1.0 / periods), mode="same"))
        name, period = "feed per tooth or period, over 0.1 s", "exchange.engagement_period_ms"
        scale = max(scale, path.feed_rate * path.exchange.period)
    k = int(np.argmax(correction))
    point = int(np.searchsorted(ran.reference.time_ns, ran.result.time_ns[min(k, len(ran.result.time_ns) - 1)])) + 1
    share = float(correction[k]) / scale
    return ExchangeShare(share, name, path.exchange.warn_correction, path.exchange.stop_correction, point, period)
