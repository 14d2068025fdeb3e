"""Results of a pass for the part, feature by feature: deviation, force, torque, power, surface errors, tolerance.

Along a tool path the tolerance quantity is the largest wall or floor error that remains on the part. A straight cut has
no part: the quantity is the largest path deviation.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from kr270_milling.base.column import CONVERGED, as_dict, column, computed
from kr270_milling.cell.cell import Cell
from kr270_milling.cell.jobs import ScoredPass, cut_along
from kr270_milling.cell.models import cut_of, path_of, program_path
from kr270_milling.cell.sections import Tolerances
from kr270_milling.decide.part.surface import (
    Floors,
    IdealPart,
    Stations,
    Walls,
    deviations,
    ideal_part,
    stations_of,
    surface,
)
from kr270_milling.physics.compensation.revision import PassRecord
from kr270_milling.physics.cutting import CutModel
from kr270_milling.physics.motion.milling_pass import SERIES, PassResult
from kr270_milling.physics.motion.scores import path_deviation


def _deviation(key: str, title: str, short: str):
    """Return a field in metres, shown in um, with the convergence of the grid as its least size."""
    return column(key, 1e6, title, "um", short=short, least=CONVERGED)


@dataclass(frozen=True)
class FeatureRow:
    """A feature, or the whole part. Magnitudes in SI units; NaN where there is nothing to measure.

    The deviation is that of the tool while it cuts. A deviation on ground that is cut away later does not stay on the
    part: walls and floor only count what remains.
    """

    name: str = column("feature", short="feature")
    #: length of the path on which material was removed
    cut_length: float = column("cut_length_mm", 1e3, unit="mm", short="cut")
    #: deviation to the side of the path while cutting
    max_normal: float = _deviation("max_normal_um", "largest deviation to the side", "max")
    mean_normal: float = _deviation("mean_normal_um", "mean", "mean")
    #: 95 % of the time the deviation is smaller
    quantile_normal: float = _deviation("q95_normal_um", "95 %", "95 %")
    max_vertical: float = column("max_vertical_um", 1e6)
    #: error of the walls that remain
    max_wall: float = _deviation("max_wall_error_um", "largest wall error", "wall")
    mean_wall: float = column("mean_wall_error_um", 1e6)
    #: error of the floor that remains
    max_floor: float = _deviation("max_floor_error_um", "largest floor error", "floor")
    mean_floor: float = column("mean_floor_error_um", 1e6)
    #: error along the normal of the surface that an end leaves that is not flat; such a part has no wall and no floor
    max_surface: float = column("max_surface_error_um", 1e6, unit="um", short="surface", least=CONVERGED)
    mean_surface: float = column("mean_surface_error_um", 1e6)
    #: mean of an exchange period
    max_force: float = column("max_force_n", 1.0, "largest force", "N", short="force")
    max_torque: float = column("max_torque_n_m")
    max_power: float = column("max_power_w", 1.0, "largest power", "W", short="power")


@dataclass(frozen=True, eq=False)
class PartAssessment:
    """Series at the ends of the n exchange periods of a pass (first row: the start), workpiece frame."""

    name: str
    path: Stations
    deviation: np.ndarray  #: actual minus target: tangential, normal to the left, vertical [m], (n + 1, 3)
    cutting: np.ndarray  #: material was removed in the period that ends here, (n + 1,)
    force: np.ndarray  #: magnitude of the mean over each period [N], (n + 1,)
    torque: np.ndarray  #: torque of the spindle [N m], (n + 1,)
    power: np.ndarray  #: [W], (n + 1,)
    floors: Floors
    walls: Walls
    floor_resolution: float = column("floor_resolution_um", 1e6)  #: [m]

    @computed("wall_points")
    def wall_points(self) -> int:
        return int(self.walls.error.size)

    @computed("features")
    def rows(self) -> tuple[FeatureRow, ...]:
        """The features in the order of the path, those that cut."""
        every = (self._row(name, self.path.feature == k, k) for k, name in enumerate(self.path.features))
        return tuple(row for row in every if row.cut_length > 0.0)

    @computed("whole_part")
    def whole(self) -> FeatureRow:
        return self._row("whole part", np.ones(self.cutting.size, bool), None)

    def _row(self, name: str, here: np.ndarray, feature: int | None) -> FeatureRow:
        mine = self.cutting & here
        normal = np.abs(self.deviation[mine, 1])
        wall = np.abs(self.walls.error if feature is None else self.walls.error[self.walls.feature == feature])
        errors, none = np.abs(self.floors.errors(feature)), np.zeros(0)
        floor, curved = (none, errors) if self.floors.curved else (errors, none)
        quantile = 0.95
        return FeatureRow(
            name=name,
            cut_length=float(np.diff(self.path.distance, prepend=0.0)[mine].sum()),
            max_normal=_of(np.max, normal),
            mean_normal=_of(np.mean, normal),
            quantile_normal=_of(lambda values: np.quantile(values, quantile), normal),
            max_vertical=_of(np.max, np.abs(self.deviation[mine, 2])),
            max_wall=_of(np.max, wall),
            mean_wall=_of(np.mean, wall),
            max_floor=_of(np.max, floor),
            mean_floor=_of(np.mean, floor),
            max_surface=_of(np.max, curved),
            mean_surface=_of(np.mean, curved),
            max_force=_of(np.max, self.force[mine]),
            max_torque=_of(np.max, self.torque[mine]),
            max_power=_of(np.max, self.power[mine]),
        )

    def table(self) -> list[dict]:
        """Return a dictionary for each feature that cuts, the last for the whole part; keys end in their unit."""
        return [as_dict(row) for row in (*self.rows, self.whole)]


def _of(measure, values: np.ndarray) -> float:
    return float(measure(values)) if values.size else np.nan


def assess(
    cell: Cell,
    ran: ScoredPass,
    ideal: IdealPart | None = None,
    path: Stations | None = None,
    cut: CutModel | None = None,
) -> PartAssessment:
    """Assess a pass of a cell; ideal: the part that the target itself leaves, path: its stations, if known already.

    cut: ``rigid_workpiece``, if known already.
    """
    return assess_result(cell, ran.name, ran.result, ideal, path, cut)


def assess_result(
    cell: Cell,
    name: str,
    result: PassResult,
    ideal: IdealPart | None = None,
    path: Stations | None = None,
    cut: CutModel | None = None,
) -> PartAssessment:
    """Assess the series of a pass along the path of a cell, also of a plant that is not the cell."""
    path = path or stations_of(path_of(cell), result.time_ns)
    ideal = ideal or ideal_part(cell, path, result.target, cut)
    return PartAssessment(
        name,
        path,
        deviations(path, result.actual - result.target),
        result.volume > 0.0,
        np.linalg.norm(result.wrench[:, :3], axis=1),
        result.torque,
        result.torque * cell.tool.spindle_speed,
        *surface(cell, path, result.target, result.actual, ideal, result.heights),
        2.0 * ideal.level + cell.stock.floor_tolerance,
    )


def assess_all(cell: Cell, passes: Sequence[ScoredPass], gauge: Gauge | None = None) -> tuple[PartAssessment, ...]:
    """Several passes of one cell, two at a time; gauge: of the cell, with what all passes along its target share."""
    gauge = gauge or gauge_of(cell)

    def assessed(ran: ScoredPass) -> PartAssessment:
        same = np.array_equal(ran.result.time_ns, gauge.stamps)
        return assess(cell, ran, gauge.ideal, gauge.path) if same else assess(cell, ran)

    with ThreadPoolExecutor(2) as pool:  # the sweep of a workpiece runs without the interpreter's lock
        return tuple(pool.map(assessed, passes))


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


@dataclass(frozen=True, eq=False)
class Gauge:
    """Judges passes along the target of a cell, of that cell and of its plants.

    ``heights`` of a pass spare a sweep of its workpiece.
    """

    cell: Cell
    stamps: np.ndarray  #: ends of the exchange periods [ns], (n + 1,)
    path: Stations
    ideal: IdealPart  #: part of the rigid arm; None: of a straight cut

    def __call__(self, result: PassResult) -> Judgement:
        cell = self.cell
        if path_of(cell).straight:
            return _judge_straight_cut(cell, result, _largest_deviation(cell, result))
        return judge_part(cell.tolerances, assess_result(cell, "", result, self.ideal, self.path))


def gauge_of(cell: Cell, cut: CutModel | None = None) -> Gauge:
    """Return the gauge of a cell. It sweeps the part of the rigid arm once; cut: which has left it already."""
    path = path_of(cell)
    stamps = path.clock.stamp(np.arange(path.clock.steps(path.target.duration_ns) + 1))
    along = stations_of(path, stamps)
    ideal = None if path.straight else ideal_part(cell, along, path.target.sample(stamps), cut)
    return Gauge(cell, stamps, along, ideal)  # type: ignore[arg-type]


def rigid_part(cell: Cell) -> tuple[Gauge, CutModel | None, PassRecord | None]:
    """The gauge of a cell; workpiece and record of a tool on the programmed path, where the gauge is made of them."""
    if path_of(cell).straight or cell.earlier:
        return gauge_of(cell), None, None
    cut = cut_of(cell)
    record = cut_along(cell, path_of(cell).target, cut)
    return gauge_of(cell, cut), cut, record


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
