import numpy as np
import pytest

from bench.models import plain_pass
from bench.recorder import bench_writer
from kr270_milling import read_cell


def test_the_writer_is_not_much_slower_than_that_of_mcap():
    """A quarter of the rate is far from the measured three quarters, and far from a mistake of an order."""
    rates = [bench_writer(small=2000, large=2) for _ in range(3)]  # other processes may slow down one of them
    assert max(rate["bag_small_per_s"] / rate["plain_small_per_s"] for rate in rates) > 0.25


def test_the_yardstick_of_the_pass_does_the_same_work():
    """The static deviation is the 58.1 um of the paper, and the slot is the same."""
    cell = read_cell("paper.yaml")
    grid, deflection = plain_pass(cell, 57_600)
    assert 1e6 * deflection[-14_400:, 1].mean() == pytest.approx(58.1, rel=0.01)
    removed = np.count_nonzero(grid == 0) * cell.stock.grid_step**2
    assert removed == pytest.approx(2 * cell.tool.radius * cell.path.length, rel=0.1)
