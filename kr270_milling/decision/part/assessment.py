"""What a pass does to the part, feature by feature: path deviation, force, torque, power, surface errors."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from kr270_milling.cell.cell import Cell
from kr270_milling.cell.jobs import ScoredPass
from kr270_milling.decision.part.course import Course, course, deviations
from kr270_milling.decision.part.surface import IdealPart, Surface, ideal_part, surface

__all__ = ["FeatureRow", "PartAssessment", "assess", "assess_all"]

QUANTILE = 0.95


@dataclass(frozen=True)
class FeatureRow:
    """One feature, or the whole part. Magnitudes; NaN where there is nothing to measure.

    The deviation is that of the tool while it cuts. A deviation on ground that is cut away later does not stay on the
    part: walls and floor only count what remains.
    """

    name: str
    cut_length: float  #: [m] of the path on which material was removed
    max_normal: float  #: deviation to the side of the path while cutting [m]
    mean_normal: float
    quantile_normal: float  #: 95 % of the time it is smaller
    max_vertical: float
    max_wall: float  #: error of the walls that remain [m]
    mean_wall: float
    max_floor: float  #: error of the floor that remains [m]
    mean_floor: float
    max_force: float  #: mean of an exchange period [N]
    max_torque: float  #: [N m]
    max_power: float  #: [W]

    def as_dict(self) -> dict:
        """Keys end in their unit."""
        um = 1e6
        return {
            "feature": self.name,
            "cut_length_mm": self.cut_length * 1e3,
            "max_normal_um": self.max_normal * um,
            "mean_normal_um": self.mean_normal * um,
            "q95_normal_um": self.quantile_normal * um,
            "max_vertical_um": self.max_vertical * um,
            "max_wall_error_um": self.max_wall * um,
            "mean_wall_error_um": self.mean_wall * um,
            "max_floor_error_um": self.max_floor * um,
            "mean_floor_error_um": self.mean_floor * um,
            "max_force_n": self.max_force,
            "max_torque_n_m": self.max_torque,
            "max_power_w": self.max_power,
        }


@dataclass(frozen=True, eq=False)
class PartAssessment:
    """Series at the ends of the n exchange periods of a pass (first row: the start), workpiece frame."""

    name: str
    path: Course
    deviation: np.ndarray  #: actual minus target: tangential, normal to the left, vertical [m], (n + 1, 3)
    cutting: np.ndarray  #: material was removed in the period that ends here, (n + 1,)
    force: np.ndarray  #: magnitude of the mean over each period [N], (n + 1,)
    torque: np.ndarray  #: of the spindle [N m], (n + 1,)
    power: np.ndarray  #: [W], (n + 1,)
    surface: Surface
    rows: tuple[FeatureRow, ...]  #: the features in the order of the path, those that cut
    whole: FeatureRow

    def table(self) -> list[dict]:
        """One dict for each feature that cuts, and the last for the whole part; keys end in their unit."""
        return [row.as_dict() for row in (*self.rows, self.whole)]

    def as_dict(self) -> dict:
        """For JSON."""
        walls = self.surface.walls
        return {
            "name": self.name,
            "features": [row.as_dict() for row in self.rows],
            "whole_part": self.whole.as_dict(),
            "wall_points": int(walls.error.size),
            "floor_resolution_um": self.surface.floor_resolution * 1e6,
        }


def assess(cell: Cell, ran: ScoredPass, ideal: IdealPart | None = None) -> PartAssessment:
    """Assess a pass of a cell; ideal: the part that the target itself leaves, if it is known already."""
    result = ran.result
    path = course(cell, result.time_ns)
    deviation = deviations(path, result.actual - result.target)
    force = np.linalg.norm(result.wrench[:, :3], axis=1)
    power = result.torque * cell.tool.spindle_speed
    left = surface(cell, path, result.target, result.actual, ideal, result.heights)
    series = (path, deviation, result.volume > 0.0, force, result.torque, power, left)
    features = range(len(path.features))
    every = [_row(name, series, k) for k, name in zip(features, path.features, strict=True)]
    rows = tuple(row for row in every if row.cut_length > 0.0)
    return PartAssessment(ran.name, *series, rows, _row("whole part", series, None))


def assess_all(cell: Cell, passes: Sequence[ScoredPass]) -> tuple[PartAssessment, ...]:
    """Several passes of one cell, two at a time; the part of the rigid arm is made once."""
    first = passes[0].result
    ideal = ideal_part(cell, course(cell, first.time_ns), first.target)
    same = [np.array_equal(p.result.target, first.target) for p in passes]
    with ThreadPoolExecutor(2) as pool:  # the sweep of a workpiece runs without the interpreter's lock
        return tuple(pool.map(lambda p, s: assess(cell, p, ideal if s else None), passes, same))


def _row(name: str, series: tuple, feature: int | None) -> FeatureRow:
    path, deviation, cutting, force, torque, power, left = series
    mine = cutting if feature is None else cutting & (path.feature == feature)
    normal, walls = np.abs(deviation[mine, 1]), left.walls
    wall = np.abs(walls.error if feature is None else walls.error[walls.feature == feature])
    floor = np.abs(left.floors.errors(feature))
    return FeatureRow(
        name=name,
        cut_length=float(np.diff(path.distance, prepend=0.0)[mine].sum()),
        max_normal=_largest(normal),
        mean_normal=_mean(normal),
        quantile_normal=float(np.quantile(normal, QUANTILE)) if normal.size else np.nan,
        max_vertical=_largest(np.abs(deviation[mine, 2])),
        max_wall=_largest(wall),
        mean_wall=_mean(wall),
        max_floor=_largest(floor),
        mean_floor=_mean(floor),
        max_force=_largest(force[mine]),
        max_torque=_largest(torque[mine]),
        max_power=_largest(power[mine]),
    )


def _largest(values: np.ndarray) -> float:
    return float(values.max()) if values.size else np.nan


def _mean(values: np.ndarray) -> float:
    return float(values.mean()) if values.size else np.nan
