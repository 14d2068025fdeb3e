"""Predicted error of the surfaces that a pass leaves on the part, against those of a rigid arm on the same path.

Positive errors: material is left standing. Floors come from two height maps on the same grid, so that the grid's own
error cancels; their resolution is one level of the map (thickness of the stock / 65535) and the stock's floor
tolerance. Walls come from the passages of the teeth: one value per tooth and side, cusps of f_z^2 / 8R neglected.
The tool is upright: what the arm's rotation would tilt the floor by is not part of it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import distance_transform_edt, maximum_filter, minimum_filter

from kr270_milling.cell.cell import Cell
from kr270_milling.cutting import Stock
from kr270_milling.decision.part.course import Course
from kr270_milling.decision.part.machined import machined
from kr270_milling.decision.part.walls import IdealWalls, Walls, ideal_walls, marks, remaining_walls

__all__ = ["Floors", "IdealPart", "Surface", "Walls", "ideal_part", "surface"]

SLOPE = 0.02  #: a steeper floor is a wall


@dataclass(frozen=True, eq=False)
class Floors:
    """A map of the stock seen from above; NaN where there is no floor that was cut: walls, borders, untouched top."""

    x: np.ndarray  #: [m], (a,)
    y: np.ndarray  #: [m], (b,)
    height: np.ndarray  #: of the rigid arm's part [m], (a, b), everywhere
    error: np.ndarray  #: machined minus rigid height [m], (a, b)
    feature: np.ndarray  #: index into the features of the path, (a, b); -1: none

    def errors(self, feature: int | None = None) -> np.ndarray:
        """[m], (m,), of one feature or of all."""
        known = np.isfinite(self.error) & (True if feature is None else self.feature == feature)
        return self.error[known]


@dataclass(frozen=True, eq=False)
class Surface:
    """What remains of a pass."""

    floors: Floors
    walls: Walls
    floor_resolution: float  #: [m]


@dataclass(frozen=True, eq=False)
class IdealPart:
    """What a rigid arm would leave: thinned, so that a large workpiece need not be kept."""

    x: np.ndarray  #: [m], (a,)
    y: np.ndarray  #: [m], (b,)
    height: np.ndarray  #: [m], (a, b)
    owner: np.ndarray  #: index of the feature that made each floor, (a, b); -1: none
    walls: IdealWalls
    level: float  #: of the height map [m]
    thinning: int


def ideal_part(cell: Cell, path: Course, target: np.ndarray) -> IdealPart:
    """The part after a rigid arm moved the tool tip through ``target`` (n + 1, 3) [m]."""
    cut = machined(cell, target)
    level = cut.params.level_step
    x, y, height = cut.map_heights()
    owner = _owners(x, y, height, path, target, cell.tool.radius, level)
    walls = ideal_walls(cut, marks(cell.tool, path, cell.clock.period, target))
    return IdealPart(x, y, height, owner, walls, level, cut.map_thinning)


def surface(
    cell: Cell, path: Course, target: np.ndarray, actual: np.ndarray, ideal: IdealPart | None = None,
    heights: np.ndarray | None = None,
) -> Surface:  # fmt: skip
    """Surface errors of a pass with tool centres ``actual`` where ``target`` was wanted, (n + 1, 3) [m].

    ideal: the part that the target itself leaves; heights (a, b) [m]: of the pass's own finished workpiece. Each is
    made by a sweep where it is not known already.
    """
    ideal = ideal_part(cell, path, target) if ideal is None else ideal
    walls = remaining_walls(ideal.walls, path, actual - target, ideal.level)
    if heights is None or heights.shape != ideal.height.shape:
        heights = machined(cell, actual).map_heights()[2]
    largest = float(np.abs(actual - target)[:, :2].max(initial=0.0))
    floors = _floors(cell.stock, ideal, heights, largest)
    return Surface(floors, walls, 2.0 * ideal.level + cell.stock.floor_tolerance)


def _floors(stock: Stock, ideal: IdealPart, height: np.ndarray, largest: float) -> Floors:
    """largest: deviation in the plane [m]; nodes that are nearer to a wall may be on its other side."""
    spacing = stock.grid_step * ideal.thinning
    width = 1 + 2 * int(np.ceil((largest + 2.0 * stock.grid_step) / spacing))
    rise = maximum_filter(ideal.height, width, mode="nearest") - minimum_filter(ideal.height, width, mode="nearest")
    floor = (rise <= 2.0 * ideal.level + SLOPE * width * spacing) & (ideal.height < stock.max[2] - 0.5 * ideal.level)
    error = np.where(floor, height - ideal.height, np.nan)
    return Floors(ideal.x, ideal.y, ideal.height, error, ideal.owner)


def _owners(x, y, height, path: Course, target: np.ndarray, radius: float, level: float) -> np.ndarray:
    """(a, b): the feature that was last at the height of each node, -1 where none was."""
    owner = np.full(height.shape, -1, np.int64)
    top, reach = float(height.max()), 0.25 * radius
    rise = np.abs(path.tangent[:, 2])
    slack = np.where(rise < 0.5, rise * reach, 0.0) + 2.0 * level  # a plunge leaves its floor at its end
    for k in _stations(path, target, reach):
        cx, cy, z = target[k]
        if z > top + level:
            continue
        i, j = (slice(*np.searchsorted(axis, [c - radius, c + radius])) for axis, c in ((x, cx), (y, cy)))
        near = (x[i, None] - cx) ** 2 + (y[None, j] - cy) ** 2 < radius**2
        near &= np.abs(height[i, j] - z) <= slack[k]
        owner[i, j][near] = path.feature[k]
    _, nearest = distance_transform_edt(owner < 0, return_indices=True)
    return np.where(height < top - 0.5 * level, owner[tuple(nearest)], -1)  # slivers between two of these places


def _stations(path: Course, target: np.ndarray, reach: float) -> np.ndarray:
    """Rows of the series at most ``reach`` [m] apart on the way, and those where the path turns or ends."""
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(target, axis=0), axis=1))])
    even = np.searchsorted(way, np.arange(0.0, way[-1], reach))
    turns = np.flatnonzero(np.sum(path.tangent[1:] * path.tangent[:-1], axis=1) < 0.99)
    return np.unique(np.concatenate([even, turns, turns + 1, [way.size - 1]]))
