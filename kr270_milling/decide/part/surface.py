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

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numba import njit
from scipy.ndimage import distance_transform_edt, maximum_filter, minimum_filter
from scipy.spatial import cKDTree

from kr270_milling.base.files import write_files
from kr270_milling.base.frames import tool_axis
from kr270_milling.cell.cell import Cell
from kr270_milling.cell.models import cut_of, flat_floors, path_of, removal_of
from kr270_milling.cell.paths import CellPath
from kr270_milling.cell.stage import cleared, swept
from kr270_milling.path.trajectory import Trajectory
from kr270_milling.physics.cutting import CutModel, Stock, Tool
from kr270_milling.physics.cutting.grid import TILE
from kr270_milling.physics.motion.milling_pass import PassResult
from kr270_milling.physics.motion.periods import Clock


@dataclass(frozen=True, eq=False)
class Stations:
    """The target of a pass at the ends of its n exchange periods (first row: the start), workpiece frame."""

    distance: np.ndarray  #: [m], (n + 1,), along the tool path
    tangent: np.ndarray  #: unit vectors, (n + 1, 3), also while the tool rests
    heading: np.ndarray  #: [rad], (n + 1,), of the tangent in the xy plane; moves along the spindle keep the last one
    feature: np.ndarray  #: (n + 1,), index into ``features``
    features: tuple[str, ...]
    drilling: np.ndarray  #: in a drilling cycle, (n + 1,) bool

    @property
    def left(self) -> np.ndarray:
        """Horizontal unit normal to the left of the path, (n + 1, 2)."""
        return np.column_stack([-np.sin(self.heading), np.cos(self.heading)])


def stations_of(programmed: CellPath, time_ns: np.ndarray) -> Stations:
    """Return the stations of the programmed path at times [ns], (n + 1,)."""
    timed = programmed.timed
    if timed is None:
        target = programmed.target
        distance = np.linalg.norm(target.sample(time_ns) - target.position[0], axis=1)
        along = target.position[-1] - target.position[0]
        tangent = np.tile(along / np.linalg.norm(along), (time_ns.size, 1))
        return Stations(
            distance,
            tangent,
            _headings(tangent),
            np.zeros(time_ns.size, np.int64),
            ("straight cut",),
            np.zeros(time_ns.size, bool),
        )
    path, distance = timed.toolpath, timed.distance_at(time_ns)
    _, tangent, _ = path.on_path(distance)
    feature = path.feature[path.block_at(distance)]
    names = tuple(name or "unnamed" for name in path.features)
    return Stations(distance, tangent, _headings(tangent), feature, names, programmed.drilling_at(time_ns))


def _headings(tangent: np.ndarray) -> np.ndarray:
    upright = 1e-6  # horizontal part of a unit tangent below which the tool moves along the spindle
    level = np.hypot(tangent[:, 0], tangent[:, 1]) > upright
    if not level.any():
        return np.zeros(len(tangent))
    last = np.maximum.accumulate(np.where(level, np.arange(level.size), -1))
    rows = tangent[np.where(last < 0, np.argmax(level), last)]
    return np.arctan2(rows[:, 1], rows[:, 0])


def deviations(path: Stations, error: np.ndarray) -> np.ndarray:
    """Tangential, normal (to the left) and vertical part of actual minus target, both (n + 1, 3) [m]."""
    normal = np.sum(error[:, :2] * path.left, axis=1)
    return np.column_stack([np.sum(error * path.tangent, axis=1), normal, error[:, 2]])


def machined(cut: CutModel, positions: np.ndarray, clock: Clock, run: Trajectory | None = None) -> CutModel:
    """Move the tool tip through positions (n + 1, 3) [m] of a fresh workpiece, and return the workpiece.

    One exchange period lies between two positions, workpiece frame. Positions of the target leave the part of a rigid
    arm. run: states the axis of a tool that tilts. Raises MillingError.
    """
    steps, axes = np.arange(len(positions)), None
    if run is not None and cut.tilts:
        axes = tool_axis(run.sample_orientation(clock.stamp(steps)))
    # the mean force is not wanted: its spindle does not turn
    cut.along(positions, steps * (clock.micro_steps if cut.teeth else 0), axes=axes)
    return cut


