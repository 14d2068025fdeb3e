"""report.charts and report.straight_cut: micro-step forces, spectra, walls."""

from __future__ import annotations

import numpy as np
import pytest

from kr270_milling.base.record import find_file
from kr270_milling.cell.cell import read_cell
from kr270_milling.cell.jobs import simulate
from kr270_milling.decide.part import assess_all
from kr270_milling.show.report.charts import amplitude_spectrum, moving_mean, thinned_spectrum
from kr270_milling.show.report.straight_cut import machined_profile, micro_step_forces


def test_micro_step_forces_average_to_the_wrench_of_each_exchange_period():
    cell = read_cell(find_file("paper.yaml"), ["path.length_mm=6.0", "stock.grid_step_um=20.0"])
    result = simulate(cell).result
    force = micro_step_forces(cell.cut(), result.tool, cell.clock.micro_steps)
    means = force.reshape(-1, cell.clock.micro_steps, 3).mean(axis=1)
    assert np.abs(result.wrench[1:, 1]).max() > 10.0
    np.testing.assert_allclose(means, result.wrench[1:, :3], atol=1e-9)


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


def test_both_walls_of_a_slot_are_shown_where_the_tool_was_pushed_to():
    """Positive is to the left of the feed, on the left wall (cut too deep) as on the right one (material left)."""
    cell = read_cell(find_file("paper.yaml"), ["path.length_mm=20.0", "stock.grid_step_um=40.0"])
    ran = simulate(cell)
    chart = machined_profile(assess_all(cell, [ran]))[0]
    assert [panel.title for panel in chart.panels] == ["left wall", "right wall"]
    for panel in chart.panels:
        (shown,) = panel.curves
        at = cell.target().sample(ran.result.time_ns)[:, 0] * 1e3
        pushed = np.interp(shown.x, at, (ran.result.actual - ran.result.target)[:, 1] * 1e6)
        np.testing.assert_allclose(shown.y[5:-5], pushed[5:-5], atol=1.0)  # a cusp, and the nearest passage of a tooth
