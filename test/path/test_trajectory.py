"""The sampled trajectory: its interpolation, its file, and the stops of the tool."""

from __future__ import annotations

import csv
import itertools

import numpy as np
import pytest
from scipy.interpolate import CubicSpline, PchipInterpolator
from scipy.spatial.transform import Rotation, Slerp
from splines import spline

from kr270_milling.base.errors import InputError
from kr270_milling.decide.check_arm import corner_blending
from kr270_milling.decide.programs.krl import Program
from kr270_milling.decide.programs.points import point_numbers
from kr270_milling.path.trajectory import AT_REST, TOOL_DOWN, Trajectory, TrajectoryError, read_csv, write_csv
from kr270_milling.physics.compensation.revision import corrected, resting_segments

TIME = np.array([0, 50_000_000, 100_000_000, 170_000_000, 250_000_000])
PATH = np.array([[0.0, 0.0, 0.0], [3.0, 1.0, 0.0], [6.0, -1.0, 1.0], [9.0, 0.0, 4.0], [10.0, 2.0, 4.0]]) * 1e-3
FINE = np.linspace(0, TIME[-1], 777).astype(np.int64)


def test_a_path_is_straight_from_knot_to_knot_or_with_velocities_a_spline_as_scipy_evaluates_it():
    expected = [np.interp(FINE, TIME, PATH[:, i]) for i in range(3)]
    np.testing.assert_allclose(Trajectory(TIME, PATH, TOOL_DOWN).sample(FINE), np.transpose(expected), atol=1e-17)
    for ends in ("natural", "not-a-knot", "clamped"):
        oracle = CubicSpline(TIME * 1e-9, PATH, bc_type=ends)
        run = spline(TIME, PATH, ends=ends)
        np.testing.assert_allclose(run.sample(FINE), oracle(FINE * 1e-9), atol=1e-16)
        np.testing.assert_allclose(run.sample_velocity(FINE), oracle(FINE * 1e-9, 1), rtol=1e-10, atol=1e-14)
    run = spline(TIME, PATH)
    outside = np.array([-5, TIME[-1] + 1])
    np.testing.assert_array_equal(run.sample(outside), PATH[[0, -1]])
    assert np.all(run.feed(outside) == 0)


def test_orientation_follows_scipys_slerp_the_short_way_and_a_constant_one_stays_to_the_last_bit():
    turns = Rotation.from_euler("ZYX", np.random.default_rng(1).uniform(-1, 1, (5, 3)))
    quaternion = turns.as_quat() * np.array([1, -1, 1, 1, -1])[:, None]  # q and -q are one rotation
    run = Trajectory(TIME, PATH, quaternion)
    sampled = Rotation.from_quat(run.sample_orientation(FINE))
    assert (sampled.inv() * Slerp(TIME, turns)(FINE)).magnitude().max() < 1e-7
    assert np.all(Trajectory(TIME, PATH, TOOL_DOWN).sample_orientation(FINE) == TOOL_DOWN)


def test_a_tool_with_velocities_turns_without_jumps_of_the_rate_and_as_scipys_monotone_cubic_about_one_axis():
    angle = np.array([0.0, 0.0, 0.1, 0.15, 0.1])
    run = Trajectory(TIME, PATH, Rotation.from_euler("Y", angle[:, None]).as_quat(), np.zeros((5, 3)))
    oracle = PchipInterpolator(TIME * 1e-9, angle)
    before, inner = TIME[1] > FINE, (TIME[1] < FINE) & (TIME[3] > FINE)  # the ends of the oracle have other rates
    sampled = Rotation.from_quat(run.sample_orientation(FINE)).as_euler("YXZ")[:, 0]
    np.testing.assert_allclose(sampled[inner], oracle(FINE[inner] * 1e-9), atol=1e-14)
    np.testing.assert_allclose(run.turn(FINE[inner])[2][:, 1], oracle(FINE[inner] * 1e-9, 1), atol=1e-12)
    assert np.abs(sampled[before]).max() < 1e-15  # the axis holds until its turn begins
    turns = Rotation.from_euler("ZYX", 0.02 * np.random.default_rng(1).uniform(-1, 1, (5, 3)))
    run = Trajectory(TIME, PATH, turns.as_quat(), np.zeros((5, 3)))
    assert (Rotation.from_quat(run.sample_orientation(TIME)).inv() * turns).magnitude().max() < 1e-7
    np.testing.assert_allclose(run.turn(TIME[1:-1], "left")[2], run.turn(TIME[1:-1])[2], atol=1e-12)


