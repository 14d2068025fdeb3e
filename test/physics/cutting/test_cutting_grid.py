"""The stock's record, its levels and its tiles."""

from __future__ import annotations

import numpy as np
import pytest

from kr270_milling.base.errors import ConfigError
from kr270_milling.base.record import build
from kr270_milling.physics.cutting import Stock
from kr270_milling.physics.cutting.grid import TILE, levels_in_window, tile_count

BOX = {"min_mm": [0.0, -12.0, -10.0], "max_mm": [100.0, 12.0, 0.0]}


def test_stock_counts_its_nodes_and_tiles():
    stock = build(Stock, {**BOX, "grid_step_um": 10.0})
    assert stock.nodes == (10000, 2400)
    assert tile_count(stock) == (40, 10)
    assert stock.level_step * 65535 == pytest.approx(10e-3)


@pytest.mark.parametrize(
    "change",
    [
        {"max_mm": [100.0, -12.0, 0.0]},
        {"max_mm": [100.0, 12.0, -10.0]},
        {"max_mm": [100.0, 12.0]},
        {"max_mm": [float("inf"), 12.0, 0.0]},
        {"grid_step_um": 0.0},
    ],
)
def test_impossible_stocks_are_refused(change):
    with pytest.raises(ConfigError):
        build(Stock, {**BOX, **change})


def test_windows_are_put_together_from_tiles_wherever_they_lie_in_the_pool():
    rng = np.random.default_rng(1)
    whole = rng.integers(0, 65535, (3 * TILE, 2 * TILE)).astype(np.uint16)
    table = np.array([[4, 0], [-1, 2], [1, 3]], np.int32)
    whole[TILE : 2 * TILE, :TILE] = 0
    pool = np.zeros(5 * TILE**2, np.uint16)
    for (tx, ty), slot in np.ndenumerate(table):
        if slot >= 0:
            tile = whole[tx * TILE : (tx + 1) * TILE, ty * TILE : (ty + 1) * TILE]
            pool[slot * TILE**2 : (slot + 1) * TILE**2] = tile.ravel()
    ix, iy = np.arange(200, 700, 3), np.arange(100, 300, 7)
    assert np.array_equal(levels_in_window(pool, table, ix, iy), whole[np.ix_(ix, iy)])
