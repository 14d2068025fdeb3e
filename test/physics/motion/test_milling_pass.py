"""The compiled pass, the exchange period, and the scores of a pass."""

import functools
import tracemalloc

import numpy as np
import pytest
from book import check
from budget import budget
from hypothesis import given, settings
from hypothesis import strategies as st
from samples.cuttings import profile
from samples.small_part import GCODE, small_part

from kr270_milling import read_cell
from kr270_milling.base.errors import MillingError, ParameterError
from kr270_milling.cell.jobs import simulate
from kr270_milling.cell.models import arm_model_of, cut_of, path_of
from kr270_milling.path.trajectory import Trajectory
from kr270_milling.physics.cutting import Cut
from kr270_milling.physics.motion import milling_pass
from kr270_milling.physics.motion.milling_pass import run_pass
from kr270_milling.physics.motion.periods import Clock, Exchange
from kr270_milling.physics.motion.scores import path_deviation, ringing_frequency, score

MICRO_STEP = 1 / 48  # [ms], 1 deg at 8000 rpm
SPEED = 8000 * 2 * np.pi / 60
SHORT = ("path.length_mm=14.4",)  # 4 controller steps and more than full engagement


def run(*assignments):
    cell = read_cell("paper.yaml", *assignments)
    return cell, simulate(cell).result


@functools.cache
def with_period(micro_steps, *assignments):
    return run(f"exchange.period_ms={int(micro_steps) * MICRO_STEP!r}", *assignments)[1]


def difference(result, reference, every):
    """Largest difference of the deflection at common instants, as a share of the largest deflection."""
    at_reference = reference.deflection[::every, :3][: len(result.deflection)]
    gap = result.deflection[: len(at_reference), :3] - at_reference
    return np.abs(gap).max() / np.abs(reference.deflection[:, :3]).max()


@check("H = 0.5 ms against an exchange at every micro-step", "self-consistent: the finer pass, share of its deflection",
       at_most=True)  # fmt: skip
def test_default_period():
    """The bound is the customer's; 0.007 % is what comes out."""
    return 0.0, difference(with_period(24), with_period(1), 24), 0.002


@check("order of convergence in the exchange period H", "2: force constant at its mean over H")
def test_period_order():
    """Periods of 6 to 48 micro-steps, above the grid's own grain."""
    periods = np.array([6, 12, 24, 48])
    errors = [difference(with_period(m, *SHORT), with_period(1, *SHORT), m) for m in periods]
    assert errors[0] < 1e-5
    return 2.0, np.polyfit(np.log(periods), np.log(errors), 1)[0], 0.6


@check("order of the correction of the predicted pose in H", "2: dF H^2 / 2 M, with 790 kg, 0.5 ms and some ten newton "
       "10 nm [derived]")  # fmt: skip
def test_correction():
    periods = np.array([6, 12, 24])
    corrections = [with_period(m, *SHORT).correction.max() for m in periods]
    assert 1e-9 < corrections[-1] < 2e-8
    return 2.0, np.polyfit(np.log(periods), np.log(corrections), 1)[0], 0.25


@pytest.mark.parametrize("period", [12, 24])
def test_a_second_iteration_brings_the_prediction_to_the_correction(period):
    """A contraction: each further iteration divides what is left by a hundred and more."""
    left = [with_period(period, *SHORT, f"exchange.iterations={i}").correction.max() for i in (1, 2, 3)]
    assert left[1] < 0.01 * left[0] and left[2] < 0.01 * left[1]


