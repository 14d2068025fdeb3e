"""From tool path to trajectory: records, ramps, limits of path and joints, and the shipped test piece."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from samples.small_part import path_error

from kr270_milling.path.cam.gcode.reader import read_gcode
from kr270_milling.path.cam.readers import read_toolpath
from kr270_milling.path.timing import (
    Ramps,
    Timing,
    joint_rates,
    limit_by_joints,
    ramp_time,
    time_path,
    vertex_speeds,
)
from kr270_milling.path.toolpath import PathBuilder, Toolpath, ToolpathError
from kr270_milling.path.trajectory import TOOL_DOWN, Trajectory, TrajectoryError


def corner() -> PathBuilder:
    """10 mm along x, then a quarter circle of 10 mm radius to the left in one chord."""
    builder = PathBuilder("here")
    builder.move((0.0, 0.0, 0.0), 0.0, True, 1)
    builder.move((0.01, 0.0, 0.0), 0.02, False, 2)
    builder.move((0.02, 0.01, 0.0), 0.02, False, 3, 100.0)
    return builder


def test_points_on_the_path_lie_on_the_arc_with_its_climbing_tangent_in_the_block_of_their_distance():
    path = corner().build()
    position, tangent, _ = path.on_path(np.array([0.0, 0.005, 0.01, 0.01 + 0.01 * np.pi / 6, path.length]))
    angle = np.pi / 6
    on_arc = [0.01 + 0.01 * np.sin(angle), 0.01 - 0.01 * np.cos(angle), 0]
    np.testing.assert_allclose(position[1:], [[0.005, 0, 0], [0.01, 0, 0], on_arc, [0.02, 0.01, 0]], atol=1e-17)
    np.testing.assert_allclose(tangent[2:], [[1, 0, 0], [np.cos(angle), np.sin(angle), 0], [0, 1, 0]], atol=1e-15)
    builder = corner()
    builder.move((0.01, 0.02, 0.01), 0.02, False, 4, 100.0)
    _, tangent, _ = builder.build().on_path(np.array([0.01 + 0.01 * np.pi / 2 + 1e-9]))
    np.testing.assert_allclose(tangent[0, 2], 1 / np.hypot(1, np.pi / 2), rtol=1e-6)
    assert path.block_at([-1.0, 0.0, 0.0099, 0.0101, 9.0]).tolist() == [1, 1, 1, 2, 2]


@pytest.mark.parametrize(("change", "index"), [
    ({"feed": np.array([0.0, 0.1, 0.0])}, 2), ({"feed": np.array([0.0, 0.1, np.nan])}, 2),
    ({"curvature": np.array([0.0, np.inf, 0.0])}, 1), ({"line": np.zeros(2)}, None),
    ({"position": np.zeros((1, 3))}, None),
])  # fmt: skip
def test_a_path_that_cannot_be_run_is_refused_with_its_block(change, index):
    names = ("position", "feed", "rapid", "line", "feature", "features", "curvature", "spindle_speed", "quaternion")
    path = corner().build()
    with pytest.raises(ToolpathError) as caught:
        Toolpath(**{name: getattr(path, name) for name in names} | change)
    assert caught.value.index == index


# --- S-shaped ramps ---
A, J = 2.0, 20.0
speeds, lengths = st.floats(0, 1), st.floats(1e-6, 1)


def way(first, last):
    """Distance of a ramp: mean speed times duration."""
    return (first + last) / 2 * ramp_time(last - first, A, J)


def test_ramps_take_two_parts_or_hold_the_acceleration_and_are_derivatives_of_each_other_up_to_their_limits():
    for change, duration in ((0.05, 2 * np.sqrt(0.05 / J)), (-1.0, 1.0 / A + A / J), (A**2 / J, 2 * A / J)):
        assert ramp_time(change, A, J) == pytest.approx(duration)
    first, last = np.array([0.0, 0.5, 0.5, 0.45, 0.0]), np.array([0.5, 0.5, 0.45, 0.0, 0.0])
    more = np.array([0, 0.3, 0, 0.2, 0.1])  # the fourth is stretched
    ramps = Ramps.make(ramp_time(last - first, A, J) + more, first, last, A, J)
    time, step = np.linspace(0, ramps.start[-1], 40001, retstep=True)
    distance, speed, acceleration = ramps.sample(time)
    assert np.abs(np.gradient(distance, step) - speed)[1:-1].max() < step * A
    assert np.abs(np.gradient(speed, step) - acceleration)[1:-1].max() < step * J
    assert np.abs(acceleration).max() == pytest.approx(A, rel=1e-9)
    assert np.abs(np.diff(acceleration)).max() / step == pytest.approx(J, rel=1e-6)
    total = np.sum((ramps.first + ramps.last) / 2 * ramps.duration)  # mean speed times duration of each ramp
    assert ramps.sample(np.array([ramps.start[-1] + 9.0]))[0] == pytest.approx(total)


@given(st.lists(st.tuples(lengths, speeds), min_size=1, max_size=20))
def test_speeds_at_the_vertices_are_below_their_caps_and_within_reach_of_each_other(segments):
    length = np.array([s[0] for s in segments])
    cap = np.array([0.0, *(s[1] for s in segments[:-1]), 0.0])
    speed = vertex_speeds(cap, length, A, J)
    assert np.all(speed <= cap) and np.all(speed >= 0)
    assert np.all(way(speed[:-1], speed[1:]) <= length + 1e-9)  # an ulp of speed
    raised = cap - speed > 1e-6  # none of them could be higher
    for i in np.flatnonzero(raised):
        higher = speed.copy()
        higher[i] += 1e-6
        assert np.any(way(higher[:-1], higher[1:]) > length * (1 - 1e-6))


# --- From tool path to trajectory ---
STEP, FEED = 0.05, 4 / 60
FINE = Timing(controller_step=0.001)
SHORT_PEAK = (0.001 / 2) ** (2 / 3) * 20 ** (1 / 3)  # [m/s] of 1 mm from rest to rest: L = 2 v sqrt(v / j)
START = "G0 X0 Y0 Z0\nF4000\n"


@pytest.fixture
def read(tmp_path):
    def read(text: str):
        (tmp_path / "part.nc").write_text(START + text)
        return read_gcode(tmp_path / "part.nc")

    return read


def fine(timed) -> np.ndarray:
    return np.arange(0, timed.trajectory.duration_ns, 500_000)


@pytest.mark.parametrize(("text", "step", "duration", "peak"), [
    ("G1 X500\n", STEP, 0.5 / FEED + 2 * np.sqrt(FEED / 20), FEED),
    ("G1 X2000 F60000\n", STEP, 2.0 / 1.0 + 1.0 / 2.0 + 2.0 / 20, 1.0),
    ("G1 X1\n", 0.001, 4 * np.sqrt(SHORT_PEAK / 20), SHORT_PEAK),
])  # fmt: skip
def test_a_line_takes_length_by_feed_and_its_ramps(read, text, step, duration, peak):
    """L / v and two ramps; L / v + v / a + a / j at constant acceleration; a line that never reaches its feed."""
    timed = time_path(read(text), Timing(controller_step=step))
    assert timed.trajectory.duration_ns == math.ceil(duration / step) * round(step * 1e9)  # whole steps
    assert timed.trajectory.feed(fine(timed)).max() == pytest.approx(peak, rel=0.01)


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


def test_all_knots_lie_on_steps_and_on_the_path_and_the_tool_stops_in_sharp_corners_and_at_no_tangential_arc(read):
    path = read("G1 X40\nG2 X60 Y-20 I0 J-20\nG1 Y-50\nX0 Y0\n")
    timed = time_path(path, Timing())
    assert np.all(np.diff(timed.trajectory.time_ns) == 50_000_000)
    np.testing.assert_allclose(timed.trajectory.position, path.on_path(timed.distance)[0], atol=1e-15)
    np.testing.assert_array_equal(timed.trajectory.position[[0, -1]], path.position[[0, -1]])
    assert timed.distance[-1] == pytest.approx(path.length, rel=1e-14) and np.all(np.diff(timed.distance) >= 0)
    run = time_path(read("G1 X33.3\nY-21.7\nX0 Z1\n"), Timing()).trajectory
    stops = np.flatnonzero(np.linalg.norm(run.velocity, axis=1) == 0)
    corners = np.array([[0, 0, 0], [0.0333, 0, 0], [0.0333, -0.0217, 0], [0, -0.0217, 0.001]])
    np.testing.assert_allclose(run.position[stops], corners, atol=1e-12)
    timed = time_path(read("G1 X50\nG3 X50 Y60 R30\nG1 X0\n"), Timing())
    inside = slice(int(0.5 / STEP), -int(0.5 / STEP))
    np.testing.assert_allclose(np.linalg.norm(timed.trajectory.velocity, axis=1)[inside], FEED, rtol=1e-9)
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


def test_a_polygon_is_run_within_the_corner_tolerance_without_slowing_down_slower_or_with_stops(read):
    """Chords of 1 and of 6 deg with a tolerance, and of 6 deg without."""
    rates = []
    for count, tolerance in ((360, 20e-6), (60, 20e-6), (60, 0.0)):
        angle = 2 * np.pi * np.arange(count + 1) / count
        blocks = "".join(f"G1 X{37 * np.sin(a):.6f} Y{37 - 37 * np.cos(a):.6f}\n" for a in angle)
        timed = time_path(read(blocks), Timing(corner_tolerance=tolerance))
        assert path_error(timed, fine(timed)).max() < 20e-6
        rates.append(np.linalg.norm(timed.trajectory.velocity, axis=1))
    assert rates[0][20:-20].min() > 0.9 * FEED
    assert np.sum(rates[1] == 0) == 2 and len(rates[0]) < len(rates[1]) < len(rates[2])
    assert np.sum(rates[2] == 0) == 61


def test_pieces_of_a_line_are_run_as_one_rapid_moves_at_their_speed_and_each_time_has_its_feature(read):
    whole = time_path(read("G1 X60\n"), Timing()).trajectory
    pieces = time_path(read("G1 X0.003\nX1\nX17\nX59.999\nX60\n"), Timing()).trajectory
    np.testing.assert_allclose(pieces.position, whole.position, atol=1e-12)
    timed = time_path(read("G0 X400\nG1 X800\n"), Timing(rapid_feed=0.3))
    assert timed.trajectory.feed(fine(timed)).max() == pytest.approx(0.3, rel=1e-2)
    timed = time_path(read("(one)\nG1 X50\n(two)\nY50\n"), Timing())
    half = timed.trajectory.duration_ns // 2
    assert timed.toolpath.features == ("", "one", "two")
    assert timed.toolpath.feature[timed.block_at(np.array([0, half - 10**8, half + 10**8]))].tolist() == [1, 1, 2]
    with pytest.raises(ToolpathError, match="feed"):
        time_path(read("G1 X5000 F0.001\n"), FINE)


def test_the_tool_turns_evenly_along_a_block():
    builder = PathBuilder("here")
    builder.move((0.0, 0.0, 0.0), 0.0, True, 1)
    builder.quaternion = (np.cos(0.1), 0.0, np.sin(0.1), 0.0)
    builder.move((0.1, 0.0, 0.0), 0.05, False, 2)
    timed = time_path(builder.build(), Timing())
    angle = np.arctan2(timed.trajectory.quaternion[:, 2], timed.trajectory.quaternion[:, 0])
    np.testing.assert_allclose(angle, 0.1 * timed.distance / 0.1, atol=1e-12)


# --- Slowing down for the joints ---
SPEED, ACCELERATION = np.full(6, 1.0), np.full(6, 8.0)


@pytest.mark.parametrize("times", [1.0, 4.0, 25.0])
def test_a_turning_tool_is_slowed_down_where_a_joint_needs_it_and_by_no_more(times):
    """A joint runs from rest to rest by a parabola each at ``times`` its limit, which takes sqrt(times) as long."""
    count = 401
    time_ns, share = np.arange(count) * 5_000_000, np.linspace(0, 1, count)
    bump = np.where(share < 0.5, 2 * share**2, 1 - 2 * (1 - share) ** 2)
    peak = 0.25 * ACCELERATION[0] * times * (1e-9 * time_ns[-1]) ** 2  # a (T / 2)^2
    joints = np.outer(bump * peak, [1.0, 0.5, 0.0, 0.0, 0.0, 0.1])
    turn = np.stack([np.cos(share), 0 * share, np.sin(share), 0 * share], axis=1)
    place = np.outer(share, [0.1, 0, 0])
    run = Trajectory(time_ns, place, turn, np.gradient(place, 1e-9 * time_ns, axis=0) * (bump * (1 - bump))[:, None])
    slow = limit_by_joints(run, joints, np.full(6, 1e9), ACCELERATION)
    assert slow.duration_ns == pytest.approx(run.duration_ns * np.sqrt(times), rel=0.06)
    assert np.abs(joint_rates(slow.time, joints)[1]).max() <= ACCELERATION[0] * (1 + 1e-4)  # times in whole ns


def motion(joints: np.ndarray, velocity=None) -> Trajectory:
    """Any tool path with as many knots, 50 ms apart; the joints need not belong to it."""
    count = len(joints)
    line = np.linspace(0, 1, count)[:, None] * [1.0, 0.0, 0.0]
    return Trajectory(np.arange(count) * 50_000_000, line, TOOL_DOWN, velocity)


def within_limits(run: Trajectory, joints) -> bool:
    speed, acceleration = joint_rates(run.time, joints, at_rest=False)
    return np.all(np.abs(speed) <= SPEED * (1 + 1e-9)) and np.all(np.abs(acceleration) <= ACCELERATION * (1 + 1e-6))


def test_rates_of_a_parabola_are_exact_and_a_start_from_rest_counts_as_acceleration():
    time = np.array([0.0, 0.1, 0.3, 0.35])
    speed, acceleration = joint_rates(time, np.tile((2 * time**2 + time)[:, None], 6), at_rest=False)
    np.testing.assert_allclose(speed[:, 0], 2 * (time[1:] + time[:-1]) + 1)
    np.testing.assert_allclose(acceleration[1:-1], 4.0)
    time = np.array([0.0, 0.1, 0.2])
    _, acceleration = joint_rates(time, np.tile(1.5 * time[:, None] ** 2, 6), at_rest=True)
    np.testing.assert_allclose(acceleration[:2], 3.0)


def test_only_the_steps_about_a_violation_grow_by_the_factor_of_the_excess():
    joints = np.tile(np.linspace(0, 0.5, 21)[:, None], 6)
    run = motion(joints)
    assert limit_by_joints(run, joints, SPEED, ACCELERATION) is run
    joints = np.zeros((21, 6))
    joints[:, 3] = np.linspace(0, 3.0, 21)  # 3 rad/s
    run = limit_by_joints(motion(joints, np.tile([1.0, 0, 0], (21, 1))), joints, SPEED, ACCELERATION)
    assert run.duration_ns == pytest.approx(3 * 10**9, rel=1e-6)
    np.testing.assert_allclose(run.velocity[:, 0], 1 / 3, rtol=1e-6)
    joints = np.zeros((81, 6))
    joints[:, 0] = 0.2 * np.tanh(np.linspace(-20, 20, 81) * 2)
    run = limit_by_joints(motion(joints), joints, SPEED, ACCELERATION)
    step = np.diff(run.time_ns)
    assert within_limits(run, joints) and step.max() > 60_000_000
    assert np.all(step[:25] == 50_000_000) and np.all(step[-25:] == 50_000_000)
    joints = np.zeros((21, 6))
    for arguments in ((joints[:20], SPEED), (np.full((21, 6), np.nan), SPEED), (joints, 0 * SPEED)):
        with pytest.raises(TrajectoryError):
            limit_by_joints(motion(joints), *arguments, ACCELERATION)


@pytest.mark.parametrize("seed", range(2))
def test_rough_motions_end_up_within_all_limits_and_no_step_gets_shorter(seed):
    joints = np.cumsum(np.random.default_rng(seed).normal(0, 0.05, (200, 6)), axis=0)
    run = limit_by_joints(motion(joints), joints, SPEED, ACCELERATION)
    assert within_limits(run, joints)
    assert np.all(np.diff(run.time_ns) >= 50_000_000)
    np.testing.assert_array_equal(run.position, motion(joints).position)


# --- The shipped test piece has the dimensions that its comments claim ---
CUTTER = 10.0  # mm, radius
LEAN = np.radians(3.0)  # of the inclined side


@pytest.fixture(scope="module")
def piece():
    return read_toolpath(Path(__file__).parents[2] / "config" / "test_piece.nc")


def cuts(piece, feature: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Starts and ends [mm], (m, 3), and curvatures [1/mm] of the cutting blocks of a feature."""
    k = np.flatnonzero((piece.feature == piece.features.index(feature)) & ~piece.rapid)
    return piece.position[k - 1] * 1e3, piece.position[k] * 1e3, piece.curvature[k] * 1e-3


