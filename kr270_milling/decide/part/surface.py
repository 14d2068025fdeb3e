"""Predicted error of the surfaces that a pass leaves on the part, against those of a rigid arm on the same path.

Positive errors: material is left standing. Floors come from two height maps on the same grid, so that the grid's own
error cancels; their resolution is one level of the map (thickness of the stock / 65535) and the stock's floor
tolerance. The tool is upright: what the arm's rotation would tilt the floor by is not part of it.

Walls come from where the teeth were when they passed them: a tooth marks the wall to the left (right) of the path when
it points there. The wall is the farthest reach of the marks nearby: between two marks a cusp of f_z^2 / 8R stays, with
a vibrating tool a deep mark cuts its neighbours off. Grid nodes only show which walls are still there at the end, so
the grid step does not blur the error.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import distance_transform_edt, maximum_filter, minimum_filter
from scipy.spatial import cKDTree

from kr270_milling.base.column import column, computed
from kr270_milling.cell.cell import Cell
from kr270_milling.cell.models import cut_of, path_of
from kr270_milling.cell.stage import Removal, cleared, swept
from kr270_milling.decide.part.stations import Stations
from kr270_milling.decide.part.workpiece import heights_at, machined
from kr270_milling.physics.cutting import CutModel, Stock, Tool

__all__ = ["Floors", "IdealPart", "IdealWalls", "Marks", "Surface", "Walls", "ideal_part", "remaining_walls", "surface"]

SLOPE = 0.02  #: a steeper floor is a wall
STEEP = 2.75  #: assumed, tangent of 70 deg: on a steeper surface a node of the map is three of its steps high

CHUNK = 5_000  #: marks at once, with the neighbours of each 25 kB
CORNER = 0.1  #: [rad] a larger turn of the path within a period is a corner


@dataclass(frozen=True, eq=False)
class Marks:
    """m passages of a tooth by the left or right of the path of a rigid arm, in the order of time for each side."""

    centre: np.ndarray  #: centre of the rigid tool tip [m], (m, 3)
    normal: np.ndarray  #: direction in which the tooth points, into the material, (m, 2)
    radius: np.ndarray  #: radius of the tooth [m], (m,)
    period: np.ndarray  #: number of the exchange period, (m,)
    share: np.ndarray  #: elapsed fraction of that period, (m,)

    def __len__(self) -> int:
        return self.period.size

    @property
    def point(self) -> np.ndarray:
        """Tip of the rigid tool's tooth [m], (m, 2)."""
        return self.centre[:, :2] + self.radius[:, None] * self.normal

    def __getitem__(self, chosen) -> Marks:
        return Marks(*(getattr(self, name)[chosen] for name in self.__dataclass_fields__))


@dataclass(frozen=True, eq=False)
class IdealWalls:
    """The marks of a rigid arm's tool, and which of them are still walls in the end."""

    marks: Marks  #: all below the stock's top
    staying: np.ndarray  #: indices of those on a wall that stays, (k,)
    height: np.ndarray  #: height of the wall [m], (k,)


@dataclass(frozen=True, eq=False)
class Walls:
    """Points on the walls that stay; errors are along the normal, positive where material is left standing."""

    position: np.ndarray  #: on the wall of a rigid arm, at the bottom of the tool that made it [m], (m, 3)
    normal: np.ndarray  #: out of the material, (m, 2)
    height: np.ndarray  #: height of the wall there [m], (m,)
    error: np.ndarray  #: [m], (m,)
    feature: np.ndarray  #: index into the features of the path, (m,)


