"""The finished workpiece of a pass, swept once more."""

from __future__ import annotations

import numpy as np
import pytest
from milled_part import POCKET, small_cell

from kr270_milling.cell.jobs import simulate
from kr270_milling.decide.part import heights_at, machined
from kr270_milling.physics.cutting import GridError


@pytest.fixture(scope="module")
def cell(tmp_path_factory):
    return small_cell(tmp_path_factory.mktemp("machined"), POCKET)


def test_sweeping_the_positions_of_a_pass_again_removes_the_same_material(cell):
    result = simulate(cell).result
    again = machined(cell, result.tool)
    assert again.removed_volume == pytest.approx(result.removed_volume, rel=1e-12)
    assert again.removed_volume == pytest.approx(result.volume.sum(), rel=1e-9)


def test_heights_at_points_are_those_of_the_map(cell):
    cut = machined(cell, simulate(cell).result.tool)
    x, y, z = cut.heights(thinning=7)
    points = np.stack(np.meshgrid(x, y, indexing="ij"), -1).reshape(-1, 2)
    np.testing.assert_array_equal(heights_at(cut, points).reshape(z.shape), z)
    assert len(np.unique(z)) > 3


def test_a_stock_without_room_for_its_tiles_is_an_error(cell, monkeypatch):
    monkeypatch.setattr("kr270_milling.physics.cutting.state.MAX_TILES", 2)
    with pytest.raises(GridError):
        machined(cell, cell.target().sample(np.arange(0, cell.target().duration_ns, 500_000)))
