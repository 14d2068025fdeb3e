"""Does a simulated pass chatter: what remains of the tool's motion from tooth to tooth.

Seen once a tooth period T, a stable cut repeats itself but for the slow swinging of the arm, whose fourth difference
over teeth is small: A (w T)^4 / 16 for a swing of amplitude A and circular frequency w, 0.02 % of it at 20 Hz and 533
teeth a second. A chattering cut does not repeat itself: its motion is no multiple of the tooth period and grows until
the teeth leave the material. What swings slower than a tenth of the tooth frequency is left to the deviation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kr270_milling.cell.cell import Cell
from kr270_milling.decision.findings import stretches
from kr270_milling.simulation.milling_pass import PassResult

__all__ = ["Stability", "stability_of"]

FEWEST_TEETH = 60  #: in one stretch of cutting; fewer say nothing about growth
CHATTERS = 0.02  #: share of the feed per tooth, root mean square
#: limit over grid step per feed per tooth; the grid makes a stable pocket ring by 0.016 to 0.019 of it (measured at
#: steps of 0.25 to 2.5 feeds per tooth), so that the factor is two
GRID_NOISE = 0.04
GROWS = 1.5  #: ratio of the last third of a straight cut to the middle one
SMALL = 0.001  #: share of the feed per tooth below which growth is numerical noise


@dataclass(frozen=True)
class Stability:
    """What a pass says about chatter."""

    word: str  #: "stable", "chatter" or "no statement"
    residue: float  #: root mean square from tooth to tooth, a share of the feed per tooth; NaN without a statement
    limit: float = CHATTERS  #: the same share, from which on it is chatter

    @property
    def text(self) -> str:
        """One line."""
        if self.word == "no statement":
            return f"stability: no statement, no cut of {FEWEST_TEETH} teeth without a break"
        share = f"{100 * self.residue:.2g}" if self.residue >= SMALL else f"less than {100 * SMALL:g}"
        return f"stability: {self.word}, from tooth to tooth {share} % of the feed per tooth remain"

    def as_dict(self) -> dict:
        """For JSON."""
        return {"word": self.word, "residue_share": self.residue, "limit_share": self.limit}


def stability_of(cell: Cell, result: PassResult) -> Stability:
    """Judge the worst stretch of cutting without a break; a straight cut also by whether its residue grows."""
    period = 2.0 * np.pi / (cell.tool.spindle_speed * cell.tool.teeth)
    feed_per_tooth = cell.feed_rate * period
    limit = max(CHATTERS, GRID_NOISE * cell.stock.grid_step / max(feed_per_tooth, 1e-12))
    worst, grows, seconds = np.nan, False, result.time
    for first, last in stretches(result.volume > 0.0):
        time = seconds[first:last]
        teeth = np.arange(time[0], time[-1], period)
        if teeth.size < FEWEST_TEETH:
            continue
        at_teeth = np.stack([np.interp(teeth, time, result.deflection[first:last, k]) for k in range(2)], 1)
        residue = np.linalg.norm(np.diff(at_teeth, 4, axis=0), axis=1) / 16.0  # a motion that alternates counts whole
        parts = [float(np.sqrt(np.mean(part**2))) / feed_per_tooth for part in np.array_split(residue, 3)]
        worst = np.fmax(worst, parts[2])
        grows |= not cell.path.file and parts[2] > SMALL and parts[2] > GROWS * parts[1]
    if np.isnan(worst):
        return Stability("no statement", np.nan, limit)
    return Stability("chatter" if grows or worst > limit else "stable", float(worst), limit)
