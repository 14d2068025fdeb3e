"""The finished workpiece of a pass: its stock swept once more along the tool centres of the pass."""

from __future__ import annotations

import numpy as np

from kr270_milling.cell.cell import Cell
from kr270_milling.cutting import Cut
from kr270_milling.cutting.grid import TILE

__all__ = ["heights_at", "machined"]


def machined(cell: Cell, positions: np.ndarray) -> Cut:
    """A fresh workpiece after the tool tip went through positions (n + 1, 3) [m], one exchange period from each to the
    next, workpiece frame. Positions that are the target's leave the part of a rigid arm. Raises GridError."""
    cut = cell.cut()
    cut.along(positions, np.arange(len(positions)) * cell.clock.micro_steps)
    return cut


def heights_at(cut: Cut, xy: np.ndarray) -> np.ndarray:
    """The part's surface z [m], (m,), at the nodes nearest to points (m, 2) [m]; NaN beside the stock."""
    stock, state = cut.stock, cut.state
    place = (np.asarray(xy, float) - stock.min[:2]) / stock.grid_step
    inside = np.all((place >= 0) & (place < stock.nodes), axis=1)
    ix, iy = np.floor(np.where(inside[:, None], place, 0.0)).astype(np.int64).T
    slot = state.table[ix // TILE, iy // TILE].astype(np.int64)
    index = (np.maximum(slot, 0) * TILE + ix % TILE) * TILE + iy % TILE
    level = np.where(slot >= 0, state.pool[index], 0)
    return np.where(inside, stock.max[2] - level * cut.params.level_step, np.nan)