def test_a_line_has_its_knots_at_the_step_ends_exactly_keeps_its_feed_and_needs_length_feed_and_step():
    line = Trajectory.straight_line([0.0, 0.01, 0.0], [2.0, 0.0, 0.0], 0.080, 4 / 60, 0.05)
    assert len(line) == 25 and line.duration_ns == 1_200_000_000
    np.testing.assert_array_equal(line.position[-1], [0.08, 0.01, 0.0])
    line = Trajectory.straight_line(np.zeros(3), [0.0, 1.0, 0.0], 0.081, 4 / 60, 0.05)
    assert line.duration_ns == 1_215_000_000 and np.all(np.diff(line.time_ns)[:-1] == 50_000_000)
    np.testing.assert_allclose(line.feed(line.time_ns), 4 / 60, rtol=1e-9)
    for value in (0.0, -1.0, np.nan):
        for arguments in ([value, 1.0, 1.0], [1.0, value, 1.0], [1.0, 1.0, value]):
            with pytest.raises(TrajectoryError):
                Trajectory.straight_line(np.zeros(3), [1.0, 0.0, 0.0], *arguments)


@pytest.mark.parametrize(("change", "index"), [
    ({"time_ns": TIME + 1}, 0), ({"time_ns": np.array([0, 1, 1, 2, 3])}, 2), ({"time_ns": TIME * 1.0}, None),
    ({"time_ns": TIME[:1], "position": PATH[:1]}, None), ({"position": PATH[:4]}, None),
    ({"position": np.vstack([PATH[:3], np.full((2, 3), np.nan)])}, 3),
    ({"quaternion": np.diag([1.0, 1.0, 1.0, 0.0, 1.0])[:, :4]}, 3),
    ({"velocity": np.full((5, 3), np.inf)}, 0),
])  # fmt: skip
def test_a_trajectory_that_no_tool_can_follow_is_refused_with_its_knot(change, index):
    with pytest.raises(TrajectoryError) as caught:
        Trajectory(**({"time_ns": TIME, "position": PATH, "quaternion": TOOL_DOWN} | change))
    assert caught.value.index == index


# --- Trajectories as CSV ---
RANDOM = np.random.default_rng(5)
QUATERNION = RANDOM.normal(size=(7, 4))
RUN = spline(
    np.cumsum([0, 50_000_000, 4_000_000, 1, 12_000_000, 333_333_333, 9_999_999_999]), RANDOM.normal(size=(7, 3)),
    QUATERNION / np.linalg.norm(QUATERNION, axis=1, keepdims=True),
)  # fmt: skip


def test_a_trajectory_comes_back_from_its_file_whose_header_a_csv_reader_understands(tmp_path):
    file = tmp_path / "t.csv"
    for run, joints in itertools.product((RUN.with_position(RUN.position), RUN), (None, RANDOM.uniform(-3, 3, (7, 6)))):
        write_csv(file, run, joints)
        back, angles = read_csv(file)
        for name in ("time_ns", "position", "velocity"):
            np.testing.assert_array_equal(getattr(back, name), getattr(run, name))
        np.testing.assert_allclose(back.quaternion, run.quaternion, rtol=0, atol=1e-15)
        assert (angles is None) == (joints is None) and (joints is None or np.abs(angles - joints).max() < 1e-15)
    rows = list(csv.DictReader(file.read_text().splitlines()))
    assert len(rows) == 7 and float(rows[2]["time_s"]) == 0.054
    assert float(rows[2]["x_mm"]) == pytest.approx(1e3 * RUN.position[2, 0], rel=1e-15)
    assert {"qx", "qw", "a1_deg", "a6_deg"} <= set(rows[0])


