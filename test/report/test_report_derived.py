"""report.derived: micro-step forces, walls, spectra."""

from __future__ import annotations

import numpy as np
import pytest

from kr270_milling.base.record import find_file
from kr270_milling.cell.cell import read_cell
from kr270_milling.cell.jobs import simulate
from kr270_milling.cutting import Tool
from kr270_milling.report.derived import (
    amplitude_spectrum,
    micro_step_forces,
    moving_mean,
    slot_walls,
    thinned_spectrum,
)


def tool(**changes) -> Tool:
    return Tool(**{"diameter": 0.02, "teeth": 4, "spindle_speed": 8000 * np.pi / 30, **changes})


def straight(y, feed_rate=4 / 60, duration=0.5, n=1001):
    time = np.linspace(0, duration, n)
    return time, np.column_stack([feed_rate * time, np.broadcast_to(y, n), np.zeros(n)])


def test_micro_step_forces_average_to_the_wrench_of_each_exchange_period():
    cell = read_cell(find_file("paper.yaml"), ["path.length_mm=6.0", "stock.grid_step_um=20.0"])
    result = simulate(cell).result
    force = micro_step_forces(cell.cut(), result.tool, cell.clock.micro_steps)
    means = force.reshape(-1, cell.clock.micro_steps, 3).mean(axis=1)
    assert np.abs(result.wrench[1:, 1]).max() > 10.0
    np.testing.assert_allclose(means, result.wrench[1:, :3], atol=1e-9)


def test_a_tool_shifted_sideways_shifts_both_walls_by_as_much():
    for shift in (0.0, 58e-6):
        time, centre = straight(shift)
        walls = slot_walls(time, centre, tool())
        inner = slice(20, -20)
        cusp = (4 / 60 / (8000 / 60 * 4)) ** 2 / (8 * 0.01)  # f_z^2 / 8R of two circles f_z apart
        assert walls.left[inner].max() == pytest.approx(0.01 + shift, abs=1e-12)
        assert walls.right[inner].min() == pytest.approx(shift - 0.01, abs=1e-12)
        assert 0.01 + shift - walls.left[inner].min() == pytest.approx(cusp, rel=0.01)


def test_the_tooth_that_reaches_farthest_makes_the_wall():
    time, centre = straight(0.0)
    walls = slot_walls(time, centre, tool(runout=np.array([0.0, 5e-6, 0.0, 0.0])))
    f_rev = 4 / 60 / (8000 / 60)
    assert walls.left[20:-20].max() == pytest.approx(0.010005, abs=1e-12)
    assert 0.010005 - walls.left[20:-20].min() == pytest.approx(f_rev**2 / (8 * 0.01), rel=0.01)


@pytest.mark.parametrize("rotation", ["clockwise", "counterclockwise"])
def test_a_tooth_marks_the_wall_where_the_sweep_says_it_stands(rotation):
    time, centre = straight(0.0)
    one = tool(teeth=1, rotation=rotation)
    walls = slot_walls(time, centre, one)
    turn = 0.25 if rotation == "counterclockwise" else 0.75  # of a revolution until the tooth points to +y
    first = centre[0, 0] + 4 / 60 * turn * 60 / 8000
    assert walls.x[0] == pytest.approx(first, rel=1e-9)


def test_an_amplitude_is_read_from_the_spectrum():
    time = np.arange(4800) / 4800
    values = 3.0 + 2.0 * np.sin(2 * np.pi * 100 * time) + 0.5 * np.cos(2 * np.pi * 533 * time)
    frequency, amplitude = amplitude_spectrum(values, 1 / 4800)
    assert amplitude[frequency == 100.0] == pytest.approx(2.0, rel=1e-9)
    assert amplitude[frequency == 533.0] == pytest.approx(0.5, rel=1e-9)
    assert amplitude[np.abs(frequency - 1000) < 100].max() < 1e-9


def test_thinning_a_spectrum_loses_no_peak():
    rng = np.random.default_rng(1)
    frequency = np.arange(1, 40_001) * 0.1
    amplitude = rng.random(40_000)
    amplitude[5332] = 10.0
    thin_f, thin_a = thinned_spectrum(frequency, amplitude, 2000.0, 300)
    assert thin_f.size <= 300
    assert thin_f[np.argmax(thin_a)] == frequency[5332]
    assert np.all(np.diff(thin_f) > 0)


def test_a_moving_mean_over_whole_waves_is_flat():
    wave = np.sin(2 * np.pi * np.arange(300) / 15)
    assert np.abs(moving_mean(wave, 15)[8:-8]).max() < 1e-12
    assert moving_mean(np.arange(10.0), 1) == pytest.approx(np.arange(10.0))
