from __future__ import annotations

import numpy as np
import pytest

from bench.plain_pass import plain_pass
from bench.writer import bench_writer
from kr270_milling.base.parameter_file import find_file
from kr270_milling.cell.cell import read_cell


def test_the_yardstick_measures_both_writers():
    rates = bench_writer(small=2000, large=5)
    assert set(rates) == {f"{w}_{k}" for w in ("plain", "bag") for k in ("small_per_s", "large_mb_per_s")}
    assert all(rate > 0 for rate in rates.values())
    # half the plain writer's rate is far from the measured three quarters, and far from a mistake of an order
    assert rates["bag_small_per_s"] > 0.25 * rates["plain_small_per_s"]


def test_the_yardstick_of_the_pass_does_the_same_work():
    """The static deviation is the 58.1 um of the paper, and the slot is the same."""
    cell = read_cell(find_file("paper.yaml"))
    grid, deflection = plain_pass(cell, 57_600)
    assert 1e6 * deflection[-14_400:, 1].mean() == pytest.approx(58.1, rel=0.01)
    removed = np.count_nonzero(grid == 0) * cell.stock.grid_step**2
    assert removed == pytest.approx(2 * cell.tool.radius * cell.path.length, rel=0.1)
