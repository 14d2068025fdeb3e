"""A long pass: windows do not change it, and combined rows keep its extremes, sums and means."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from small_part import GCODE, small_part

from kr270_milling.cell.jobs import simulate
from kr270_milling.physics.motion import milling_pass

SERIES = ("time_ns", "target", "reference", "tool", "deflection", "wrench", "correction", "torque", "volume")


@pytest.fixture(scope="module")
def cell(tmp_path_factory):
    return small_part(tmp_path_factory.mktemp("long"), GCODE, "cutting.detail=engagement", "dynamics.follow_pose=true")


@pytest.fixture(scope="module")
def whole(cell):
    return simulate(cell)


def test_a_pass_in_windows_is_the_same_to_the_bit_and_its_progress_only_grows(cell, whole, monkeypatch):
    monkeypatch.setattr(milling_pass, "WINDOW", 73)
    seen: list[tuple[int, int]] = []
    ran = simulate(cell, progress=lambda *count: seen.append(count)).result
    for name in SERIES:
        np.testing.assert_array_equal(getattr(ran, name), getattr(whole.result, name), err_msg=name)
    done, totals = zip(*seen, strict=True)
    assert list(done) == sorted(set(done)) and done[-1] == totals[-1] and len(set(totals)) == 1


@pytest.mark.parametrize("window", [64, milling_pass.WINDOW])
def test_combined_rows_keep_extremes_sums_means_and_the_scores(cell, whole, monkeypatch, window):
    monkeypatch.setattr(milling_pass, "WINDOW", window)
    plain = whole.result
    periods = len(plain.time) - 1
    ran = simulate(cell, most_rows=periods / 4.5)
    some = ran.result
    assert some.every == 5 and len(some.time) == 1 + -(-periods // 5)
    assert (np.diff(some.time_ns) > 0).all() and np.isin(some.time_ns, plain.time_ns).all()
    size = np.linalg.norm(plain.deflection[:, :3], axis=1)
    assert np.linalg.norm(some.deflection[:, :3], axis=1).max() == size.max()
    assert some.torque.max() == plain.torque.max() and some.correction.max() == plain.correction.max()
    assert some.volume.sum() == pytest.approx(plain.volume.sum(), rel=1e-12)
    counts = np.minimum(5, periods - 5 * np.arange(len(some.time) - 1))
    mean = (counts[:, None] * some.wrench[1:]).sum(axis=0) / periods
    assert mean == pytest.approx(plain.wrench[1:].mean(axis=0), rel=1e-9, abs=1e-9)
    assert ran.scores.max_deviation == pytest.approx(whole.scores.max_deviation, rel=0.05)
    assert some.removed_volume == plain.removed_volume


def test_the_memory_of_a_pass_does_not_grow_with_its_length(tmp_path, monkeypatch):
    """A tenth of the feed takes six times the periods, with rapid moves; windows and rows stay as many as before."""
    monkeypatch.setattr(milling_pass, "WINDOW", 256)
    peaks, periods = [], []
    for feed in ("F4000", "F400"):
        cell = small_part(tmp_path, GCODE.replace("F4000", feed), "cutting.detail=engagement")
        target, cut = cell.target(), cell.cut()
        arm = cell.arm_model(target)
        silent = cell.programmed.drilling_at
        tracemalloc.start()
        ran = milling_pass.run_pass(arm, cut, cell.clock, target, target, silent=silent, most_rows=50)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
        periods.append(ran.micro_steps)
        assert len(ran.time) <= 51
    assert periods[1] > 5 * periods[0] and peaks[1] < 1.5 * peaks[0]
