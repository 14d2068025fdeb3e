"""The workpiece: depth of cut at each node of a grid, stored in tiles where the tool has been (Figs. 5, 6).

A node represents one cell of ``grid_step`` squared, at the cell's middle. The node stores the depth removed below the
stock's top in levels of thickness / 65535 (0: untouched). With the tool at one height this is the paper's 1/0 grid.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from kr270_milling.base.errors import ParameterError
from kr270_milling.base.record import Record, parameter, stated

TILE = 256  # nodes along a tile's side; the compiled code shifts by 8 and 16 bits
LEVELS = 65535
RESOLVED_NODES = 10.0  #: nodes that a tooth meets in a micro-step, with which a slot has 97 % of its force
MAX_TILES = 32768  # of 128 KiB each; a node's place in the pool then fits an int32


@dataclass(frozen=True, eq=False)
class Stock(Record):
    """A box of material, axes of the workpiece frame, and the grid laid over it."""

    min: np.ndarray = parameter(unit="mm", size=3, low=-1e5, high=1e5, text="lower corner in the workpiece frame")
    max: np.ndarray = parameter(unit="mm", size=3, low=-1e5, high=1e5, text="upper corner in the workpiece frame")
    grid_step: float = parameter(
        10e-6,
        unit="um",
        low=0.5,
        high=1000.0,
        text="distance of grid nodes, ds; a file without it: by tool and feed, so that the teeth meet enough nodes",
    )
    engagement_step: float = parameter(
        200e-6,
        unit="um",
        low=0.5,
        high=1000.0,
        text="distance of grid nodes where cutting.detail is engagement; at most 1/50 of the radius of the tool",
    )
    floor_tolerance: float = parameter(
        1e-6, unit="um", low=0.0, high=100.0, text="how far the tool may sink before its whole footprint is cut again"
    )

    def check(self) -> None:
        if not np.all(self.max - self.min >= [self.grid_step, self.grid_step, 1e-6]):
            raise ParameterError("max_mm", (1e3 * self.max).tolist(), "above min_mm in x, y and z by a grid step")
        # the table takes 4 bytes for each tile, used or not
        if max(self.nodes) > 2**30 or math.prod(tile_count(self)) > 1 << 24:
            raise ParameterError("grid_step_um", 1e6 * self.grid_step, "larger: the grid has too many nodes")

    def for_engagement(self, radius: float) -> Stock:
        """Return the stock with the grid of the mean-force model; radius [m]: of the tool."""
        # the mean-force model needs 50 nodes in the radius of the tool
        return self.replace(grid_step=min(self.engagement_step, radius / 50))

    def for_teeth(self, radius: float, micro_step: float, feeds: tuple[float, float], length: float) -> Stock:
        """Return the stock with a grid for the sweep of the teeth; a grid step that the file states stays.

        The grid step is a fifth of the largest feed per tooth, of thin chips up to 3/8 of it, above which a grid has
        noise. A tooth at the slow feed meets ``RESOLVED_NODES``, f R dphi / ds^2. radius [m]: of the tool; micro_step
        [rad]; feeds: largest and slow feed per tooth [m], 0: not known; length of the path [m].
        """
        if stated(self, "grid_step"):
            return self
        largest, slow = feeds
        fine, finest, coarsest = 20e-6, 5e-6, 100e-6  # [m], assumed: half the step takes four times as long
        widest = 0.05 * radius  # with fewer nodes across a cut its force is noise
        most_nodes = 1e8  # assumed: 200 MB
        wanted = min(max(0.2 * largest, min(fine, 0.375 * largest)) or fine, widest, coarsest)
        resolved = math.sqrt(slow * radius * micro_step / RESOLVED_NODES) or wanted
        area = min(math.prod((self.max - self.min)[:2]), 2.0 * radius * (length + 2.0 * radius))
        step = max(min(wanted, resolved), math.sqrt(area / most_nodes), finest)
        return self.replace(grid_step=1e-6 * math.floor(1e6 * step + 1e-6))  # whole um

    @property
    def nodes(self) -> tuple[int, int]:
        """Nodes along x and y."""
        nx, ny = np.maximum(1, np.rint((self.max - self.min)[:2] / self.grid_step)).astype(int)
        return int(nx), int(ny)

    @property
    def thickness(self) -> float:
        """Height of the box [m]."""
        return float(self.max[2] - self.min[2])

    @property
    def level_step(self) -> float:
        """Depth of one level [m]."""
        return self.thickness / LEVELS


def tile_count(stock: Stock) -> tuple[int, int]:
    """Tiles along x and y."""
    nx, ny = stock.nodes
    return -(-nx // TILE), -(-ny // TILE)


def levels_in_window(pool: np.ndarray, table: np.ndarray, ix: np.ndarray, iy: np.ndarray) -> np.ndarray:
    """Removed levels (ix.size, iy.size) at the nodes with the column numbers ix and the row numbers iy."""
    out = np.zeros((ix.size, iy.size), np.uint16)
    for tx in np.unique(ix // TILE):
        rows = np.flatnonzero(ix // TILE == tx)
        for ty in np.unique(iy // TILE):
            if table[tx, ty] >= 0:
                columns = np.flatnonzero(iy // TILE == ty)
                tile = pool[table[tx, ty] * TILE**2 :][: TILE**2].reshape(TILE, TILE)
                out[np.ix_(rows, columns)] = tile[np.ix_(ix[rows] % TILE, iy[columns] % TILE)]
    return out
