"""report.charts and report.linked: thinned to what can be seen, no maximum lost."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from budget import budget
from hypothesis import given, settings
from hypothesis import strategies as st
from milled_part import POCKET, small_cell

from kr270_milling.cell.jobs import compensated, simulate
from kr270_milling.decide.part import assess_all
from kr270_milling.physics.motion.scores import path_deviation
from kr270_milling.show.report.charts import envelope_index, stations
from kr270_milling.show.report.linked import MOST_CELLS, linked, part_surface


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


def test_values_that_are_not_known_are_not_extrema():
    y = np.full(5000, np.nan)
    y[1234] = -3.0
    assert 1234 in envelope_index(y, 50)


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


def test_the_deviation_is_that_of_the_scores_on_a_level_move(case):
    cell, passes, parts = case
    outcome, result = linked(cell, passes, parts), passes[0].result
    feed = cell.target().sample_velocity(result.time_ns)
    reference = path_deviation(result.actual, result.target, feed) * 1e6
    rows = np.searchsorted(result.time_ns, np.round(outcome.time * 1e9).astype(np.int64))
    moving = (np.hypot(*feed[rows, :2].T) > 1e-3) & (outcome.scored == 1)
    np.testing.assert_allclose(outcome.passes[0].side[moving], reference[rows][moving], atol=0.5)


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