@pytest.mark.parametrize(("feature", "directions", "distance", "level"), [
    ("square", {0, 90, 180, 270}, 40, -1.2),
    ("circle", {0}, 27, -0.4),  # lead in and out along the tangent
    ("diamond", {45, 135, 225, 315}, 40 / np.sqrt(2), -0.8),
    ("inclined_side", {267}, 40 * (np.sin(LEAN) + np.cos(LEAN)), -1.6),  # from the corner of the square
])  # fmt: skip
def test_straight_cuts_leave_walls_in_these_directions_and_levels(piece, feature, directions, distance, level):
    """Outward normals [deg]; the part is on the right of a tool that runs clockwise."""
    start, end, curvature = cuts(piece, feature)
    along = (end - start)[curvature == 0, :2]
    left = np.column_stack([-along[:, 1], along[:, 0]]) / np.linalg.norm(along, axis=1, keepdims=True)
    distances = np.sum(left * start[curvature == 0, :2], axis=1) - CUTTER
    np.testing.assert_allclose(distances, distance, atol=1e-4)  # four digits in the file
    assert set(np.degrees(np.arctan2(left[:, 1], left[:, 0])).round(2) % 360) == directions
    assert set(end[:, 2]) == {level}


def test_the_square_has_round_corners_the_circle_54_mm_and_every_feature_is_cut_clockwise(piece):
    start, _, curvature = cuts(piece, "square")
    corners = start[curvature != 0, :2]
    np.testing.assert_allclose(np.linalg.norm(np.abs(corners) - 40, axis=1), CUTTER, atol=1e-9)
    np.testing.assert_allclose(curvature[curvature != 0], -1 / CUTTER)
    start, end, curvature = cuts(piece, "circle")
    arc = curvature != 0
    np.testing.assert_allclose(2 * (np.linalg.norm(start[arc, :2], axis=1) - CUTTER), 54, atol=1e-9)
    np.testing.assert_allclose(start[arc][0], end[arc][-1], atol=1e-12)
    assert np.all(piece.curvature <= 0) and len(piece.features) == 6
    np.testing.assert_allclose(piece.spindle_speed, 8000 * 2 * np.pi / 60)
    np.testing.assert_allclose(piece.feed[~piece.rapid], 4 / 60)


def test_nothing_but_the_part_and_the_base_is_left_standing(piece):
    """Everything outside of the diamond, within the square, is swept at the level of the diamond or below."""
    grid = np.stack(np.meshgrid(np.linspace(-40, 40, 81), np.linspace(-40, 40, 81)), -1).reshape(-1, 2)
    outside = grid[np.abs(grid).sum(axis=1) > 40.01]
    swept = np.zeros(len(outside), bool)
    timed = time_path(piece, Timing(controller_step=0.01))
    deep = timed.trajectory.position[:, 2] <= -0.8e-3
    for centre in timed.trajectory.position[deep, :2] * 1e3:
        swept |= np.linalg.norm(outside - centre, axis=1) <= CUTTER + 0.02
    assert swept.all()
