"""The tolerance quantity of a pass, and whether the pass keeps the part within its tolerance.

Along a tool path the quantity is the largest wall or floor error that remains on the part. A straight cut has no part:
the quantity is the largest path deviation.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from kr270_milling.base.column import CONVERGED, as_dict, column, computed
from kr270_milling.cell.cell import Cell
from kr270_milling.cell.jobs import ScoredPass
from kr270_milling.cell.models import path_of, program_path
from kr270_milling.cell.sections import Tolerances
from kr270_milling.decide.part.assessment import PartAssessment, assess, assess_result
from kr270_milling.decide.part.surface import ideal_part, stations_of
from kr270_milling.physics.motion.milling_pass import SERIES, PassResult
from kr270_milling.physics.motion.scores import path_deviation

SURFACE_ERROR, PATH_DEVIATION = "largest wall or floor error", "largest path deviation"
NORMAL_ERROR = "largest surface error"  #: of a part that an end leaves that is not flat


@dataclass(frozen=True)
class Judgement:
    """Largest errors that a pass leaves [m], and whether they are allowed."""

    wall: float = column("wall_um", 1e6)  #: NaN without a wall
    floor: float = column("floor_um", 1e6)  #: NaN without a floor
    passes: bool | None = column("passes_tolerance")  #: None without a tolerance
    error: float = column("deciding_error_um", 1e6)  #: farthest beyond its tolerance, else nearest to it
    tolerance: float = column("")  #: [m], limit of ``error``; 0 without a tolerance
    feature: str | None = column("feature")  #: place of ``error``
    quantity: str = column("quantity", default=SURFACE_ERROR)  #: name of ``error``
    surface: float = column("surface_um", 1e6, default=math.nan)  #: along the normal; NaN with walls and floors

    @computed("tolerance_um", 1e6)
    def _limit(self) -> float | None:
        return self.tolerance or None

    @property
    def share(self) -> float:
        """The deciding error as a share of its tolerance; NaN without a tolerance."""
        return self.error / self.tolerance if self.tolerance else np.nan

    @property
    def words(self) -> str:
        """Return one sentence."""
        return self.sentence()

    def sentence(self, where: str = "") -> str:
        """Quantity, tolerance and error; where: of what pass, for example "on the model"."""
        error, place = um_text(self.error), f" {where}" if where else ""
        if math.isnan(self.error):
            return f"not judged: no milled wall or floor that could be measured{place}"
        if self.passes is None:
            return f"{self.quantity} is {error}{place}"
        feature = f" at {self.feature}" if self.feature and not self.passes else ""
        word = "meets" if self.passes else "misses"
        return f"{self.quantity} {word} {um_text(self.tolerance)}{place} ({error}{feature})"


def um_text(length: float) -> str:
    """A length [m] in micrometres: three digits, from 1 mm on whole micrometres, below ``CONVERGED`` "< 0.1 um"."""
    if abs(length) < CONVERGED:
        return f"< {1e6 * CONVERGED:.1g} um"
    return f"{1e6 * length:.0f} um" if length >= 1e-3 else f"{1e6 * length:.3g} um"


Gauge = Callable[[PassResult], Judgement]  #: judges a pass along a target


def gauge_of(cell: Cell) -> Gauge:
    """Return the function that judges passes along the target of a cell, of that cell and of its plants.

    It sweeps the part of the rigid arm once. ``heights`` of a pass spare a sweep of its workpiece.
    """
    path = path_of(cell)
    if path.straight:
        return lambda result: _judge_straight_cut(cell, result, _largest_deviation(cell, result))
    stamps = path.clock.stamp(np.arange(path.clock.steps(path.target.duration_ns) + 1))
    along = stations_of(path, stamps)
    ideal = ideal_part(cell, along, path.target.sample(stamps))
    return lambda result: judge_part(cell.tolerances, assess_result(cell, "", result, ideal, along))


def judge(cell: Cell, ran: ScoredPass, part: PartAssessment | None = None) -> Judgement:
    """The pass of a tool path by what it leaves of the part, that of a straight cut by its deviation.

    part: its assessment, if it is known already.
    """
    if path_of(cell).straight:
        return _judge_straight_cut(cell, ran.result, ran.scores.max_deviation)
    return judge_part(cell.tolerances, part or assess(cell, ran))


def after_passes(cell: Cell, ran: ScoredPass) -> list[dict]:
    """Judge the part after each pass along the same path, ``compensation.finish``; empty without such passes.

    A row has number, end [s] and largest force of the pass, and the keys of the judgement of the part that it leaves.
    """
    timed, passes = path_of(cell).timed, cell.compensation.finish
    if not passes or timed is None:
        return []
    length = program_path(cell).length
    ends = length + np.arange(passes + 1) * (timed.toolpath.length - length) / passes
    result, rows, first = ran.result, [], 0
    counts = np.searchsorted(timed.distance_at(result.time_ns), ends - 1e-9) + 1
    for number, count in enumerate(np.minimum(counts, len(result.time_ns)).tolist(), 1):
        part = {name: getattr(result, name)[:count] for name in SERIES}
        left = assess_result(cell, ran.name, replace(result, **part, heights=None))
        force = float(left.force[first:].max(initial=0.0))
        about = {"pass": number, "end_s": float(result.time[count - 1]), "max_force_n": force}
        rows.append(about | as_dict(judge_part(cell.tolerances, left)))
        first = count
    return rows


def judge_part(tolerances: Tolerances, part: PartAssessment) -> Judgement:
    """Walls, floors and surfaces of every feature against its own tolerance; a surface against the smaller one."""
    rows: list[tuple[float, float, str | None]] = []
    for row in part.rows:
        wall, floor = tolerances.of(row.name)
        least = min(filter(None, (wall, floor)), default=0.0)
        rows += [(row.max_wall, wall, row.name), (row.max_floor, floor, row.name), (row.max_surface, least, row.name)]
    whole = part.whole
    quantity = SURFACE_ERROR if math.isnan(whole.max_surface) else NORMAL_ERROR
    return replace(_judge(whole.max_wall, whole.max_floor, rows, quantity), surface=whole.max_surface)


def _largest_deviation(cell: Cell, result: PassResult) -> float:
    """Largest path deviation [m] from full engagement on, as in the scores of a straight cut."""
    scored = result.time >= path_of(cell).full_engagement - 1e-9
    scored[-1] = True
    feed = path_of(cell).target.sample_velocity(result.time_ns)
    return float(np.abs(path_deviation(result.actual, result.target, feed)[scored]).max())


def _judge_straight_cut(cell: Cell, result: PassResult, largest: float) -> Judgement:
    """The fully engaged part: its side is the wall, its height the floor; largest: deviation to the side [m]."""
    engaged = result.time >= path_of(cell).full_engagement - 1e-9
    floor = float(np.max(np.abs((result.actual - result.target)[engaged, 2]), initial=0.0))
    wall_tolerance, floor_tolerance = cell.tolerances.of()
    rows = [(largest, wall_tolerance, None), (floor, floor_tolerance, None)]
    return _judge(largest, floor, rows, PATH_DEVIATION)


def _judge(wall: float, floor: float, rows: Sequence[tuple[float, float, str | None]], quantity: str) -> Judgement:
    """rows: error, tolerance, feature."""
    rows = [row for row in rows if not np.isnan(row[0])]
    judged = [row for row in rows if row[1] > 0.0]
    if not judged:
        error, _, feature = max(rows, key=lambda row: row[0], default=(np.nan, 0.0, None))
        return Judgement(wall, floor, None, error, 0.0, feature, quantity)
    error, tolerance, feature = max(judged, key=lambda row: row[0] / row[1])
    return Judgement(wall, floor, bool(error <= tolerance), error, tolerance, feature, quantity)
