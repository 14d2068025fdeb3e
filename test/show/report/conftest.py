"""A milled part, a straight cut and their passes, for all tests of reports."""

import pytest
from samples.milled_part import POCKET, small_cell

from kr270_milling.base.parameter_file import find_file
from kr270_milling.cell.cell_file import read_cell
from kr270_milling.cell.jobs import compensated, simulate


def _passes(cell):
    original = simulate(cell)
    return cell, [original, *(compensated(cell, original, method) for method in ("linear", "spline"))]


@pytest.fixture(scope="session")
def milled(tmp_path_factory):
    """A part with a tolerance of 30 um: its cell, and the passes original, linear, spline."""
    return _passes(small_cell(tmp_path_factory.mktemp("milled"), POCKET, "part.tolerance_um=30"))


@pytest.fixture(scope="session")
def straight():
    """A short cut of the paper's cell: the cell, and the passes original, linear, spline."""
    return _passes(read_cell(find_file("paper.yaml"), ["path.length_mm=12.0", "stock.grid_step_um=40.0"]))
