"""report.series: CSV of every series, names that stay inside the directory."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest
from budget import budget
from hypothesis import given, settings
from hypothesis import strategies as st

from kr270_milling.base.record import find_file
from kr270_milling.cell.cell import read_cell
from kr270_milling.cell.jobs import simulate
from kr270_milling.decide.part import assess_all
from kr270_milling.path.trajectory_csv import read_csv
from kr270_milling.show.report.charts import amplitude_spectrum, envelope_index, stations, thinned_spectrum
from kr270_milling.show.report.linked import MOST_CELLS, linked, part_surface
from kr270_milling.show.report.series import COLUMNS, deviation_of, file_names, write_series
from kr270_milling.show.report.straight_cut import machined_profile, micro_step_forces


def close(table, expected):
    """A number of thirteen digits is wrong by half of the last one at most."""
    np.testing.assert_allclose(table, expected, rtol=5e-13, atol=0)


def test_every_series_comes_back_with_twelve_digits(tmp_path, straight):
    cell, passes = straight
    paths = write_series(tmp_path, cell, passes)
    assert [p.name for p in paths[:3]] == ["original.csv", "linear.csv", "spline.csv"]
    for path, one in zip(paths[:3], passes, strict=True):
        assert path.read_text().splitlines()[0] == ",".join(COLUMNS)
        table = dict(zip(COLUMNS, np.loadtxt(path, delimiter=",", skiprows=1).T, strict=True))
        r = one.result
        np.testing.assert_allclose(table["time_s"], r.time_ns * 1e-9, rtol=1e-15)
        for k, axis in enumerate("xyz"):
            for kind in ("target", "reference", "tool", "actual"):
                close(table[f"{kind}_{axis}_mm"], 1e3 * getattr(r, kind)[:, k])
            close(table[f"deflection_{axis}_um"], 1e6 * r.deflection[:, k])
            close(table[f"deflection_r{axis}_deg"], np.degrees(r.deflection[:, 3 + k]))
            close(table[f"force_{axis}_n"], r.wrench[:, k])
            close(table[f"moment_{axis}_n_m"], r.wrench[:, 3 + k])
        close(table["path_deviation_um"], 1e6 * deviation_of(r, cell.target()))
        close(table["pose_correction_um"], 1e6 * r.correction)


def test_reference_trajectories_are_written_with_joint_angles(tmp_path, straight):
    cell, passes = straight
    trajectory, joints = read_csv(write_series(tmp_path, cell, passes)[5])
    np.testing.assert_array_equal(trajectory.position, passes[2].reference.position)
    np.testing.assert_array_equal(trajectory.velocity, passes[2].reference.velocity)
    np.testing.assert_allclose(joints, cell.joints(passes[2].reference), atol=1e-12)


def test_file_names_are_plain_inside_the_directory_and_different_even_without_regard_to_case(tmp_path, straight):
    cell, (first, *_) = straight
    write_series(tmp_path / "out", cell, [dataclasses.replace(first, name="../../etc/x")])
    assert [p.name for p in tmp_path.iterdir()] == ["out"]
    names = file_names(["a b", "a/b", "A_B", "", "..", "../../etc/x", "x" * 300, "Ω"])
    assert len({n.lower() for n in names}) == len(names)
    assert all(n.strip("_") and re.fullmatch(r"[A-Za-z0-9_-]{1,64}", n) for n in names)


# --- report.charts and report.straight_cut: micro-step forces, spectra, walls ---


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


def test_both_walls_of_a_slot_are_shown_where_the_tool_was_pushed_to(straight):
    """Positive is to the left of the feed, on the left wall (cut too deep) as on the right one (material left)."""
    cell, (ran, *_) = straight
    chart = machined_profile(assess_all(cell, [ran]))[0]
    assert [panel.title for panel in chart.panels] == ["left wall", "right wall"]
    for panel in chart.panels:
        (shown,) = panel.curves
        at = cell.target().sample(ran.result.time_ns)[:, 0] * 1e3
        pushed = np.interp(shown.x, at, (ran.result.actual - ran.result.target)[:, 1] * 1e6)
        np.testing.assert_allclose(shown.y[5:-5], pushed[5:-5], atol=1.0)  # a cusp, and the nearest passage of a tooth


# --- report.charts and report.linked: thinned to what can be seen, no maximum lost ---


@settings(max_examples=budget(30), deadline=None)
@given(st.integers(1, 6000), st.integers(2, 60), st.integers(0, 2**32 - 1))
def test_thinning_keeps_both_ends_and_every_extremum_of_a_bucket(size, buckets, seed):
    y = np.random.default_rng(seed).normal(size=size)
    rows = envelope_index(y, buckets)
    assert rows[0] == 0 and rows[-1] == size - 1 and np.all(np.diff(rows) > 0)
    assert rows.size <= max(2 * buckets + 2, 1)
    edges = np.linspace(0, size, buckets + 1).astype(int)
    for a, b in zip(edges[:-1], edges[1:], strict=True):
        if a < b:
            inside = y[rows[(rows >= a) & (rows < b)]]
            assert inside.max() == y[a:b].max() and inside.min() == y[a:b].min()


def test_stations_serve_several_series_and_are_few():
    time = np.linspace(0, 30, 120_000)
    rng = np.random.default_rng(3)
    series = [np.sin(time * k) + 0.1 * rng.normal(size=time.size) for k in range(1, 7)]
    chosen = stations(series, 2000)
    assert chosen.size <= 2000 * 1.4
    for y in series:
        assert np.abs(y[chosen]).max() == np.abs(y).max()
    assert np.diff(chosen).max() <= 3 * time.size // 2000 + 1


@pytest.fixture(scope="module")
def case(milled):
    cell, passes = milled
    parts = assess_all(cell, passes)
    return cell, passes, parts, linked(cell, passes, parts)


def test_the_largest_deviation_of_each_pass_is_a_station_as_in_the_table(case):
    *_, parts, outcome = case
    for one, part in zip(outcome.passes, parts, strict=True):
        counted = np.abs(one.side[outcome.scored == 1]).max()
        assert counted == pytest.approx(part.whole.max_normal * 1e6, rel=1e-12)


def test_line_point_and_feature_of_a_station_are_those_of_its_time(case):
    cell, _, _, outcome = case
    toolpath, target = cell.timed_path.toolpath, cell.target()
    source = Path(cell.path.file).read_text().splitlines()
    assert [line.text for line in outcome.source] == source
    for k in range(0, outcome.time.size, 97):
        stamp = round(outcome.time[k] * 1e9)
        block = int(cell.timed_path.block_at(np.array([stamp]))[0])
        assert source[outcome.line[k] - 1].startswith("G") and outcome.line[k] == toolpath.line[block]
        assert outcome.features[outcome.feature[k]] == toolpath.features[toolpath.feature[block]]
        knot = outcome.point[k] - 1
        assert target.time_ns[knot] >= stamp and (knot == 0 or target.time_ns[knot - 1] < stamp)
        place = [outcome.x[k], outcome.y[k], outcome.z[k]]
        np.testing.assert_allclose(place, 1e3 * target.sample(stamp), atol=1e-9)


def test_a_pass_that_was_cut_off_is_unknown_beyond_its_end(case):
    cell, passes, *_ = case
    whole = passes[1].result
    half = len(whole.time_ns) // 2
    fields = {name: value[:half] for name, value in vars(whole).items() if isinstance(value, np.ndarray)}
    short = dataclasses.replace(passes[1], result=dataclasses.replace(whole, **fields))
    outcome = linked(cell, [passes[0], short], assess_all(cell, [passes[0], short]))
    late = outcome.time > short.result.time[-1]
    assert late.any() and np.isnan(outcome.passes[1].side[late]).all() and np.isfinite(outcome.passes[0].side).all()


def test_the_surface_keeps_the_largest_errors_of_floors_and_walls(case):
    parts = case[2]
    surface = part_surface(parts)
    assert max(surface.z.shape) <= MOST_CELLS and surface.z.shape == (surface.y.size, surface.x.size)
    for one, part in zip(surface.passes, parts, strict=True):
        assert np.nanmax(np.abs(one.floor)) == pytest.approx(part.whole.max_floor * 1e6)
        assert np.abs(one.wall).max() == pytest.approx(part.whole.max_wall * 1e6)
