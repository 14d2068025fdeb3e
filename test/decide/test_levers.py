"""Softer ramps of the path as a lever beside the correction."""

from __future__ import annotations

import numpy as np
import pytest
from samples.small_part import GCODE, small_part

from kr270_milling.base.errors import InputError, ParameterError
from kr270_milling.base.parameter_file import find_file
from kr270_milling.cell.cell_file import read_cell
from kr270_milling.cell.jobs import simulate
from kr270_milling.cell.models import cut_of, path_of
from kr270_milling.decide.compensation import compensate
from kr270_milling.decide.levers import RATIOS, levers, softened
from kr270_milling.decide.tolerance import after_passes, judge

WALL = """\
G21 G90 S8000 M3
G0 X{} Y40 Z5
G0 Z-0.5
(wall)
G1 X{} F2000
G0 Z5
M30
"""


@pytest.mark.parametrize("ends, share", [((-14, 54), 0.1), ((54, -14), 1.0)], ids=["conventional", "climb"])
def test_a_finishing_pass_cuts_what_the_first_one_leaves_and_fills_no_overcut(tmp_path, ends, share):
    def ran(*more):
        settings = "cutting.detail=engagement", "stock.max_mm=[40,34,0]", "part.tolerance_um=50", *more
        cell = small_part(tmp_path, WALL.format(*ends), *settings)
        return cell, simulate(cell)

    single, (cell, both) = ran(), ran("compensation.finish=1")
    one, two = after_passes(cell, both)
    assert one["wall_um"] == pytest.approx(1e6 * judge(*single).wall, rel=1e-3)
    assert two["wall_um"] == pytest.approx(1e6 * judge(cell, both).wall, rel=1e-9)
    assert two["wall_um"] == pytest.approx(share * one["wall_um"], abs=0.1 * one["wall_um"])
    assert two["end_s"] > 1.9 * one["end_s"] and two["max_force_n"] < 0.05 * one["max_force_n"]


def test_a_second_pass_removes_the_volume_that_the_first_one_leaves():
    cell = read_cell(find_file("test_piece.yaml"), ["cutting.detail=engagement"])
    cut, low, depth, left = cut_of(cell), cell.stock.min, 1e-3, 60e-6  # [m]
    for shift, end in ((left, 70e-3), (0.0, 45e-3)):
        x = np.linspace(low[0] + 15e-3, low[0] + end, 1200)
        path = np.column_stack([x, np.full(1200, low[1] + 3e-3 - shift), np.full(1200, cell.stock.max[2] - depth)])
        volume = cut.along(path, np.arange(1200) * 100)[2]
    assert volume[400:].sum() == pytest.approx(depth * left * (x[-1] - x[399]), rel=0.02)


def test_a_straight_cut_has_no_finishing_pass():
    cell = read_cell(find_file("paper.yaml"), ["compensation.finish=1"])
    with pytest.raises(ParameterError, match="compensation.finish"):
        path_of(cell)


def test_softer_ramps_take_at_most_the_stated_time(tmp_path):
    cell = small_part(tmp_path, GCODE, "cutting.detail=engagement")
    plain = path_of(cell).target.duration_ns
    for ratio in RATIOS:
        softer = softened(cell, ratio)
        assert (0.97 * ratio if ratio > 1.0 else 1.0) <= path_of(softer).target.duration_ns / plain <= ratio
        scale = softer.timing.acceleration / cell.timing.acceleration
        assert softer.timing.jerk / cell.timing.jerk == pytest.approx(scale**2, rel=0.01)


def test_the_first_rows_are_those_of_the_verdict_and_the_last_is_the_first_that_is_enough(tmp_path):
    cell = small_part(
        tmp_path, GCODE, "cutting.detail=engagement", "part.tolerance_um=80", "compensation.method=inverse"
    )
    rows = [lever for lever, _ in levers(cell, 4, 1, "SPLINE")]
    verdict = compensate(cell, robots=4, seed=1, motions=("SPLINE",)).decision.verdict
    assert [rows[0].median, rows[1].median] == pytest.approx([verdict.band(k)[1] for k in ("original", "compensated")])
    assert rows[1].within == verdict.within
    assert [row.enough for row in rows[1:-1:2]] == [False] * (len(rows) // 2 - 1)
    assert rows[-1].enough or rows[-1].duration > 1.45 * rows[0].duration


def test_a_cell_without_ramps_or_without_a_tolerance_has_no_lever(tmp_path):
    for cell in (read_cell(find_file("paper.yaml")), small_part(tmp_path, GCODE, "part.tolerance_um=0")):
        with pytest.raises(InputError, match="--reach: needs part.tolerance_um, and a program"):
            levers(cell, 4, 1, "SPLINE")
