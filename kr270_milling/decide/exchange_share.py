"""Check that the exchange between arm and cut was fine enough in a simulated pass."""

from __future__ import annotations

import numpy as np

from kr270_milling.cell.jobs import ScoredPass
from kr270_milling.cell.paths import CellPath
from kr270_milling.cell.sections import Tolerances
from kr270_milling.decide.findings import Finding, violation

WINDOW = 0.1  #: [s], over which the corrections of the mean force count: one period corrects the next
NEGLIGIBLE = 0.05  #: share of the tolerance: a smaller correction is no stop, however slow the feed, as in a plunge


def exchange_share(path: CellPath, ran: ScoredPass, tolerances: Tolerances) -> tuple[float, str, list[Finding]]:
    """Return the largest correction of a predicted pose as a share of the length of the chip, its line, and findings.

    By the correction the chip geometry of one period was wrong. A share above its limit is a stop, unless the
    correction is NEGLIGIBLE.
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
    share, warn, stop = float(correction[k]) / scale, path.exchange.warn_correction, path.exchange.stop_correction
    above = f": above {100 * warn:g} %, use a shorter {period}" if share > warn else ""
    text = f"exchange: largest correction of a predicted pose is {100 * share:.1f} % of the {name}{above}"
    tolerance = min(filter(None, tolerances.of()), default=0.0)
    if share <= stop or correction[k] <= NEGLIGIBLE * tolerance:
        return share, text, []
    point = int(np.searchsorted(ran.reference.time_ns, ran.result.time_ns[min(k, len(ran.result.time_ns) - 1)])) + 1
    return share, text, [violation("exchange", share, stop, point, scale=name)]