def marks(tool: Tool, path: Stations, period: float, rigid: np.ndarray) -> Marks:
    """All marks of a pass with tool centres (n + 1, 3) [m] every ``period`` [s]."""
    heading = np.unwrap(path.heading)
    first, last = heading[:-1], heading[1:]
    corner = np.abs(last - first) > CORNER  # there the path turns at once to its new direction
    first = np.where(corner, last, first)
    turn, rows = period * tool.spindle_speed, []
    relative = np.arange(len(rigid)) * turn - tool.sense * heading
    for side in (1.0, -1.0):
        for angle, radius in zip(tool.angles, tool.radii, strict=True):
            phase = (angle - tool.sense * side * np.pi / 2 + relative) / (2 * np.pi)  # whole numbers are passages
            low, high = np.where(corner, phase[1:] - turn / (2 * np.pi), phase[:-1]), phase[1:]
            k = np.flatnonzero((np.ceil(high) > np.ceil(low)) & ~path.drilling[1:])
            share = (np.ceil(low[k]) - low[k]) / (high[k] - low[k])
            rows.append((k, share, np.full(k.size, radius), np.full(k.size, side)))
    k, share, radius, sides = (np.concatenate(column) for column in zip(*rows, strict=True))
    order = np.lexsort((k + share, -sides))
    k, share, radius, sides = k[order], share[order], radius[order], sides[order]
    centre = rigid[k] + share[:, None] * (rigid[k + 1] - rigid[k])
    along = first[k] + share * (last[k] - first[k]) + sides * np.pi / 2
    return Marks(centre, np.column_stack([np.cos(along), np.sin(along)]), radius, k, share)


def ideal_walls(cut: CutModel, hits: Marks) -> IdealWalls:
    """Return the marks that remain as walls on the finished workpiece of the rigid arm."""
    stock, beyond = cut.stock, 2.0 * cut.stock.grid_step
    hits = hits[hits.centre[:, 2] < stock.max[2] - cut.params.level_step]
    outside = heights_at(cut, hits.point + beyond * hits.normal)
    with np.errstate(invalid="ignore"):  # NaN: beside the stock
        here = outside > hits.centre[:, 2] + 2.0 * cut.params.level_step
    staying = hits[here]
    inside = heights_at(cut, staying.point - beyond * staying.normal)
    inside = np.fmin(inside, staying.centre[:, 2])
    return IdealWalls(hits, np.flatnonzero(here), outside[here] - inside)


def _not_passed(after: CutModel, walls: IdealWalls) -> IdealWalls:
    """The walls that no later tool passes; after: what the later tools alone leave of an uncut stock."""
    staying = walls.marks[walls.staying]
    stays = np.ones(len(staying), bool)
    for side in (-2.0, 2.0):  # grid nodes into the cut, and into the wall
        beside = heights_at(after, staying.point + side * after.stock.grid_step * staying.normal)
        with np.errstate(invalid="ignore"):  # NaN: beside the stock
            stays &= ~(beside <= staying.centre[:, 2] + 2.0 * after.params.level_step)
    return IdealWalls(walls.marks, walls.staying[stays], walls.height[stays])


def remaining_walls(ideal: IdealWalls, path: Stations, error: np.ndarray, level: float) -> Walls:
    """The walls of the finished part, given actual minus target tool centres (n + 1, 3) [m]; level [m] of the grid."""
    hits = ideal.marks
    k, staying = hits.period, hits[ideal.staying]
    moved = (error[k] + hits.share[:, None] * (error[k + 1] - error[k]))[:, :2]
    position = np.column_stack([staying.point, staying.centre[:, 2]])
    missed = -_reach(hits, moved, staying, np.einsum("kd,kd->k", moved[ideal.staying], staying.normal), 2.0 * level)
    return Walls(position, -staying.normal, ideal.height, missed, path.feature[staying.period])


def _reach(hits: Marks, error: np.ndarray, staying: Marks, own: np.ndarray, level: float) -> np.ndarray:
    """Return the reach of the teeth beyond that of rigid ones at each staying mark [m], (k,).

    error (m, 2) [m]: shifts of the teeth. own: reach of the tooth of the mark itself [m], (k,); it counts
    alone where a tool rests so long that all the nearest marks are of other walls.
    """
    out = np.array(own)
    if not out.size:
        return out
    tree = cKDTree(hits.point)
    deepest = 20e-6  # [m]; marks this much deeper than their neighbours still are weighed against them
    bound = float(np.sqrt(2.0 * hits.radius.max() * deepest))
    neighbours = 48  # at most; a tool that rests marks one place with every tooth
    parallel = 0.98  # cosine between normals of one wall
    for first in range(0, out.size, CHUNK):
        mine = staying[first : first + CHUNK]
        _, near = tree.query(mine.point, k=min(neighbours, len(hits)), distance_upper_bound=bound)
        near = near.reshape(len(mine), -1)
        exists = near < len(hits)
        near = np.where(exists, near, 0)
        theirs = hits[near]
        same = exists & (np.einsum("mkd,md->mk", theirs.normal, mine.normal) > parallel)
        same &= theirs.centre[..., 2] <= mine.centre[:, None, 2] + level  # a higher pass does not touch the wall here
        away = theirs.centre[..., :2] - mine.point[:, None]
        across = away[..., 0] * mine.normal[:, None, 1] - away[..., 1] * mine.normal[:, None, 0]
        arc = np.sqrt(np.maximum(theirs.radius**2 - across**2, 0.0))
        rigid = np.einsum("mkd,md->mk", away, mine.normal) + arc
        moved = rigid + np.einsum("mkd,md->mk", error[near], mine.normal)
        farthest = [np.where(same, reach, -np.inf).max(axis=1) for reach in (moved, rigid)]
        known = same.any(axis=1)
        out[first : first + CHUNK][known] = farthest[0][known] - farthest[1][known]
    return out