def test_a_pass_covers_the_path_and_leaves_a_slot_as_wide_as_the_tool_that_ends_in_a_half_disc():
    cell = read_cell("paper.yaml")
    cut, target = cut_of(cell), path_of(cell).target
    result = run_pass(arm_model_of(cell, target), cut, path_of(cell).clock, target, target)
    np.testing.assert_array_equal(result.time_ns, np.arange(2401) * 500_000)
    assert result.micro_steps == 57_600  # 1.2 s at 8000 rpm and 1 deg
    np.testing.assert_array_equal(result.target[-1], target.position[-1])
    np.testing.assert_array_equal(result.reference, result.target)
    np.testing.assert_array_equal(result.actual, result.reference + result.deflection[:, :3])
    apart = np.linalg.norm(result.actual - result.tool, axis=1)  # actual and predicted tool
    np.testing.assert_allclose(apart, result.correction, rtol=1e-6, atol=1e-16)
    x, low, high = profile(cut)
    width = high - low + cell.stock.grid_step
    np.testing.assert_allclose(width[x < 0.065], 0.020, atol=1.1 * cell.stock.grid_step)
    area = width.sum() * cell.stock.grid_step
    assert area == pytest.approx(0.070 * 0.020 + np.pi * 0.010**2 / 2, rel=2e-3)  # the front is where no tooth was
    assert area <= result.removed_area < 1.005 * area  # the tool sinks by a micrometre, some nodes are cut again
    assert result.removed_volume == pytest.approx(area * cell.path.depth_of_cut, rel=4e-3)


def test_a_pass_may_be_in_the_air_or_of_one_period_and_a_lack_of_log_or_tiles_is_an_error(monkeypatch):
    cell, result = run("path.start_mm=[-70, 0]", "path.length_mm=40")
    assert not result.wrench.any() and not result.deflection.any() and result.removed_area == 0.0
    np.testing.assert_array_equal(result.tool, result.reference)
    line = Trajectory(np.array([0, 1]), np.zeros((2, 3)), (1.0, 0.0, 0.0, 0.0))
    result = run_pass(arm_model_of(cell, line), cut_of(cell), Clock(5e-4, 24), line, line)
    assert len(result.time) == 2 and result.micro_steps == 24
    cell = read_cell("paper.yaml", *SHORT)
    cut = Cut(cell.tool, cell.cutting, cell.stock, cell.exchange.micro_step, log_size=64)
    with pytest.raises(MillingError, match="taken back"):
        run_pass(
            arm_model_of(cell, path_of(cell).target),
            cut,
            path_of(cell).clock,
            path_of(cell).target,
            path_of(cell).target,
            2,
        )
    monkeypatch.setattr("kr270_milling.physics.cutting.state.MAX_TILES", 3)
    with pytest.raises(MillingError, match="3 tiles"):
        run(*SHORT)


def test_a_clock_has_whole_micro_steps_covers_the_duration_and_other_periods_are_refused():
    for period_ms, micro_steps in ((0.5, 24), (1 / 48, 1), (0.25, 12), (7.5, 360), (0.125, 6)):
        assert Exchange(period_ms * 1e-3).clock(SPEED).micro_steps == micro_steps
    for period_ms, near in ((0.51, "0.5, 0.520833333"), (0.01, "0.0208333333"), (1e-9, "0.0208333")):
        with pytest.raises(ParameterError) as caught:
            Exchange(period_ms * 1e-3).clock(SPEED)
        assert near in str(caught.value) and caught.value.key == "exchange.period_ms"
    clock = Clock(1e-3 / 48, 1)
    for n in (1, 2, 3, 1000, 57_600):  # a duration of rounded stamps takes no further period
        assert clock.steps(int(clock.stamp(n))) == n
    for duration_ns, steps in ((0, 0), (1, 1), (500_000, 1), (500_001, 2), (1_200_000_000, 2400)):
        assert Clock(5e-4, 24).steps(duration_ns) == steps


@given(st.integers(1, 480), st.integers(0, 10**7))
def test_every_step_has_one_stamp_and_every_stamp_its_step(micro_steps, step):
    clock = Clock(micro_steps / 48 * 1e-3, micro_steps)
    stamp = int(clock.stamp(step))
    assert stamp == pytest.approx(step * micro_steps / 48 * 1e6, abs=0.51)
    assert clock.step(stamp) == step
    assert clock.step(stamp + 1) == clock.step(stamp - 1) == -1


# --- Scores of Table 2 and the ringing of a pass ---
TIME = np.arange(0, 1.05, 5e-4)
X, Y = np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])