@pytest.mark.parametrize(("old", "new", "line"), [
    ("time_s", "t", 1), ("0.054000000,", "0.054000000,nan,", 4), ("0.054000000,", "0.001000000,", 4),
    ("0.054000000,", "zero,", 4), ("0.000000000,", "1e300,", 2), ("\n", "", 8),
])  # fmt: skip
def test_a_spoilt_file_is_refused_with_its_line(tmp_path, old, new, line):
    write_csv(tmp_path / "t.csv", RUN)
    text = (tmp_path / "t.csv").read_text()
    (tmp_path / "t.csv").write_text(text.replace(old, new, 1) if new else text.rstrip(old))  # the last end of a line
    with pytest.raises(InputError) as caught:
        read_csv(tmp_path / "t.csv")
    assert caught.value.line == line


# --- Stops of the tool ---
STOP = 5  #: knot of the corner


def corner(rest_speed: float = 0.0) -> Trajectory:
    """Along x, a stop of one segment in the corner, along y; the speed at rest as rounding may leave it."""
    time = np.arange(12) * 12_000_000
    x = np.concatenate([np.arange(6), np.full(6, 5.0)]) * 0.5e-3
    y = np.concatenate([np.zeros(7), np.arange(1, 6)]) * 0.5e-3
    velocity = np.zeros((12, 3))
    velocity[1:5, 0], velocity[7:11, 1] = 0.04, 0.04
    velocity[[0, 5, 6, 11], 2] = rest_speed
    return Trajectory(time, np.stack([x, y, 0.0 * x], axis=1), TOOL_DOWN, velocity)


def rounded_off(rest_speed: float) -> list:
    """What is rounded off of the same corner as one knot, corrected by 50 um, less than the 88 um of blending."""
    run, rows = corner(rest_speed), np.delete(np.arange(12), 6)
    run = Trajectory(np.arange(11) * 12_000_000, run.position[rows], TOOL_DOWN, run.velocity[rows])
    return corner_blending(run, run.with_position(run.position + [0.0, 0.0, 50e-6], run.velocity), 1e-3)


@pytest.mark.parametrize("speed", [0.0, 1e-12, 3e-9, 0.9 * AT_REST])
def test_a_stop_is_one_for_correction_program_and_check_whatever_rounding_left_of_its_speed(speed):
    """A reference that came back from a file or a message whose stop is no exact zero any more."""
    run = corner(speed)
    assert np.flatnonzero(run.standing).tolist() == [0, 5, 6, 11]
    assert np.flatnonzero(resting_segments(run)).tolist() == [5]
    shift = np.outer(np.linspace(0.0, 50e-6, 12), [0.0, 1.0, 0.0])
    revised, _ = corrected(run, shift, True)
    assert np.ptp(revised.position[5:7], axis=0).max() == 0.0  # the correction is constant
    points = point_numbers(Program(point_spacing=0.6e-3), run, revised)
    assert STOP in points or STOP + 1 in points  # though it is nearer to the point before than others may be
    assert rounded_off(speed) == []  # the robot stops: nothing is rounded off


def test_what_creeps_and_straight_lines_through_the_knots_do_not_stand():
    run = corner(2 * AT_REST)
    assert not run.standing.any() and not resting_segments(run).any()
    assert [violation.where.point for violation in rounded_off(2 * AT_REST)] == [STOP + 1]
    run = corner()
    assert not run.with_position(run.position).standing.any()
