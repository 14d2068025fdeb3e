"""The workpiece object: areas, undo, copies, tiles, export."""

from __future__ import annotations

import resource
import sys

import numpy as np
import pytest
from book import check
from cuttings import PAPER_LAW

from kr270_milling.physics.cutting import AL7075_T6, Cut, Cutting, GridError, Stock, SweepError, Tool, UndoError
from kr270_milling.physics.cutting.grid import TILE
from kr270_milling.physics.cutting.lanes import LANES

FEED = 0.5e-3  # [m] per revolution
Z = -1e-3


def new_cut(size=(30e-3, 24e-3), grid_step=10e-6, teeth=4, law=PAPER_LAW, **kwargs):
    tool = Tool(diameter=20e-3, teeth=teeth, spindle_speed=837.0)
    low = np.array([0.0, -size[1] / 2, -5e-3])
    stock = Stock(min=low, max=np.array([size[0], size[1] / 2, 0.0]), grid_step=grid_step)
    return Cut(tool, law, stock, np.radians(1.0), **kwargs)


@check(
    "removed area of an oblique slot 6 mm long, grid of {step} um", "2 R L + pi R^2: a half disc at both ends", "m^2",
    cases=("step", [(40,), (10,)]),
)  # fmt: skip
def test_area(step):
    """The tool turns once at both ends, so that every tooth reaches them."""
    cut = new_cut(grid_step=1e-6 * step)
    ends = np.array([11.5e-3, 0.7e-3, Z]), np.array([17.5e-3, -0.3e-3, Z])
    cut.sweep(ends[0], ends[0], 0, 360)
    cut.sweep(ends[0], ends[1], 360, 12 * 360)
    cut.sweep(ends[1], ends[1], 13 * 360, 360)
    assert cut.removed_volume == pytest.approx(cut.removed_area * 1e-3, rel=1e-9)
    length = np.hypot(6e-3, 1e-3)
    border = 2 * np.pi * 10e-3 + 2 * length
    return np.pi * 1e-4 + 20e-3 * length, cut.removed_area, 0.05 * border * 1e-6 * step


def test_a_narrow_sheet_has_a_row_of_heights_however_much_it_is_thinned():
    cut = new_cut(size=(30e-3, 0.2e-3))
    x, y, height = cut.heights(thinning=100)
    assert height.shape == (x.size, 1) == (30, 1) and abs(y[0]) <= 0.1e-3 and np.all(height == 0.0)


def test_restore_brings_back_the_very_same_grid_and_force():
    cut, other = new_cut(), new_cut()
    here = np.array([-8e-3, 0.0, Z])
    for k in range(12):
        end = here + [24 * FEED / 360, 0.3e-6 * np.sin(k), 0.0]
        cut.sweep(here, end + [2e-6, 3e-6, -1e-6], 24 * k, 24)  # a first guess
        cut.restore()
        assert np.array_equal(cut.sweep(here, end, 24 * k, 24), other.sweep(here, end, 24 * k, 24))
        here = end
    assert np.array_equal(cut.heights()[2], other.heights()[2])
    assert (cut.removed_area, cut.removed_volume) == (other.removed_area, other.removed_volume)
    assert cut.removed_area > 0


def test_restore_takes_back_a_jump_and_a_deeper_level():
    cut = new_cut()
    cut.sweep([5e-3, 0.0, Z], [6e-3, 0.0, Z], 0, 720)
    before, area = cut.heights()[2], cut.removed_area
    cut.sweep([6e-3, 0.0, Z], [9e-3, 5e-3, 2 * Z], 720, 30)
    assert not np.array_equal(before, cut.heights()[2])
    cut.restore()
    assert np.array_equal(before, cut.heights()[2]) and cut.removed_area == area


def test_with_a_short_log_a_sweep_cannot_be_taken_back_and_is_the_same():
    a, b = new_cut(log_size=1024), new_cut()
    forces = [np.zeros((2880, 3)) for _ in range(2)]
    for cut, force in zip((a, b), forces, strict=True):
        cut.sweep([-10e-3, 0.0, Z], [-6e-3, 0.0, Z], 0, 2880, force)
    assert np.array_equal(*forces) and a.removed_volume == b.removed_volume > 0
    with pytest.raises(UndoError, match="1024"):
        a.restore()