@dataclass(frozen=True, eq=False)
class Floors:
    """A map of the stock seen from above; NaN where there is no floor that was cut: walls, borders, untouched top."""

    x: np.ndarray  #: [m], (a,)
    y: np.ndarray  #: [m], (b,)
    height: np.ndarray  #: height of the rigid arm's part [m], (a, b), everywhere
    error: np.ndarray  #: machined minus rigid height [m], (a, b)
    feature: np.ndarray  #: index into the features of the path, (a, b); -1: none
    curved: bool = False  #: the errors are along the normal of the surface that an end that is not flat leaves

    def errors(self, feature: int | None = None) -> np.ndarray:
        """[m], (m,), of one feature or of all."""
        known = np.isfinite(self.error) & (True if feature is None else self.feature == feature)
        return self.error[known]


@dataclass(frozen=True, eq=False)
class Surface:
    """Surfaces of the part after a pass."""

    floors: Floors
    walls: Walls
    floor_resolution: float = column("floor_resolution_um", 1e6)  #: [m]

    @computed("wall_points")
    def wall_points(self) -> int:
        return int(self.walls.error.size)


@dataclass(frozen=True, eq=False)
class IdealPart:
    """The part of a rigid arm: thinned, so that a large workpiece takes little memory."""

    x: np.ndarray  #: [m], (a,)
    y: np.ndarray  #: [m], (b,)
    height: np.ndarray  #: [m], (a, b)
    owner: np.ndarray  #: index of the feature that made each floor, (a, b); -1: none
    walls: IdealWalls
    level: float  #: level step of the height map [m]
    thinning: int
    unjudged: np.ndarray  #: floors of holes and of other tools, (a, b) bool


def ideal_part(cell: Cell, path: Stations, target: np.ndarray) -> IdealPart:
    """The part after a rigid arm moved the tool tip through ``target`` (n + 1, 3) [m].

    In a program with several tools, the rigid arm made the paths of the earlier tools before. Walls and floors
    belong to the last tool that passes there.
    """
    cut = machined(cut_of(cell, rigid=True), target, path_of(cell).clock)
    level = cut.params.level_step
    x, y, height = cut.map_heights()
    owner = _owners(x, y, height, path, target, cell.tool.radius, level, float(cell.stock.max[2]))
    passages = marks(cell.tool, path, path_of(cell).clock.period, target)
    if not cell.tool.has_flat_end:  # its sides are part of the surface
        passages = passages[:0]
    walls = ideal_walls(cut, passages)
    if cell.stage:
        radius = float(cell.tool.radii.max())
        mine = swept((Removal(cell.stage.tool, radius, target, target, cutter=cell.tool),), cell.stock, False)
        owner = np.where(mine.map_heights()[2] <= height + 2.0 * level, owner, -1)
        if cell.stage.later:
            after = cleared(cell.stage.later, cell.stock, False)
            owner = np.where(after.map_heights()[2] <= height + 2.0 * level, -1, owner)
            walls = _not_passed(after, walls)
    unjudged = _drilled(x, y, height, target[path.drilling], cell.tool.radius, 2.0 * level)
    if cell.stage:
        unjudged |= owner < 0
    return IdealPart(x, y, height, owner, walls, level, cut.map_thinning, unjudged)


