"""Softer ramps of the path as a lever beside the correction."""

from __future__ import annotations

import pytest
from samples.small_part import GCODE, small_part

from kr270_milling.base.errors import InputError
from kr270_milling.base.parameter_file import find_file
from kr270_milling.cell.cell_file import read_cell
from kr270_milling.cell.models import path_of
from kr270_milling.decide.compensation import compensate
from kr270_milling.decide.levers import RATIOS, levers, softened


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