def rigid_workpiece(cell: Cell, every: int = 1) -> CutModel:
    """Return the workpiece after a rigid arm ran along the target; every: exchange periods from place to place."""
    cut, target, clock = cut_of(cell, rigid=True), path_of(cell).target, path_of(cell).clock
    last = clock.steps(target.duration_ns)
    steps = np.append(np.arange(0, last, every), last)
    stamps = clock.stamp(steps)
    axes = tool_axis(target.sample_orientation(stamps)) if cut.tilts else None
    cut.along(target.sample(stamps), steps * (clock.micro_steps if cut.teeth else 0), axes=axes)
    return cut


def heights_at(cut: CutModel, xy: np.ndarray) -> np.ndarray:
    """The part's surface z [m], (m,), at the nodes nearest to points (m, 2) [m]; NaN beside the stock."""
    stock, state = cut.stock, cut.state
    place = (np.asarray(xy, float) - stock.min[:2]) / stock.grid_step
    inside = np.all((place >= 0) & (place < stock.nodes), axis=1)
    ix, iy = np.floor(np.where(inside[:, None], place, 0.0)).astype(np.int64).T
    slot = state.table[ix // TILE, iy // TILE].astype(np.int64)
    index = (np.maximum(slot, 0) * TILE + ix % TILE) * TILE + iy % TILE
    level = np.where(slot >= 0, state.pool[index], 0)
    return np.where(inside, stock.max[2] - level * cut.params.level_step, np.nan)


def write_part(path, cut: CutModel, result: PassResult, clock: Clock, run: Trajectory | None = None) -> int:
    """``write_stl`` of the part that a pass left. It is swept again only where the pass has no map that is as fine.

    cut: a fresh workpiece; run: as in ``machined``.
    """
    if result.heights is None or cut.map_thinning > _thinning(cut):
        return write_stl(path, machined(cut, result.actual, clock, run))
    return write_stl(path, cut, (*cut.map_heights()[:2], result.heights))


def write_stl(path, cut: CutModel, lattice: tuple[np.ndarray, ...] = ()) -> int:
    """Write the part of ``cut`` as seen in heights 0.25 mm apart, coordinates in mm; returns the triangles.

    A large part has 4 million triangles at most. lattice: x (a,), y (b,) and heights (a, b) [m] in place of those of
    the cut. The file appears whole or not at all. Raises InputError where it cannot be written.
    """
    triangle = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    stock = cut.stock
    x, y, z = lattice or cut.heights(thinning=_thinning(cut))
    x, y = (np.concatenate([[stock.min[k]], axis, [stock.max[k]]]) for k, axis in enumerate((x, y)))  # to the borders
    least = stock.min[2] + cut.params.level_step  # where the tool went through, a skin is left: the surface is one
    z = np.maximum(np.pad(z, 1, mode="edge"), least)
    triangles = _triangles(x * 1e3, y * 1e3, z * 1e3, float(stock.min[2]) * 1e3)
    record = np.zeros(len(triangles), triangle)
    record["corners"] = triangles
    corners = record["corners"].astype(float)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    record["normal"] = normal / np.where(length > 0, length, 1.0)
    header = b"kr270_milling machined part, mm".ljust(80)
    write_files({Path(path): (header + np.uint32(len(record)).tobytes(), record.view(np.uint8))})
    return len(record)


def _thinning(cut: CutModel) -> int:
    """Return the number of nodes between two that are shown: 0.25 mm, or as many as a large part needs."""
    fine = 0.25e-3  # [m]
    thinning = max(1, round(fine / cut.stock.grid_step))
    most_triangles = 4_000_000  # 200 MB
    while True:
        x, y = (-(-n // thinning) + 2 for n in cut.stock.nodes)
        if 2 * x * y + 6 * (x + y) <= most_triangles:
            return thinning
        thinning = math.ceil(1.1 * thinning)


def _triangles(x: np.ndarray, y: np.ndarray, z: np.ndarray, bottom: float) -> np.ndarray:
    """(m, 3, 3), counterclockwise seen from outside."""
    grid = np.stack([*np.meshgrid(x, y, indexing="ij"), z], -1)
    border = np.concatenate([grid[:-1, 0], grid[-1, :-1], grid[:0:-1, -1], grid[0, ::-1]])  # around, closed
    under = border.copy()
    under[:, 2] = bottom
    middle = np.broadcast_to([0.5 * (x[0] + x[-1]), 0.5 * (y[0] + y[-1]), bottom], under[1:].shape)
    floor = np.stack([under[1:], under[:-1], middle], axis=1)
    return np.concatenate([_sheet(grid), _sheet(np.stack([under, border], axis=1)), floor])


def _sheet(p: np.ndarray) -> np.ndarray:
    """Two triangles for each mesh of points (a, b, 3); their outside is where the first axis turns to the second."""
    a, b, c, d = p[:-1, :-1], p[1:, :-1], p[1:, 1:], p[:-1, 1:]
    return np.stack([np.stack([a, b, c], -2), np.stack([a, c, d], -2)], -3).reshape(-1, 3, 3)


SLOPE = 0.02  #: a steeper floor is a wall


#: passage of a tooth by the left or right of the path of a rigid arm
MARK = np.dtype(
    [
        ("centre", float, 3),  # of the rigid tool tip [m]
        ("normal", float, 2),  # direction in which the tooth points, into the material
        ("radius", float),  # of the tooth [m]
        ("period", np.int64),  # number of the exchange period
        ("share", float),  # elapsed fraction of that period
    ]
)


@dataclass(frozen=True, eq=False)
class Walls:
    """Points on the walls that stay; errors are along the normal, positive where material is left standing."""

    position: np.ndarray  #: on the wall of a rigid arm, at the bottom of the tool that made it [m], (m, 3)
    normal: np.ndarray  #: out of the material, (m, 2)
    height: np.ndarray  #: height of the wall there [m], (m,)
    error: np.ndarray  #: [m], (m,)
    feature: np.ndarray  #: index into the features of the path, (m,)


def marks(tool: Tool, path: Stations, period: float, rigid: np.ndarray) -> np.ndarray:
    """All marks, MARK, of a pass with tool centres (n + 1, 3) [m] every ``period`` [s]; for each side by time."""
    heading = np.unwrap(path.heading)
    first, last = heading[:-1], heading[1:]
    # [rad] a larger turn of the path within a period is a corner
    corner = np.abs(last - first) > 0.1  # there the path turns at once to its new direction
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
    k, share, sides = k[order], share[order], sides[order]
    along = first[k] + share * (last[k] - first[k]) + sides * np.pi / 2
    hits = np.empty(k.size, MARK)
    hits["centre"] = rigid[k] + share[:, None] * (rigid[k + 1] - rigid[k])
    hits["normal"] = np.column_stack([np.cos(along), np.sin(along)])
    hits["radius"], hits["period"], hits["share"] = radius[order], k, share
    return hits


def tooth_tips(hits: np.ndarray) -> np.ndarray:
    """Places of the teeth of a rigid tool [m], (m, 2), at marks."""
    return hits["centre"][:, :2] + hits["radius"][:, None] * hits["normal"]


def _staying(cut: CutModel, hits: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the marks that remain as walls on the finished workpiece of the rigid arm, and the height of each."""
    beyond = 2.0 * cut.stock.grid_step
    outside = heights_at(cut, tooth_tips(hits) + beyond * hits["normal"])
    with np.errstate(invalid="ignore"):  # NaN: beside the stock
        here = np.flatnonzero(outside > hits["centre"][:, 2] + 2.0 * cut.params.level_step)
    staying = hits[here]
    inside = heights_at(cut, tooth_tips(staying) - beyond * staying["normal"])
    return here, outside[here] - np.fmin(inside, staying["centre"][:, 2])


def _not_passed(after: CutModel, staying: np.ndarray) -> np.ndarray:
    """Mask of the marks that no later tool passes; after: what the later tools alone leave of an uncut stock."""
    stays = np.ones(len(staying), bool)
    for side in (-2.0, 2.0):  # grid nodes into the cut, and into the wall
        beside = heights_at(after, tooth_tips(staying) + side * after.stock.grid_step * staying["normal"])
        with np.errstate(invalid="ignore"):  # NaN: beside the stock
            stays &= ~(beside <= staying["centre"][:, 2] + 2.0 * after.params.level_step)
    return stays


def remaining_walls(ideal: IdealPart, path: Stations, error: np.ndarray) -> Walls:
    """The walls of the finished part, given actual minus target tool centres (n + 1, 3) [m]."""
    hits, k = ideal.marks, ideal.marks["period"]
    staying = hits[ideal.staying]
    moved = (error[k] + hits["share"][:, None] * (error[k + 1] - error[k]))[:, :2].copy()
    own = np.einsum("kd,kd->k", moved[ideal.staying], staying["normal"])
    _fill_reach(moved, np.ascontiguousarray(staying["normal"]), *ideal.near, own)
    position = np.column_stack([tooth_tips(staying), staying["centre"][:, 2]])
    return Walls(position, -staying["normal"], ideal.wall_height, -own, path.feature[staying["period"]])


def neighbours(hits: np.ndarray, staying: np.ndarray, level: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the marks on the wall of each staying mark that are near it.

    The number of them, (k,), their indices, (m,), and how far a rigid tooth reaches at the mark [m], (m,). A mark has
    none where a tool rests so long that all the nearest marks are of other walls.
    """
    chunk = 5_000  # marks at once, with the neighbours of each 25 kB
    counts, indices, reaches = [np.zeros(0, int)], [np.zeros(0, int)], [np.zeros(0)]
    if staying.size:
        tree = cKDTree(tooth_tips(hits), balanced_tree=False, compact_nodes=False)
    deepest = 20e-6  # [m]; marks this much deeper than their neighbours still are weighed against them
    most = 48  # marks; a tool that rests marks one place with every tooth
    parallel = 0.98  # cosine between normals of one wall
    for first in range(0, staying.size, chunk):
        mine = hits[staying[first : first + chunk]]
        place, normal = tooth_tips(mine), mine["normal"]
        bound = float(np.sqrt(2.0 * hits["radius"].max() * deepest))
        _, near = tree.query(place, k=min(most, len(hits)), distance_upper_bound=bound)
        near = near.reshape(len(mine), -1)
        exists = near < len(hits)
        near = np.where(exists, near, 0)
        theirs = hits[near]
        same = exists & (np.einsum("mkd,md->mk", theirs["normal"], normal) > parallel)
        same &= theirs["centre"][..., 2] <= mine["centre"][:, None, 2] + level  # a higher pass does not touch it
        away = theirs["centre"][..., :2] - place[:, None]
        across = away[..., 0] * normal[:, None, 1] - away[..., 1] * normal[:, None, 0]
        arc = np.sqrt(np.maximum(theirs["radius"] ** 2 - across**2, 0.0))
        counts.append(same.sum(axis=1))
        indices.append(near[same])
        reaches.append((np.einsum("mkd,md->mk", away, normal) + arc)[same])
    return np.concatenate(counts), np.concatenate(indices), np.concatenate(reaches)


@njit(cache=True, nogil=True)
def _fill_reach(moved, normal, counts, near, rigid, own):
    """Replace the reach of each tooth [m], (k,), by that of the farthest tooth near it, beyond that of rigid teeth.

    moved (m, 2) [m]: shifts of the teeth; normal (k, 2); counts, near, rigid: of ``neighbours``.
    """
    n = 0
    for k in range(own.size):
        farthest = most = -np.inf
        for _ in range(counts[k]):
            shift = moved[near[n], 0] * normal[k, 0] + moved[near[n], 1] * normal[k, 1]
            farthest, most = max(farthest, rigid[n] + shift), max(most, rigid[n])
            n += 1
        if counts[k]:
            own[k] = farthest - most


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
class IdealPart:
    """The part of a rigid arm: thinned, so that a large workpiece takes little memory."""

    x: np.ndarray  #: [m], (a,)
    y: np.ndarray  #: [m], (b,)
    height: np.ndarray  #: [m], (a, b)
    owner: np.ndarray  #: index of the feature that made each floor, (a, b); -1: none
    marks: np.ndarray  #: MARK, below the top of the stock
    staying: np.ndarray  #: indices of the marks on a wall that stays, (k,)
    wall_height: np.ndarray  #: height of the wall there [m], (k,)
    near: tuple[np.ndarray, np.ndarray, np.ndarray]  #: neighbours of these marks, see ``neighbours``
    level: float  #: level step of the height map [m]
    thinning: int
    unjudged: np.ndarray  #: floors of holes and of other tools, (a, b) bool


def ideal_part(cell: Cell, path: Stations, target: np.ndarray, cut: CutModel | None = None) -> IdealPart:
    """The part after a rigid arm moved the tool tip through ``target`` (n + 1, 3) [m]; cut: where it did so already.

    In a program with several tools, the rigid arm made the paths of the earlier tools before. Walls and floors
    belong to the last tool that passes there.
    """
    cut = cut or machined(cut_of(cell, rigid=True), target, path_of(cell).clock, path_of(cell).target)
    level = cut.params.level_step
    x, y, height = cut.map_heights()
    owner = _owners(x, y, height, path, target, cell.tool.radius, level, float(cell.stock.max[2]))
    passages = marks(cell.tool, path, path_of(cell).clock.period, target)
    below = passages["centre"][:, 2] < cell.stock.max[2] - level
    passages = passages[below & flat_floors(cell)]  # the sides of another end are part of the surface
    staying, wall_height = _staying(cut, passages)
    if cell.stage:
        mine = swept((removal_of(cell),), cell.stock, False)
        owner = np.where(mine.map_heights()[2] <= height + 2.0 * level, owner, -1)
        if cell.stage.later:
            after = cleared(cell.stage.later, cell.stock, False)
            owner = np.where(after.map_heights()[2] <= height + 2.0 * level, -1, owner)
            stays = _not_passed(after, passages[staying])
            staying, wall_height = staying[stays], wall_height[stays]
    unjudged = _drilled(x, y, height, target[path.drilling], cell.tool.radius, 2.0 * level)
    if cell.stage:
        unjudged |= owner < 0
    thinning = cut.map_thinning
    near = neighbours(passages, staying, 2.0 * level)
    return IdealPart(x, y, height, owner, passages, staying, wall_height, near, level, thinning, unjudged)


def surface(
    cell: Cell,
    path: Stations,
    target: np.ndarray,
    actual: np.ndarray,
    ideal: IdealPart,
    heights: np.ndarray | None = None,
) -> tuple[Floors, Walls]:
    """Surface errors of a pass with tool centres ``actual`` where ``target`` was wanted, (n + 1, 3) [m].

    ideal: the part that the target itself leaves; heights (a, b) [m]: of the pass's own finished workpiece, which is
    made by a sweep where it is not known already.
    """
    walls = remaining_walls(ideal, path, actual - target)
    if heights is None or heights.shape != ideal.height.shape:
        heights = machined(cut_of(cell), actual, path_of(cell).clock, path_of(cell).target).map_heights()[2]
    if not flat_floors(cell):
        return _curved(cell.stock, ideal, heights), walls
    error = actual - target
    largest = float(np.abs(error[:, :2]).max(initial=0.0))
    upward = float(error[target[:, 2] < cell.stock.max[2], 2].max(initial=0.0))
    return _floors(cell.stock, ideal, heights, largest, upward), walls


def _floors(stock: Stock, ideal: IdealPart, height: np.ndarray, largest: float, upward: float) -> Floors:
    """largest: deviation in the plane [m]; nodes that are nearer to a wall may be on its other side.

    upward: deviation of the tool below the top of the stock [m]. The end of the tool leaves no node higher than that
    above the floor: such a node is of a thin fin beside the rim, where two passes only touch, and its error is lateral.
    """
    spacing = stock.grid_step * ideal.thinning
    width = 1 + 2 * int(np.ceil((largest + 2.0 * stock.grid_step) / spacing))
    rise = maximum_filter(ideal.height, width, mode="nearest") - minimum_filter(ideal.height, width, mode="nearest")
    floor = (
        ~ideal.unjudged
        & (rise <= 2.0 * ideal.level + SLOPE * width * spacing)
        & (ideal.height < stock.max[2] - 0.5 * ideal.level)
    )
    floor &= height - ideal.height <= upward + 2.0 * ideal.level + stock.floor_tolerance + SLOPE * largest
    error = np.where(floor, height - ideal.height, np.nan)
    return Floors(ideal.x, ideal.y, ideal.height, error, ideal.owner)


def _curved(stock: Stock, ideal: IdealPart, height: np.ndarray) -> Floors:
    """The error along the normal of the rigid arm's surface: the difference of heights times the cosine of the slope.

    Places steeper than 70 deg are left out: the nodes of the map do not resolve them.
    """
    steep = 2.75  # assumed, tangent of 70 deg: on a steeper surface a node of the map is three of its steps high
    spacing = stock.grid_step * ideal.thinning
    slope = np.hypot(*np.gradient(ideal.height, spacing))
    cut = ~ideal.unjudged & (slope < steep) & (ideal.height < stock.max[2] - 0.5 * ideal.level)
    border = maximum_filter(~cut, 3, mode="constant")  # the slope there is that of an edge
    error = np.where(cut & ~border, (height - ideal.height) / np.hypot(1.0, slope), np.nan)
    return Floors(ideal.x, ideal.y, ideal.height, error, ideal.owner, curved=True)


def _owners(x, y, height, path: Stations, target: np.ndarray, radius: float, level: float, top: float) -> np.ndarray:
    """(a, b): the feature that was last at the height of each node, -1 where none was; top [m]: of the stock."""
    owner = np.full(height.shape, -1, np.int64)
    reach = 0.25 * radius
    rise = np.abs(path.tangent[:, 2])
    slack = np.where(rise < 0.5, rise * reach, 0.0) + 2.0 * level  # a plunge leaves its floor at the last point
    _fill_owners(x, y, height, target, slack, path.feature, _stations(path, target, reach), radius, top + level, owner)
    _, nearest = distance_transform_edt(owner < 0, return_indices=True)
    return np.where(height < top - 0.5 * level, owner[tuple(nearest)], -1)  # slivers between two of these places


@njit(cache=True, nogil=True)
def _fill_owners(x, y, height, target, slack, feature, stations, radius, highest, owner):
    """Write the feature of each station that is as high as a node below the tool; highest [m]: of a station."""
    for k in stations:
        if target[k, 2] > highest:
            continue
        first_i, last_i = np.searchsorted(x, target[k, 0] - radius), np.searchsorted(x, target[k, 0] + radius)
        first_j, last_j = np.searchsorted(y, target[k, 1] - radius), np.searchsorted(y, target[k, 1] + radius)
        for i in range(first_i, last_i):
            for j in range(first_j, last_j):
                away = (x[i] - target[k, 0]) ** 2 + (y[j] - target[k, 1]) ** 2
                if away < radius**2 and abs(height[i, j] - target[k, 2]) <= slack[k]:
                    owner[i, j] = feature[k]


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