def ringing(frequency, damping, amplitude=5e-6, phase=0.3, mean=60e-6):
    """Free vibration of the undamped frequency [Hz] about a mean."""
    w = 2 * np.pi * frequency
    return mean + amplitude * np.exp(-damping * w * TIME) * np.cos(w * np.sqrt(1 - damping**2) * TIME + phase)


def along(direction, count=5):
    return np.tile(direction, (count, 1))


def test_scores_are_the_mean_of_the_last_quarter_and_the_largest_deviation_across_the_feed_from_engagement_on():
    zero = np.zeros((5, 3))
    for offset, feed, expected in ((Y, X, 1.0), (Y, -X, -1.0), (X, Y, -1.0), (Y, 0 * X, 0.0)):  # at rest there is none
        np.testing.assert_array_equal(path_deviation(along(offset * 1e-6), zero, along(feed)), expected * 1e-6)
    np.testing.assert_allclose(path_deviation(along([3.0, 4.0, 5.0]), zero, along(X + Y)), 1.0 / np.sqrt(2), rtol=1e-15)
    # samples 9, 10 and 11 of 12
    y = np.array([100.0, 90, 80, 70, 60, 50, 40, 30, 20, 4, 3, 2]) * 1e-6
    obtained = score(np.arange(12.0), np.outer(y, Y), np.zeros((12, 3)), along(X, 12), 0.0, 6.7, y)
    assert obtained.static_deviation == pytest.approx(3e-6, rel=1e-12) and obtained.low_frequency == 6.7
    y = np.array([9.0, 9, -5, 1, 4, 1, 1, 1]) * 1e-6
    for engaged, largest in ((0.0, 9e-6), (1.0, 9e-6), (1.5, 5e-6), (2.0, 5e-6), (2.5, 4e-6), (99.0, 1e-6)):
        obtained = score(np.arange(8.0), np.outer(y, Y), np.zeros((8, 3)), along(X, 8), engaged, 6.7, y)
        assert obtained.max_deviation == pytest.approx(largest, rel=1e-12)
    run = np.outer(np.arange(8.0), X)
    obtained = score(np.arange(8.0), run + 5e-6 * X, run, along(X, 8), 0.0, 6.7, np.zeros(8))
    assert obtained.max_deviation == obtained.static_deviation == 0.0 and np.isnan(obtained.ringing_frequency)
    course = np.column_stack([np.cos(TIME), np.sin(TIME), 0 * TIME])
    feed = np.column_stack([-np.sin(TIME), np.cos(TIME), 0 * TIME])
    obtained = score(TIME, course * 1.001, course, feed, 0.0, 6.7, course[:, 1], straight=False)
    assert np.isnan([obtained.static_deviation, obtained.ringing_frequency, obtained.ringing_damping]).all()
    assert obtained.max_deviation == pytest.approx(1e-3, rel=1e-9)  # the circle is 1 mm too large all the way


@settings(max_examples=budget(60), deadline=None)
@given(st.floats(3.0, 40.0), st.floats(0.01, 0.3), st.floats(0.0, 6.28), st.floats(-1e-4, 1e-4))
def test_the_ringing_of_a_damped_vibration_is_found(frequency, damping, phase, mean):
    obtained = ringing_frequency(TIME, ringing(frequency, damping, 5e-6, phase, mean))
    assert obtained == (pytest.approx(frequency, rel=2e-3), pytest.approx(damping, abs=2e-3))


def test_noise_hum_and_the_start_of_the_clock_hardly_move_the_ringing_and_none_is_made_up():
    noise = np.random.default_rng(0).normal(0.0, 0.5e-6, TIME.size)
    hum = 0.5e-6 * np.sin(2 * np.pi * 533.3 * TIME)
    frequency, damping = ringing_frequency(TIME, ringing(6.69, 0.18) + noise + hum)
    assert frequency == pytest.approx(6.69, rel=0.03) and damping == pytest.approx(0.18, abs=0.03)
    shifted = ringing_frequency(TIME + 12.5, ringing(6.69, 0.05))
    np.testing.assert_allclose(shifted, ringing_frequency(TIME, ringing(6.69, 0.05)), rtol=1e-6)
    for still in (np.zeros(TIME.size), np.full(TIME.size, 3e-3), ringing(6.7, 0.1, amplitude=5e-10), np.ones(15)):
        assert np.isnan(ringing_frequency(TIME[: still.size], still)).all()