def surface(
    cell: Cell,
    path: Stations,
    target: np.ndarray,
    actual: np.ndarray,
    ideal: IdealPart | None = None,
    heights: np.ndarray | None = None,
) -> Surface:
    """Surface errors of a pass with tool centres ``actual`` where ``target`` was wanted, (n + 1, 3) [m].

    ideal: the part that the target itself leaves; heights (a, b) [m]: of the pass's own finished workpiece. Each is
    made by a sweep where it is not known already.
    """
    ideal = ideal_part(cell, path, target) if ideal is None else ideal
    walls = remaining_walls(ideal.walls, path, actual - target, ideal.level)
    if heights is None or heights.shape != ideal.height.shape:
        heights = machined(cut_of(cell), actual, path_of(cell).clock).map_heights()[2]
    largest = float(np.abs(actual - target)[:, :2].max(initial=0.0))
    floors = _floors(cell.stock, ideal, heights, largest)
    if not cell.tool.has_flat_end:
        floors = _curved(cell.stock, ideal, heights)
    return Surface(floors, walls, 2.0 * ideal.level + cell.stock.floor_tolerance)


def _floors(stock: Stock, ideal: IdealPart, height: np.ndarray, largest: float) -> Floors:
    """largest: deviation in the plane [m]; nodes that are nearer to a wall may be on its other side."""
    spacing = stock.grid_step * ideal.thinning
    width = 1 + 2 * int(np.ceil((largest + 2.0 * stock.grid_step) / spacing))
    rise = maximum_filter(ideal.height, width, mode="nearest") - minimum_filter(ideal.height, width, mode="nearest")
    floor = (
        ~ideal.unjudged
        & (rise <= 2.0 * ideal.level + SLOPE * width * spacing)
        & (ideal.height < stock.max[2] - 0.5 * ideal.level)
    )
    error = np.where(floor, height - ideal.height, np.nan)
    return Floors(ideal.x, ideal.y, ideal.height, error, ideal.owner)


def _curved(stock: Stock, ideal: IdealPart, height: np.ndarray) -> Floors:
    """The error along the normal of the rigid arm's surface: the difference of heights times the cosine of the slope.

    Steeper places than ``STEEP`` are left out: the nodes of the map do not resolve them.
    """
    spacing = stock.grid_step * ideal.thinning
    slope = np.hypot(*np.gradient(ideal.height, spacing))
    cut = ~ideal.unjudged & (slope < STEEP) & (ideal.height < stock.max[2] - 0.5 * ideal.level)
    border = maximum_filter(~cut, 3, mode="constant")  # the slope there is that of an edge
    error = np.where(cut & ~border, (height - ideal.height) / np.hypot(1.0, slope), np.nan)
    return Floors(ideal.x, ideal.y, ideal.height, error, ideal.owner, curved=True)


def _owners(x, y, height, path: Stations, target: np.ndarray, radius: float, level: float, top: float) -> np.ndarray:
    """(a, b): the feature that was last at the height of each node, -1 where none was; top [m]: of the stock."""
    owner = np.full(height.shape, -1, np.int64)
    reach = 0.25 * radius
    rise = np.abs(path.tangent[:, 2])
    slack = np.where(rise < 0.5, rise * reach, 0.0) + 2.0 * level  # a plunge leaves its floor at the last point
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


def _drilled(x, y, height, bottoms: np.ndarray, radius: float, slack: float) -> np.ndarray:
    """(a, b): nodes at the bottom of a hole; bottoms (m, 3) [m]: places of the tool tip in drilling cycles."""
    out = np.zeros(height.shape, bool)
    for cx, cy in np.unique(np.round(bottoms[:, :2], 7), axis=0):
        z = bottoms[np.hypot(bottoms[:, 0] - cx, bottoms[:, 1] - cy) < 1e-6, 2].min()
        i, j = (slice(*np.searchsorted(axis, [c - radius, c + radius])) for axis, c in ((x, cx), (y, cy)))
        near = (x[i, None] - cx) ** 2 + (y[None, j] - cy) ** 2 < radius**2
        out[i, j] |= near & (height[i, j] > z - slack)
    return out


def _stations(path: Stations, target: np.ndarray, reach: float) -> np.ndarray:
    """Rows of the series at most ``reach`` [m] apart, and those where the path turns or ends."""
    distance = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(target, axis=0), axis=1))])
    even = np.searchsorted(distance, np.arange(0.0, distance[-1], reach))
    turns = np.flatnonzero(np.sum(path.tangent[1:] * path.tangent[:-1], axis=1) < 0.99)
    return np.unique(np.concatenate([even, turns, turns + 1, [distance.size - 1]]))
