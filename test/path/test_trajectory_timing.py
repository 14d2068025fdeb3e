"""From tool path to trajectory: closed forms of the duration, limits, corners, arcs."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from small_part import path_error

from kr270_milling.base.errors import ParameterError
from kr270_milling.path.cam.gcode.reader import read_gcode
from kr270_milling.path.timing import Timing, time_path
from kr270_milling.path.toolpath import PathBuilder, ToolpathError

STEP, FEED = 0.05, 4 / 60
FINE = Timing(controller_step=0.001)
START = "G0 X0 Y0 Z0\nF4000\n"


@pytest.fixture
def read(tmp_path):
    def read(text: str):
        (tmp_path / "part.nc").write_text(START + text)
        return read_gcode(tmp_path / "part.nc")

    return read


def fine(timed) -> np.ndarray:
    return np.arange(0, timed.trajectory.duration_ns, 500_000)


def whole_steps(duration: float, step: float = STEP) -> int:
    """[ns], rounded up"""
    return int(np.ceil(duration / step)) * round(step * 1e9)


def test_a_long_line_takes_length_by_feed_and_one_ramp(read):
    run = time_path(read("G1 X500\n"), Timing()).trajectory
    ramp = 2 * np.sqrt(FEED / 20)  # both ramps cover half of their distance at the feed
    assert run.duration_ns == whole_steps(0.5 / FEED + ramp)
    middle = np.arange(10**9, run.duration_ns - 10**9, 10**7)
    np.testing.assert_allclose(run.feed(middle), FEED, rtol=1e-9)


def test_a_fast_line_holds_the_acceleration(read):
    run = time_path(read("G1 X2000 F60000\n"), Timing()).trajectory
    assert run.duration_ns == whole_steps(2.0 / 1.0 + 1.0 / 2.0 + 2.0 / 20)  # L / v + v / a + a / j


def test_a_short_line_never_reaches_its_feed(read):
    timed = time_path(read("G1 X1\n"), FINE)
    peak = (0.001 / 2) ** (2 / 3) * 20 ** (1 / 3)  # L = 2 v sqrt(v / j)
    assert timed.trajectory.duration_ns == whole_steps(4 * np.sqrt(peak / 20), 0.001)
    assert timed.trajectory.feed(fine(timed)).max() == pytest.approx(peak, rel=0.01)


def test_acceleration_and_jerk_along_the_path_stay_within_their_limits(read):
    path = read("G1 X80 F12000\nG3 X80 Y40 R20 F3000\nG1 X40 F9000\nG0 X0\nG1 Y0 F500\nX0.01\nX3 F60000\n")
    timed = time_path(path, FINE)
    for order, limit in ((2, 2.0), (3, 20.0)):
        difference = np.diff(timed.distance, order) / 0.001**order  # a mean of the derivative, so within its bounds
        assert limit * 0.5 < np.abs(difference).max() <= limit * (1 + 1e-5)


coordinate = st.floats(-0.05, 0.05).map(lambda v: round(v, 6))
blocks = st.tuples(st.tuples(coordinate, coordinate, coordinate), st.floats(1e-3, 0.5), st.booleans(), st.booleans())


@given(st.lists(blocks, min_size=2, max_size=12), st.sampled_from([0.0, 1e-5, 1e-3]))
def test_any_path_is_run_forward_within_all_limits(moves, tolerance):
    builder = PathBuilder("here")
    builder.move((0.0, 0.0, 0.0), 0.0, True, 1)
    builder.move((1e-3, 0.0, 0.0), 0.1, False, 2)
    last = np.array([1e-3, 0.0])
    for point, feed, rapid, bent in moves:
        chord = np.linalg.norm(point[:2] - last)
        builder.move(point, feed, rapid, 3, 1.5 / chord if bent and chord > 1e-6 else 0.0)
        last = np.array(point[:2])
    path = builder.build()
    timed = time_path(path, Timing(controller_step=0.01, corner_tolerance=tolerance))
    assert np.all(np.diff(timed.distance) >= -1e-15)
    for order, limit in ((2, 2.0), (3, 20.0)):
        assert np.abs(np.diff(timed.distance, order)).max() <= limit * 0.01**order + 1e-9
    speed = np.linalg.norm(timed.trajectory.velocity, axis=1)
    assert np.all(speed <= np.where(path.rapid, 0.2, path.feed)[timed.block] * (1 + 1e-9) + 1e-12)
    np.testing.assert_allclose(timed.trajectory.position[-1], path.position[-1], atol=1e-15)


def test_all_knots_lie_on_controller_steps_and_on_the_path(read):
    path = read("G1 X40\nG2 X60 Y-20 I0 J-20\nG1 Y-50\nX0 Y0\n")
    timed = time_path(path, Timing())
    assert np.all(np.diff(timed.trajectory.time_ns) == 50_000_000)
    np.testing.assert_allclose(timed.trajectory.position, path.on_path(timed.distance)[0], atol=1e-15)
    np.testing.assert_array_equal(timed.trajectory.position[[0, -1]], path.position[[0, -1]])
    assert timed.distance[-1] == pytest.approx(path.length, rel=1e-14) and np.all(np.diff(timed.distance) >= 0)


def test_the_tool_stops_exactly_in_a_sharp_corner(read):
    run = time_path(read("G1 X33.3\nY-21.7\nX0 Z1\n"), Timing()).trajectory
    stops = np.flatnonzero(np.linalg.norm(run.velocity, axis=1) == 0)
    corners = np.array([[0, 0, 0], [0.0333, 0, 0], [0.0333, -0.0217, 0], [0, -0.0217, 0.001]])
    np.testing.assert_allclose(run.position[stops], corners, atol=1e-12)


def test_the_feed_is_kept_between_two_stops_although_the_stops_lie_on_steps(read):
    timed = time_path(read("G1 X33.3\nY-21.7\n"), Timing())
    assert timed.trajectory.feed(fine(timed)).max() == pytest.approx(FEED, rel=0.01)


def test_a_tangential_arc_is_entered_and_left_at_the_feed(read):
    timed = time_path(read("G1 X50\nG3 X50 Y60 R30\nG1 X0\n"), Timing())
    inside = slice(int(0.5 / STEP), -int(0.5 / STEP))
    np.testing.assert_allclose(np.linalg.norm(timed.trajectory.velocity, axis=1)[inside], FEED, rtol=1e-9)


def test_a_narrow_arc_is_run_no_faster_than_the_centripetal_acceleration_allows(read):
    timed = time_path(read("G1 X20\nG3 X20 Y2 R1\nG1 X0\n"), FINE)
    on_arc = timed.toolpath.curvature[timed.block] != 0
    assert np.linalg.norm(timed.trajectory.velocity[on_arc], axis=1).max() == pytest.approx(np.sqrt(2.0 * 0.001))


def test_between_the_knots_a_circle_is_met_with_the_fourth_order_of_the_step(read):
    path = read("G1 X0.001\nG2 I0 J-37\n")  # full circle
    errors = []
    for step in (0.1, 0.05, 0.025):
        timed = time_path(path, Timing(controller_step=step))
        time = np.arange(10**9, timed.trajectory.duration_ns - 10**9, 10**6)
        errors.append(path_error(timed, time).max())
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert np.all(np.abs(orders - 4) < 0.2), errors
    steady = (FEED * 0.05) ** 4 / (384 * 0.037**3)  # error of a Hermite cubic on a circle
    assert errors[1] == pytest.approx(steady, rel=0.1)


def test_where_the_curvature_jumps_the_error_is_of_second_order(read):
    path = read("G1 X50\nG3 X50 Y40 R20\nG1 X0\n")
    errors = [time_path(path, Timing(controller_step=s)) for s in (0.016, 0.008, 0.004)]
    largest = [path_error(timed, fine(timed)).max() for timed in errors]
    assert 2 < np.log2(largest[0] / largest[2]) < 6 and largest[2] < 0.2e-6


def polygon(count: int) -> str:
    angle = 2 * np.pi * np.arange(count + 1) / count
    return "".join(f"G1 X{37 * np.sin(a):.6f} Y{37 - 37 * np.cos(a):.6f}\n" for a in angle)


def test_a_polygon_of_short_chords_is_run_through_within_the_corner_tolerance(read):
    timed = time_path(read(polygon(360)), Timing(corner_tolerance=20e-6))
    speed = np.linalg.norm(timed.trajectory.velocity, axis=1)
    assert speed[20:-20].min() > 0.9 * FEED
    assert path_error(timed, fine(timed)).max() < 20e-6


def test_a_coarse_polygon_slows_down_for_the_tolerance_and_stops_without_one(read):
    path = read(polygon(60))
    slow = time_path(path, Timing(corner_tolerance=20e-6))
    assert path_error(slow, fine(slow)).max() < 20e-6
    stopping = time_path(path, Timing(corner_tolerance=0.0))
    assert np.sum(np.linalg.norm(stopping.trajectory.velocity, axis=1) == 0) == 61
    assert stopping.trajectory.duration_ns > slow.trajectory.duration_ns


def test_a_lower_feed_is_reached_before_its_block_begins(read):
    timed = time_path(read("G1 X50 F4000\nX100 F1000\nX150 F4000\n"), FINE)
    slow = timed.block == 2
    assert np.linalg.norm(timed.trajectory.velocity, axis=1)[slow].max() <= 1 / 60 * (1 + 1e-9)


def test_a_line_given_in_pieces_is_run_as_one(read):
    whole = time_path(read("G1 X60\n"), Timing()).trajectory
    pieces = time_path(read("G1 X0.003\nX1\nX17\nX59.999\nX60\n"), Timing()).trajectory
    np.testing.assert_allclose(pieces.position, whole.position, atol=1e-12)


def test_the_way_back_takes_as_long_as_the_way_there(read):
    there = time_path(read("G1 X50\nG3 X50 Y60 R30\nG1 X20\nX0 Y40\n"), Timing()).trajectory
    back = time_path(read("G0 X0 Y40\nG1 X20 Y60\nX50\nG2 X50 Y0 R30\nG1 X0\n"), Timing(rapid_feed=FEED)).trajectory
    first = time_path(read("G0 X0 Y40\n"), Timing(rapid_feed=FEED)).trajectory
    assert back.duration_ns - first.duration_ns == there.duration_ns


def test_rapid_moves_run_at_their_own_speed(read):
    timed = time_path(read("G0 X400\nG1 X800\n"), Timing(rapid_feed=0.3))
    assert timed.trajectory.feed(fine(timed)).max() == pytest.approx(0.3, rel=1e-2)


def test_each_time_belongs_to_the_feature_of_its_block(read):
    timed = time_path(read("(one)\nG1 X50\n(two)\nY50\n"), Timing())
    half = timed.trajectory.duration_ns // 2
    assert timed.toolpath.features == ("", "one", "two")
    assert timed.toolpath.feature[timed.block_at(np.array([0, half - 10**8, half + 10**8]))].tolist() == [1, 1, 2]


def test_the_tool_turns_evenly_along_a_block():
    builder = PathBuilder("here")
    builder.move((0.0, 0.0, 0.0), 0.0, True, 1)
    builder.quaternion = (np.cos(0.1), 0.0, np.sin(0.1), 0.0)
    builder.move((0.1, 0.0, 0.0), 0.05, False, 2)
    timed = time_path(builder.build(), Timing())
    angle = np.arctan2(timed.trajectory.quaternion[:, 2], timed.trajectory.quaternion[:, 0])
    np.testing.assert_allclose(angle, 0.1 * timed.distance / 0.1, atol=1e-12)


def test_a_path_that_would_take_for_ever_is_refused(read):
    with pytest.raises(ToolpathError, match="feed"):
        time_path(read("G1 X5000 F0.001\n"), FINE)


@pytest.mark.parametrize("name", ["controller_step", "acceleration", "jerk", "rapid_feed", "corner_tolerance"])
def test_limits_out_of_range_are_refused(name):
    for value in (-1.0, float("nan"), 1e9):
        with pytest.raises(ParameterError):
            Timing(**{name: value})
