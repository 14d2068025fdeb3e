"""A milled part and its passes, for all tests of reports."""

from __future__ import annotations

import pytest
from milled_part import POCKET, small_cell

from kr270_milling.cell.jobs import compensated, simulate


@pytest.fixture(scope="session")
def milled(tmp_path_factory):
    """A part with a tolerance of 30 um: its cell, and the passes original, linear, spline."""
    cell = small_cell(tmp_path_factory.mktemp("milled"), POCKET, "part.tolerance_um=30")
    original = simulate(cell)
    return cell, [original, *(compensated(cell, original, method) for method in ("linear", "spline"))]
