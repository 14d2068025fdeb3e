"""Does a pass keep the part within its tolerance: what remains on walls and floors against what is allowed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kr270_milling.cell.cell import Cell
from kr270_milling.cell.jobs import ScoredPass
from kr270_milling.decide.part.assessment import PartAssessment, assess

__all__ = ["Judgement", "judge", "judge_part"]


@dataclass(frozen=True)
class Judgement:
    """Largest errors that a pass leaves [m], and whether they are allowed."""

    wall: float  #: NaN where there is none
    floor: float  #: NaN where there is none
    passes: bool | None  #: None where no tolerance is asked for
    error: float  #: the one that decides: farthest beyond its tolerance, else nearest to it
    tolerance: float  #: [m] of that one; 0 where none is asked for
    feature: str | None  #: where it is

    def as_dict(self) -> dict:
        """For JSON."""
        return {
            "passes_tolerance": self.passes,
            "wall_um": 1e6 * self.wall,
            "floor_um": 1e6 * self.floor,
            "tolerance_um": 1e6 * self.tolerance if self.tolerance else None,
            "deciding_error_um": 1e6 * self.error,
            "feature": self.feature,
        }

    @property
    def words(self) -> str:
        """For the first line of the output."""
        if np.isnan(self.error):
            return "has no milled wall or floor to judge"
        if self.passes is None:
            return f"leaves {1e6 * self.error:.0f} um (part.tolerance_um says nothing)"
        where = f" at {self.feature}" if self.feature and not self.passes else ""
        word = "passes" if self.passes else "fails"
        return f"{word} ({1e6 * self.error:.0f} um against {1e6 * self.tolerance:.0f}{where})"


def judge(cell: Cell, ran: ScoredPass, part: PartAssessment | None = None) -> Judgement:
    """The pass of a tool path by what it leaves of the part, that of a straight cut by its deviation.

    part: its assessment, if it is known already.
    """
    return _judge_straight_cut(cell, ran) if cell.programmed.straight else judge_part(cell, part or assess(cell, ran))


def judge_part(cell: Cell, part: PartAssessment) -> Judgement:
    """Walls and floors of every feature against its own tolerance."""
    rows: list[tuple[float, float, str | None]] = []
    for row in part.rows:
        wall, floor = cell.part.of(row.name)
        rows += [(row.max_wall, wall, row.name), (row.max_floor, floor, row.name)]
    return _judge(part.whole.max_wall, part.whole.max_floor, rows)


def _judge_straight_cut(cell: Cell, ran: ScoredPass) -> Judgement:
    """The fully engaged part: its side is the wall, its height the floor."""
    result = ran.result
    engaged = result.time >= cell.full_engagement - 1e-9
    wall = ran.scores.max_deviation
    floor = float(np.max(np.abs((result.actual - result.target)[engaged, 2]), initial=0.0))
    return _judge(wall, floor, list(zip((wall, floor), cell.part.of(), (None, None), strict=True)))


def _judge(wall: float, floor: float, rows: list[tuple[float, float, str | None]]) -> Judgement:
    """rows: error, tolerance, feature."""
    rows = [row for row in rows if not np.isnan(row[0])]
    judged = [row for row in rows if row[1] > 0.0]
    if not judged:
        error, _, feature = max(rows, key=lambda row: row[0], default=(np.nan, 0.0, None))
        return Judgement(wall, floor, None, error, 0.0, feature)
    error, tolerance, feature = max(judged, key=lambda row: row[0] / row[1])
    return Judgement(wall, floor, bool(error <= tolerance), error, tolerance, feature)