# --- A long pass: windows do not change it, and combined rows keep its extremes, sums and means ---
SERIES = ("time_ns", "target", "reference", "tool", "deflection", "wrench", "correction", "torque", "volume")


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A cell that mills a tool path by its engagement, and its pass."""
    words = ("cutting.detail=engagement", "dynamics.follow_pose=true")
    long = small_part(tmp_path_factory.mktemp("long"), GCODE, *words)
    return long, simulate(long)


def test_a_pass_in_windows_is_the_same_to_the_bit_and_its_progress_only_grows(whole, monkeypatch):
    monkeypatch.setattr(milling_pass, "WINDOW", 73)
    cell, original = whole
    counts: list[tuple[int, int]] = []
    ran = simulate(cell, progress=lambda *count: counts.append(count)).result
    for name in SERIES:
        np.testing.assert_array_equal(getattr(ran, name), getattr(original.result, name), err_msg=name)
    done, totals = zip(*counts, strict=True)
    assert list(done) == sorted(set(done)) and done[-1] == totals[-1] and len(set(totals)) == 1


@pytest.mark.parametrize("window", [64, milling_pass.WINDOW])
def test_combined_rows_keep_extremes_sums_means_and_the_scores(whole, monkeypatch, window):
    monkeypatch.setattr(milling_pass, "WINDOW", window)
    cell, original = whole
    plain, periods = original.result, len(original.result.time) - 1
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
    assert ran.scores.max_deviation == pytest.approx(original.scores.max_deviation, rel=0.05)
    assert some.removed_volume == plain.removed_volume


def test_a_quick_pass_exchanges_fewer_times_in_a_steady_cut_with_the_same_deflections(tmp_path, monkeypatch):
    cell = small_part(tmp_path, GCODE.replace("F4000", "F400"), "cutting.detail=engagement")
    plain = simulate(cell).result
    monkeypatch.setattr(milling_pass, "MANY", 100)
    ran = simulate(cell, quick=True).result
    exchanges = 1 + np.count_nonzero((np.diff(ran.wrench[1:], axis=0) != 0.0).any(axis=1))
    assert exchanges < 0.5 * len(ran.time)
    apart = np.abs(ran.deflection - plain.deflection)[:, :3]
    assert np.quantile(apart, 0.99) < 2.0 * milling_pass.STEADY < 0.1 * np.abs(plain.deflection[:, :3]).max()
    assert ran.removed_volume == pytest.approx(plain.removed_volume, rel=1e-3)
    assert ran.volume.sum() == pytest.approx(ran.removed_volume, rel=1e-9)


def test_the_memory_of_a_pass_does_not_grow_with_its_length(tmp_path, monkeypatch):
    """A tenth of the feed takes six times the periods, with rapid moves; windows and rows stay as many as before."""
    monkeypatch.setattr(milling_pass, "WINDOW", 100)
    peaks, periods = [], []
    for feed in ("F4000", "F4000", "F400"):  # the first pass loads compiled code
        cell = small_part(tmp_path, GCODE.replace("F4000", feed), "cutting.detail=engagement")
        target, cut = path_of(cell).target, cut_of(cell)
        arm = arm_model_of(cell, target)
        silent = path_of(cell).drilling_at
        tracemalloc.start()
        ran = milling_pass.run_pass(arm, cut, path_of(cell).clock, target, target, silent=silent, most_rows=50)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
        periods.append(ran.micro_steps)
        assert len(ran.time) <= 51
    assert periods[2] > 5 * periods[1] and peaks[2] < 1.5 * peaks[1]
