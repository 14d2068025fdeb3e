"""The finished workpiece of a pass: its stock swept once more, its heights, and the part as a closed binary STL."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from kr270_milling.base.files import write_files
from kr270_milling.base.frames import tool_axis
from kr270_milling.path.trajectory import Trajectory
from kr270_milling.physics.cutting import CutModel
from kr270_milling.physics.cutting.grid import TILE
from kr270_milling.physics.motion.milling_pass import PassResult
from kr270_milling.physics.motion.periods import Clock

TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def machined(cut: CutModel, positions: np.ndarray, clock: Clock, run: Trajectory | None = None) -> CutModel:
    """Move the tool tip through positions (n + 1, 3) [m] of a fresh workpiece, and return the workpiece.

    One exchange period lies between two positions, workpiece frame. Positions of the target leave the part of a rigid
    arm. run: states the axis of a tool that tilts. Raises MillingError.
    """
    steps, axes = np.arange(len(positions)), None
    if run is not None and cut.tilts:
        axes = tool_axis(run.sample_orientation(clock.stamp(steps)))
    cut.along(positions, steps * clock.micro_steps, axes=axes)
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
    stock = cut.stock
    x, y, z = lattice or cut.heights(thinning=_thinning(cut))
    x, y = (np.concatenate([[stock.min[k]], axis, [stock.max[k]]]) for k, axis in enumerate((x, y)))  # to the borders
    least = stock.min[2] + cut.params.level_step  # where the tool went through, a skin is left: the surface is one
    z = np.maximum(np.pad(z, 1, mode="edge"), least)
    triangles = _triangles(x * 1e3, y * 1e3, z * 1e3, float(stock.min[2]) * 1e3)
    record = np.zeros(len(triangles), TRIANGLE)
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
