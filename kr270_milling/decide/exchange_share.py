"""Whether the exchange between arm and cut was fine enough in a simulated pass."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kr270_milling.cell.cell import Cell
from kr270_milling.cell.jobs import ScoredPass
from kr270_milling.decide.findings import Violation, violation

__all__ = ["ExchangeShare", "exchange_share"]


@dataclass(frozen=True)
class ExchangeShare:
    """The largest correction of a predicted pose, by which the chip geometry of one period was wrong."""

    share: float  #: of the feed per tooth
    warn: float  #: share above which it is reported
    stop: float  #: share above which the pass has no meaning
    point: int  #: number of the next point of the path, from 1
    period: str  #: key of the exchange period of this model of the cut

    @property
    def text(self) -> str:
        """One line."""
        above = f": above {100 * self.warn:g} %, use a shorter {self.period}" if self.share > self.warn else ""
        return (
            f"exchange: largest correction of a predicted pose is {100 * self.share:.1f} % of the feed per tooth{above}"
        )

    def violations(self) -> list[Violation]:
        """A stop where the share is above its limit."""
        return [violation("exchange", self.share, self.stop, self.point)] if self.share > self.stop else []


def exchange_share(cell: Cell, ran: ScoredPass) -> ExchangeShare:
    """The largest correction of the poses that the arm predicted in a pass, as a share of the feed per tooth."""
    per_tooth = cell.feed_rate * 2.0 * np.pi / (cell.tool.spindle_speed * cell.tool.teeth)
    k = int(np.argmax(ran.result.correction))
    point = int(np.searchsorted(ran.reference.time_ns, ran.result.time_ns[k])) + 1
    share = float(ran.result.correction[k]) / per_tooth
    period = "exchange.engagement_period_ms" if cell.by_engagement else "exchange.period_ms"
    return ExchangeShare(share, cell.exchange.warn_correction, cell.exchange.stop_correction, point, period)