def test_a_course_is_swept_as_its_parts_are():
    whole, parts = new_cut(), new_cut()
    places = np.column_stack([np.linspace(-10e-3, -6e-3, 9), 1e-4 * np.arange(9.0), np.full(9, Z)])
    steps = 40 * np.arange(9)
    wrench, torque, volume = whole.along(places, steps)
    for k in range(1, 9):
        before = parts.removed_volume
        assert np.array_equal(parts.sweep(places[k - 1], places[k], steps[k - 1], 40), wrench[k])
        assert parts.torque == torque[k] and parts.removed_volume - before == pytest.approx(volume[k], rel=1e-9)
    assert not (wrench[0].any() or torque[0] or volume[0]) and volume[1:].min() > 0.0


def test_a_tool_that_sinks_cuts_with_its_whole_end():
    """Its end sweeps pi R^2 v_z; with F_a = K_ac A / (R dphi) H the axial force is K_ac pi R v_z / omega: it damps."""
    cut = new_cut(law=Cutting(law="linear_edge", linear_edge=AL7075_T6.replace(axial_cutting=220e6)))
    radius, omega, speed, turns = 10e-3, cut.tool.spindle_speed, 1e-3, 10
    middle = cut.stock.min[:2] + 0.5 * (cut.stock.max - cut.stock.min)[:2]
    end = np.array([*middle, Z - speed * turns * 2 * np.pi / omega])
    cut.sweep([*middle, Z], [*middle, Z], 0, 720)  # a hole as large as the tool
    sinking = cut.sweep([*middle, Z], end, 720, 360 * turns)[2]
    assert sinking == pytest.approx(-220e6 * np.pi * radius * speed / omega, rel=0.02)
    rising = cut.sweep(end, [*middle, Z], 720 + 360 * turns, 720)[2]
    left = cut.stock.floor_tolerance / (speed * 2 * 2 * np.pi / omega)  # in two turns
    assert abs(rising) < left * abs(sinking) and left < 0.15


def test_memory_follows_the_area_cut():
    """A corner of a stock that as a whole would take 1.8 GB."""
    cut = new_cut(size=(300e-3, 300e-3))
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    cut.sweep([-10e-3, 0.0, Z], [20e-3, 0.0, Z], 0, 60 * 360)
    used = cut.tiles * TILE**2 * 2
    side = TILE * 10e-6
    assert cut.tiles <= (30e-3 + 2 * side) * (20e-3 + 2 * side) / side**2
    scale = 1024 if sys.platform == "linux" else 1
    assert (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) * scale < used + 40e6


def test_running_out_of_tiles_says_so():
    cut = new_cut()
    cut.state = cut.state._replace(pool=cut.state.pool[: 4 * TILE**2 + LANES].copy())
    with pytest.raises(GridError, match="4 tiles"):
        cut.sweep([-10e-3, 0.0, Z], [10e-3, 0.0, Z], 0, 14400)


def test_heights_show_the_slot_thinned_and_in_a_window():
    cut = new_cut()
    cut.sweep([-10e-3, 0.0, Z], [10e-3, 0.0, Z], 0, 40 * 360)
    x, y, z = cut.heights(thinning=10)
    assert z.shape == (x.size, y.size) == (300, 240)
    inside = (x[:, None] < 10e-3) & (np.abs(y) < 9.9e-3)
    assert z[inside] == pytest.approx(Z, abs=cut.stock.level_step)
    assert np.all(z[:, np.abs(y) > 10.1e-3] == 0.0)
    x, y, z = cut.heights(low=[1e-3, -11e-3], high=[2e-3, -9e-3])
    assert (x.size, y.size) == (100, 200) and x[0] == pytest.approx(1.005e-3) and y[-1] == pytest.approx(-9.005e-3)
    assert np.count_nonzero(z[50]) == pytest.approx(100, abs=1)


def test_a_senseless_sweep_is_refused():
    cut = new_cut()
    for arguments in (([0, 0, np.nan], [0, 0, 0], 0, 1), ([0, 0], [0, 0], 0, 1), ([0] * 3, [0] * 3, -1, 1)):
        with pytest.raises(SweepError):
            cut.sweep(*arguments)
    with pytest.raises(SweepError):
        cut.sweep([0] * 3, [0] * 3, 0, 5, np.zeros((4, 3)))
    assert cut.removed_area == 0.0


def test_absurd_positions_do_no_harm():
    cut = new_cut()
    for far in (1e3, 1e30, 1e300):
        assert np.isfinite(cut.sweep([-1.0, 0, Z], [far, far, Z], 0, 3)).all()
        assert np.isfinite(cut.sweep([-1.0, 0, Z], [0.0, 0.0, -far], 3, 3)).all()
