"""The sampled trajectory: its interpolation convention and its checks at the door."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, Slerp
from splines import spline

from kr270_milling.path.trajectory import TOOL_DOWN, Trajectory, TrajectoryError

TIME = np.array([0, 50_000_000, 100_000_000, 170_000_000, 250_000_000])
PATH = np.array([[0.0, 0.0, 0.0], [3.0, 1.0, 0.0], [6.0, -1.0, 1.0], [9.0, 0.0, 4.0], [10.0, 2.0, 4.0]]) * 1e-3
FINE = np.linspace(0, TIME[-1], 777).astype(np.int64)


def test_without_velocities_the_tool_runs_straight_from_knot_to_knot():
    expected = [np.interp(FINE, TIME, PATH[:, i]) for i in range(3)]
    np.testing.assert_allclose(Trajectory(TIME, PATH, TOOL_DOWN).sample(FINE), np.transpose(expected), atol=1e-17)


def test_any_cubic_is_run_exactly_when_its_knot_velocities_are_given():
    t, fine = TIME * 1e-9, FINE * 1e-9
    cubic = np.polynomial.Polynomial([0.01, 0.2, -3.0, 40.0])
    run = Trajectory(TIME, np.c_[cubic(t), t, 0 * t], TOOL_DOWN, np.c_[cubic.deriv()(t), 1 + 0 * t, 0 * t])
    np.testing.assert_allclose(run.sample(FINE)[:, 0], cubic(fine), rtol=1e-14)
    np.testing.assert_allclose(run.sample_velocity(FINE)[:, 0], cubic.deriv()(fine), rtol=1e-12)


@pytest.mark.parametrize("ends", ["natural", "not-a-knot", "clamped"])
def test_a_spline_is_run_as_scipy_evaluates_it(ends):
    oracle = CubicSpline(TIME * 1e-9, PATH, bc_type=ends)
    run = spline(TIME, PATH, ends=ends)
    np.testing.assert_allclose(run.sample(FINE), oracle(FINE * 1e-9), atol=1e-16)
    np.testing.assert_allclose(run.feed(FINE), np.linalg.norm(oracle(FINE * 1e-9, 1), axis=1), rtol=1e-10, atol=1e-15)


def test_a_spline_takes_end_velocities():
    run = spline(TIME, PATH, ends=([0.1, 0.0, 0.0], [0.0, 0.2, 0.0]))
    np.testing.assert_allclose(run.velocity[[0, -1]], [[0.1, 0.0, 0.0], [0.0, 0.2, 0.0]], atol=1e-15)


def test_a_spline_has_no_jump_in_acceleration():
    run = spline(TIME, PATH)
    step = 10_000
    inner = TIME[1:-1]
    slope = [(run.sample_velocity(inner + d) - run.sample_velocity(inner + d - step)) / step for d in (0, step)]
    np.testing.assert_allclose(slope[0], slope[1], rtol=0, atol=2e-3 * np.abs(slope).max())


def test_orientation_follows_scipys_slerp_and_takes_the_short_way():
    turns = Rotation.from_euler("ZYX", np.random.default_rng(1).uniform(-1, 1, (5, 3)))
    quaternion = turns.as_quat() * np.array([1, -1, 1, 1, -1])[:, None]  # q and -q are one rotation
    run = Trajectory(TIME, PATH, quaternion)
    sampled = Rotation.from_quat(run.sample_orientation(FINE))
    assert (sampled.inv() * Slerp(TIME, turns)(FINE)).magnitude().max() < 1e-7


def test_a_constant_orientation_stays_the_same_to_the_last_bit():
    assert np.all(Trajectory(TIME, PATH, TOOL_DOWN).sample_orientation(FINE) == TOOL_DOWN)


def test_the_tool_rests_before_the_first_and_after_the_last_knot():
    run = spline(TIME, PATH)
    outside = np.array([-5, TIME[-1] + 1])
    np.testing.assert_array_equal(run.sample(outside), PATH[[0, -1]])
    assert np.all(run.feed(outside) == 0)


def test_the_papers_line_has_its_knots_at_the_controller_step_and_ends_exactly():
    line = Trajectory.straight_line([0.0, 0.01, 0.0], [2.0, 0.0, 0.0], 0.080, 4 / 60, 0.05)
    assert len(line) == 25 and line.duration_ns == 1_200_000_000
    np.testing.assert_array_equal(line.position[-1], [0.08, 0.01, 0.0])
    np.testing.assert_allclose(line.feed(FINE), 4 / 60, rtol=1e-12)


def test_a_line_that_is_no_multiple_of_the_step_keeps_its_feed_to_the_end():
    line = Trajectory.straight_line(np.zeros(3), [0.0, 1.0, 0.0], 0.081, 4 / 60, 0.05)
    assert line.duration_ns == 1_215_000_000 and np.all(np.diff(line.time_ns)[:-1] == 50_000_000)
    np.testing.assert_allclose(line.feed(line.time_ns), 4 / 60, rtol=1e-9)


def test_samples_take_the_shape_of_the_times():
    run = Trajectory(TIME, PATH, TOOL_DOWN)
    assert run.sample(7).shape == (3,) and run.sample(np.zeros((2, 5), int)).shape == (2, 5, 3)
    assert run.sample_orientation(np.zeros((2, 5), int)).shape == (2, 5, 4) and run.feed(7).shape == ()


def test_a_new_path_keeps_times_orientations_and_frame():
    run = Trajectory(TIME, PATH, TOOL_DOWN, frame="base_link").with_position(2 * PATH, PATH)
    assert run.frame == "base_link" and run.velocity is not None and run.time_ns[-1] == TIME[-1]


@pytest.mark.parametrize(
    ("change", "index"),
    [
        ({"time_ns": TIME + 1}, 0),
        ({"time_ns": np.array([0, 1, 1, 2, 3])}, 2),
        ({"time_ns": TIME * 1.0}, None),
        ({"time_ns": TIME[:1], "position": PATH[:1]}, None),
        ({"position": np.vstack([PATH[:3], np.full((2, 3), np.nan)])}, 3),
        ({"position": PATH[:4]}, None),
        ({"quaternion": np.diag([1.0, 1.0, 1.0, 0.0, 1.0])[:, :4]}, 3),
        ({"velocity": np.full((5, 3), np.inf)}, 0),
    ],
)
def test_a_trajectory_that_no_tool_can_follow_is_refused_with_its_knot(change, index):
    with pytest.raises(TrajectoryError) as caught:
        Trajectory(**({"time_ns": TIME, "position": PATH, "quaternion": TOOL_DOWN} | change))
    assert caught.value.index == index


def test_a_record_cannot_be_changed_afterwards():
    run = Trajectory(TIME, PATH, TOOL_DOWN)
    with pytest.raises(ValueError):
        run.position[0, 0] = 1.0


@pytest.mark.parametrize("value", [0.0, -1.0, np.nan])
def test_a_line_without_length_feed_or_step_is_refused(value):
    for arguments in ([value, 1.0, 1.0], [1.0, value, 1.0], [1.0, 1.0, value]):
        with pytest.raises(TrajectoryError):
            Trajectory.straight_line(np.zeros(3), [1.0, 0.0, 0.0], *arguments)
