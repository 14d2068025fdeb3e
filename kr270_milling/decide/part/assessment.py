"""Results of a pass for the part, feature by feature: path deviation, force, torque, power, surface errors."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from kr270_milling.base.column import CONVERGED, as_dict, column, computed
from kr270_milling.cell.cell import Cell
from kr270_milling.cell.jobs import ScoredPass
from kr270_milling.cell.models import path_of
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
from kr270_milling.physics.motion.milling_pass import PassResult


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


def assess(cell: Cell, ran: ScoredPass, ideal: IdealPart | None = None, path: Stations | None = None) -> PartAssessment:
    """Assess a pass of a cell; ideal: the part that the target itself leaves, path: its stations, if known already."""
    return assess_result(cell, ran.name, ran.result, ideal, path)


def assess_result(
    cell: Cell, name: str, result: PassResult, ideal: IdealPart | None = None, path: Stations | None = None
) -> PartAssessment:
    """Assess the series of a pass along the path of a cell, also of a plant that is not the cell."""
    path = path or stations_of(path_of(cell), result.time_ns)
    ideal = ideal or ideal_part(cell, path, result.target)
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


def assess_all(cell: Cell, passes: Sequence[ScoredPass]) -> tuple[PartAssessment, ...]:
    """Several passes of one cell, two at a time; stations and part of the rigid arm are computed once."""
    first = passes[0].result
    path = stations_of(path_of(cell), first.time_ns)
    ideal = ideal_part(cell, path, first.target)

    def assessed(ran: ScoredPass) -> PartAssessment:
        result = ran.result
        same = np.array_equal(result.time_ns, first.time_ns) and np.array_equal(result.target, first.target)
        return assess(cell, ran, ideal, path) if same else assess(cell, ran)

    with ThreadPoolExecutor(2) as pool:  # the sweep of a workpiece runs without the interpreter's lock
        return tuple(pool.map(assessed, passes))
