"""report.series: CSV of every series, names that stay inside the directory."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from budget import budget
from hypothesis import given, settings
from hypothesis import strategies as st
from milled_part import POCKET, small_cell

from kr270_milling.base.record import find_file
from kr270_milling.cell.cell import read_cell
from kr270_milling.cell.jobs import ScoredPass, compensated, simulate
from kr270_milling.decide.part import assess_all
from kr270_milling.path.trajectory_csv import read_csv
from kr270_milling.show.report.charts import amplitude_spectrum, envelope_index, stations, thinned_spectrum
from kr270_milling.show.report.linked import MOST_CELLS, linked, part_surface
from kr270_milling.show.report.series import COLUMNS, deviation_of, file_names, write_series
from kr270_milling.show.report.straight_cut import machined_profile, micro_step_forces


@pytest.fixture(scope="module")
def cell():
    return read_cell(find_file("paper.yaml"), ["path.length_mm=12.0", "stock.grid_step_um=40.0"])


@pytest.fixture(scope="module")
def passes(cell):
    original = simulate(cell)
    return [original, compensated(cell, original, "spline")]


def close(table, expected):
    """A number of thirteen digits is wrong by half of the last one at most."""
    np.testing.assert_allclose(table, expected, rtol=5e-13, atol=0)


def test_every_series_comes_back_with_twelve_digits(tmp_path, cell, passes):
    paths = write_series(tmp_path, cell, passes)
    assert [p.name for p in paths[:2]] == ["original.csv", "spline.csv"]
    for path, one in zip(paths[:2], passes, strict=True):
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


def test_reference_trajectories_are_written_with_joint_angles(tmp_path, cell, passes):
    path = write_series(tmp_path, cell, passes)[3]
    trajectory, joints = read_csv(path)
    np.testing.assert_array_equal(trajectory.position, passes[1].reference.position)
    np.testing.assert_array_equal(trajectory.velocity, passes[1].reference.velocity)
    np.testing.assert_allclose(joints, cell.joints(passes[1].reference), atol=1e-12)


def test_a_pass_cannot_be_named_out_of_the_directory(tmp_path, cell, passes):
    hostile = [ScoredPass("../../etc/x", passes[0].reference, passes[0].result, passes[0].scores)]
    out = tmp_path / "out"
    for path in write_series(out, cell, hostile):
        assert path.resolve().parent == out.resolve()
    assert [p.name for p in tmp_path.iterdir()] == ["out"]


def test_file_names_are_plain_and_different_even_without_regard_to_case():
    names = file_names(["a b", "a/b", "A_B", "", "..", "x" * 300, "Ω"])
    assert len({n.lower() for n in names}) == len(names)
    assert all(n.strip("_") and set(n) <= set("abAB_x0123456789pas") and len(n) <= 64 for n in names)


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
def case(tmp_path_factory):
    cell = small_cell(tmp_path_factory.mktemp("linked"), POCKET)
    original = simulate(cell)
    passes = [original, compensated(cell, original, "spline")]
    return cell, passes, assess_all(cell, passes)


def test_the_largest_deviation_of_each_pass_is_a_station_as_in_the_table(case):
    cell, passes, parts = case
    outcome = linked(cell, passes, parts)
    for one, part in zip(outcome.passes, parts, strict=True):
        counted = np.abs(one.side[outcome.scored == 1]).max()
        assert counted == pytest.approx(part.whole.max_normal * 1e6, rel=1e-12)


def test_line_point_and_feature_of_a_station_are_those_of_its_time(case):
    cell, passes, parts = case
    outcome = linked(cell, passes, parts)
    source = Path(cell.path.file).read_text().splitlines()
    assert [line.text for line in outcome.source] == source
    for k in range(0, outcome.time.size, 97):
        stamp = round(outcome.time[k] * 1e9)
        block = int(cell.timed_path.block_at(np.array([stamp]))[0])
        assert source[outcome.line[k] - 1].startswith("G") and outcome.line[k] == cell.timed_path.toolpath.line[block]
        assert (
            outcome.features[outcome.feature[k]]
            == cell.timed_path.toolpath.features[cell.timed_path.toolpath.feature[block]]
        )
        knot = outcome.point[k] - 1
        assert cell.target().time_ns[knot] >= stamp and (knot == 0 or cell.target().time_ns[knot - 1] < stamp)
        np.testing.assert_allclose(
            [outcome.x[k], outcome.y[k], outcome.z[k]], 1e3 * cell.target().sample(stamp), atol=1e-9
        )


def test_a_pass_that_was_cut_off_is_unknown_beyond_its_end(case):
    import dataclasses

    cell, passes, parts = case
    half = len(passes[1].result.time_ns) // 2
    fields = {}
    for field in dataclasses.fields(passes[1].result):
        value = getattr(passes[1].result, field.name)
        fields[field.name] = value[:half] if isinstance(value, np.ndarray) else value
    short = dataclasses.replace(passes[1], result=dataclasses.replace(passes[1].result, **fields))
    outcome = linked(cell, [passes[0], short], assess_all(cell, [passes[0], short]))
    late = outcome.time > short.result.time[-1]
    assert late.any() and np.isnan(outcome.passes[1].side[late]).all() and np.isfinite(outcome.passes[0].side).all()


def test_the_surface_keeps_the_largest_errors_of_floors_and_walls(case):
    _, _, parts = case
    surface = part_surface(parts)
    assert max(surface.z.shape) <= MOST_CELLS and surface.z.shape == (surface.y.size, surface.x.size)
    for one, part in zip(surface.passes, parts, strict=True):
        assert np.nanmax(np.abs(one.floor)) == pytest.approx(part.whole.max_floor * 1e6)
        assert np.abs(one.wall).max() == pytest.approx(part.whole.max_wall * 1e6)
