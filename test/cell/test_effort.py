from __future__ import annotations

import numpy as np
import pytest
from small_part import small_part

from kr270_milling.base.errors import ConfigError, MillingError, ParameterError
from kr270_milling.base.record import find_file
from kr270_milling.cell.cell import read_cell
from kr270_milling.cell.jobs import simulate
from kr270_milling.cell.path import MOST_VISITS, check_effort, check_postures, sinking

FILE = find_file("paper.yaml")
CELL = read_cell(FILE)
HEAD = "G21 G90 S8000 M3\n"


@pytest.mark.parametrize(
    ("assignments", "key"),
    [
        (["tool.spindle_speed_rpm=200000", "tool.teeth=99", "exchange.micro_step_deg=.01"], "exchange.micro_step_deg"),
        (["exchange.iterations=20", "tool.teeth=16", "path.feed_rate_m_per_min=0.002"], "exchange.micro_step_deg"),
        (["stock.min_mm=[-1e5,-1e5,-10]", "stock.max_mm=[1e5,1e5,0]"], "stock.grid_step_um"),
        (["path.feed_rate_m_per_min=1e-7"], "path.feed_rate_m_per_min"),
    ],
)  # fmt: skip
def test_a_pass_of_days_is_refused_when_the_cell_is_read(assignments, key):
    with pytest.raises(ConfigError) as caught:
        read_cell(FILE, assignments)
    assert caught.value.key == key and "larger" in str(caught.value) or "faster" in str(caught.value)


def test_a_posture_every_nanometre_is_refused():
    slow = ["dynamics.follow_pose=true", "dynamics.posture_spacing_mm=1e-9", "path.feed_rate_m_per_min=0.05"]
    cell = read_cell(FILE, slow)
    with pytest.raises(ParameterError, match="posture_spacing_mm"):
        cell.arm_model(cell.target())
    check_postures(100_000, 1e-3)


def test_a_path_file_is_reckoned_too(tmp_path):
    slow = HEAD + "G0 X-14 Y0 Z2\nG0 Z-1\nG1 X28 F0.005\n"
    with pytest.raises(MillingError, match="exchange periods"):
        small_part(tmp_path, slow, "timing.controller_step_ms=1000.0").target()
    fine = ["exchange.micro_step_deg=0.01", "tool.teeth=50", "exchange.iterations=20", "cutting.detail=teeth"]
    with pytest.raises(ParameterError, match=r"micro_step_deg.*larger"):
        small_part(tmp_path, slow.replace("F0.005", "F4"), *fine).target()


def test_a_ramp_of_a_large_tool_on_a_fine_grid_is_refused_and_a_plain_one_is_not(tmp_path):
    ramp = HEAD + "G0 X2 Y0 Z0\n" + "".join(f"G1 X{20 + 10 * (-1) ** k} Z{-k / 100} F100\n" for k in range(1, 60))
    small_part(tmp_path, ramp).target()
    with pytest.raises(ParameterError, match=r"grid_step_um.*sinking"):
        small_part(tmp_path, ramp, "tool.diameter_mm=80.0", "stock.grid_step_um=0.5", "cutting.detail=teeth").target()


def test_what_a_footprint_swept_as_a_whole_costs():
    """By hand: each turn 4 teeth sweep pi (10 mm / 1 um)^2 nodes, so that 7958 turns, 59.7 s, are the most."""
    stock = CELL.stock.replace(grid_step=1e-6)
    most = MOST_VISITS / (4 * np.pi * 1e8) * 60 / 8000
    assert most == pytest.approx(59.68, abs=0.01)
    deep = 1.0  # [m], far more than the tolerance of the floor thins out
    check_effort(CELL.exchange, CELL.tool, stock, 100.0, (0.999 * most, deep))
    with pytest.raises(ParameterError):
        check_effort(CELL.exchange, CELL.tool, stock, 100.0, (1.001 * most, deep))
    check_effort(CELL.exchange, CELL.tool, stock, 100.0, (1.001 * most, 1e-3))


def test_only_the_way_down_below_the_top_counts_as_sinking():
    seconds, depth = sinking(np.arange(6.0), np.array([5.0, 1.0, -1.0, -1.0, 2.0, -3.0]), 0.0)
    assert (seconds, depth) == (2.0, 4.0)
    assert sinking(np.arange(3.0), np.array([1.0, 2.0, 0.5]), 0.0) == (0.0, 0.0)


@pytest.mark.parametrize("stiffness", ["1e30", "5e12"])
def test_an_arm_that_would_fly_off_gives_no_numbers(stiffness):
    short = ["path.length_mm=14", "stock.grid_step_um=50", f"cutting.fractional.stiffness_n_per_m={stiffness}"]
    with pytest.raises(MillingError, match="would push the tool"):
        simulate(read_cell(FILE, short))
