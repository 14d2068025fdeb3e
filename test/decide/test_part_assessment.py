"""Per-feature results of passes along tool paths."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest
from milled_part import CONFIG, HEAD, POCKET, RADIUS, RIGID, SLOT, small_cell

from kr270_milling.base.errors import InputError
from kr270_milling.cell.cell import read_cell
from kr270_milling.cell.jobs import simulate
from kr270_milling.decide.part import assess, assess_all, machined


@pytest.fixture(scope="module")
def cell(tmp_path_factory):
    return small_cell(tmp_path_factory.mktemp("assessment"), POCKET)


@pytest.fixture(scope="module")
def ran(cell):
    return simulate(cell)


@pytest.fixture(scope="module")
def part(cell, ran):
    return assess(cell, ran)


def test_each_feature_that_cuts_has_a_row_and_the_whole_part_is_the_worst_of_them(part):
    assert [row.name for row in part.rows] == ["side", "ring"]
    for key in ("max_normal", "max_vertical", "max_wall", "max_floor", "max_force", "max_torque", "max_power"):
        values = [getattr(row, key) for row in part.rows]
        assert getattr(part.whole, key) == max(values) > 0
    assert part.whole.cut_length == pytest.approx(sum(row.cut_length for row in part.rows))
    for row in part.rows:
        assert row.mean_normal < row.quantile_normal < row.max_normal


def test_a_wall_is_off_by_what_the_tool_deviated_when_it_made_it(part):
    walls = part.surface.walls
    for row in part.rows:
        assert row.max_wall < 1.05 * row.max_normal + 1e-6
    # the tool deviates by tens of micrometres, and a wall far from entry and exit shows it
    assert np.quantile(np.abs(walls.error), 0.9) > 5e-6


def test_nothing_is_cut_in_the_air(cell, ran, part):
    result, stock = ran.result, cell.stock
    above = np.minimum(result.tool[:-1, 2], result.tool[1:, 2]) > stock.max[2]
    beside = np.abs(result.tool[1:, 0]) > stock.max[0] + RADIUS + 1e-3
    air = np.append(False, above | beside)
    assert air.sum() > 100 and not part.cutting[air].any()
    assert np.all(part.force[air] == 0) and np.all(part.power[air] == 0)
    assert part.whole.cut_length < 0.8 * part.path.distance[-1]


def test_a_feature_in_the_air_has_no_row(tmp_path):
    air = SLOT.replace("M5", "(air)\nG0 X-28 Y0 Z2\nG1 X28\nM5")
    cell = small_cell(tmp_path, air)
    assert [row.name for row in assess(cell, simulate(cell)).rows] == ["slot"]


def test_power_is_torque_times_spindle_speed_and_chips_sum_up_to_the_removed_volume(cell, ran, part):
    np.testing.assert_allclose(part.power, part.torque * cell.tool.spindle_speed, rtol=1e-12)
    assert ran.result.volume.sum() == pytest.approx(ran.result.removed_volume, rel=1e-9)


def test_mean_torque_of_a_rigid_slot_is_that_of_the_linear_edge_law(tmp_path):
    cell = small_cell(tmp_path, SLOT, RIGID, "stock.grid_step_um=20.0", "exchange.micro_step_deg=1.0")
    found = assess(cell, simulate(cell))
    full = np.abs(found.path.distance - 30e-3 - 2e-3) < 8e-3  # plunge of 3 mm, then x from -28 to 28: in the middle
    full = full[: full.size]
    law, depth, feed = cell.cutting.linear_edge, 1e-3, 0.25e-3
    # each of the teeth cuts over half a turn with h = f_z sin: mean of F_t is (2 K_tc f_z + pi K_te) a / (2 pi)
    per_tooth = (2 * law.tangential_cutting * feed + np.pi * law.tangential_edge) * depth / (2 * np.pi)
    turns = int(full.sum() // 20) * 20  # periods of 18 deg
    mean = found.torque[np.flatnonzero(full)[:turns]].mean()
    assert mean == pytest.approx(cell.tool.teeth * per_tooth * RADIUS, rel=0.015)


def test_a_rigid_arm_has_no_deviation_in_any_row(tmp_path):
    cell = small_cell(tmp_path, POCKET, RIGID)
    for row in assess(cell, simulate(cell)).table():
        assert all(value < 1e-5 for key, value in row.items() if key.endswith("_um"))  # 1e-5 um


def test_several_passes_share_the_ideal_part(cell, ran, part):
    first, second = assess_all(cell, [ran, ran])
    assert first.table() == second.table() == part.table()


def test_the_table_is_plain_and_its_keys_end_in_units(part):
    text = json.dumps(part.as_dict())
    assert "numpy" not in text
    assert [row["feature"] for row in part.table()] == ["side", "ring", "whole part"]
    for key in part.table()[0]:
        assert key == "feature" or key.rsplit("_", 1)[1] in ("mm", "um", "n", "m", "w")


def test_the_papers_straight_cut_can_be_assessed_as_a_part():
    cell = read_cell(CONFIG / "paper.yaml", ["stock.grid_step_um=40.0"])
    ran = simulate(cell)
    part = assess(cell, ran)
    assert [row.name for row in part.rows] == ["straight cut"]
    last = part.deviation[-(len(part.deviation) // 4) :, 1]
    assert last.mean() == pytest.approx(ran.scores.static_deviation, rel=1e-9)
    walls = part.surface.walls
    settled = walls.position[:, 0] > 50e-3
    assert settled.sum() > 100  # both walls are off by the static deviation, to opposite sides of the material
    np.testing.assert_allclose(np.abs(walls.error[settled]), np.abs(last.mean()), atol=5e-6)
    assert set(np.sign(walls.error[settled])) == {-1.0, 1.0}


def test_a_spindle_speed_that_is_not_the_cells_is_refused_with_both(tmp_path):
    cell = small_cell(tmp_path, SLOT.replace("S6000", "S5000"))
    with pytest.raises(InputError, match=r"line 5: .*S5000.*6000"):
        cell.target()


def test_a_path_that_misses_the_stock_is_refused(tmp_path):
    for start, move in (("X-28 Y25 Z-1", "X28"), ("X-28 Y0 Z0.5", "X28")):
        cell = small_cell(tmp_path, HEAD + f"G0 {start}\nG1 {move} F3000\n")
        with pytest.raises(InputError, match="never reaches the stock"):
            cell.target()


def test_the_workpiece_of_the_pass_itself_gives_what_a_sweep_along_the_pass_gives(cell, ran, part):
    """The pass cut with the predicted tool centre, here within 2 um of the corrected one: nodes at the very edge of a
    tooth's way may fall to another tooth."""
    assert np.array_equal(machined(cell, ran.result.tool).map_heights()[2], ran.result.heights)
    again = assess(cell, dataclasses.replace(ran, result=dataclasses.replace(ran.result, heights=None)))
    differ = np.abs(part.surface.floors.error - again.surface.floors.error)
    assert np.nanquantile(differ, 0.999) <= part.surface.floor_resolution
    assert part.whole.max_floor == pytest.approx(again.whole.max_floor, abs=ran.result.correction.max())
