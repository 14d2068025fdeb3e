"""Slowing down for the joints."""

from __future__ import annotations

import numpy as np
import pytest

from kr270_milling.path.timing import joint_rates, limit_by_joints
from kr270_milling.path.trajectory import TOOL_DOWN, Trajectory, TrajectoryError

SPEED, ACCELERATION = np.full(6, 1.0), np.full(6, 8.0)


def motion(joints: np.ndarray, velocity=None) -> Trajectory:
    """Any tool path with as many knots, 50 ms apart; the joints need not belong to it."""
    count = len(joints)
    line = np.linspace(0, 1, count)[:, None] * [1.0, 0.0, 0.0]
    return Trajectory(np.arange(count) * 50_000_000, line, TOOL_DOWN, velocity)


def within_limits(run: Trajectory, joints) -> bool:
    speed, acceleration = joint_rates(run.time, joints, at_rest=False)
    return bool(
        np.all(np.abs(speed) <= SPEED * (1 + 1e-9)) and np.all(np.abs(acceleration) <= ACCELERATION * (1 + 1e-6))
    )


def test_rates_of_a_parabola_are_exact():
    time = np.array([0.0, 0.1, 0.3, 0.35])
    speed, acceleration = joint_rates(time, np.tile((2 * time**2 + time)[:, None], 6), at_rest=False)
    np.testing.assert_allclose(speed[:, 0], 2 * (time[1:] + time[:-1]) + 1)
    np.testing.assert_allclose(acceleration[1:-1], 4.0)


def test_a_start_from_rest_counts_as_acceleration():
    time = np.array([0.0, 0.1, 0.2])
    _, acceleration = joint_rates(time, np.tile(1.5 * time[:, None] ** 2, 6), at_rest=True)
    np.testing.assert_allclose(acceleration[:2], 3.0)


def test_a_trajectory_within_its_limits_stays_as_it_is():
    joints = np.tile(np.linspace(0, 0.5, 21)[:, None], 6)
    run = motion(joints)
    assert limit_by_joints(run, joints, SPEED, ACCELERATION) is run


def test_an_even_motion_too_fast_by_a_factor_takes_longer_by_that_factor():
    joints = np.zeros((21, 6))
    joints[:, 3] = np.linspace(0, 3.0, 21)  # 3 rad/s
    run = limit_by_joints(motion(joints), joints, SPEED, ACCELERATION)
    assert run.duration_ns == pytest.approx(3 * 10**9, rel=1e-6)


def test_only_the_steps_about_a_violation_grow():
    joints = np.zeros((81, 6))
    joints[:, 0] = 0.2 * np.tanh(np.linspace(-20, 20, 81) * 2)
    run = limit_by_joints(motion(joints), joints, SPEED, ACCELERATION)
    step = np.diff(run.time_ns)
    assert within_limits(run, joints) and step.max() > 60_000_000
    assert np.all(step[:25] == 50_000_000) and np.all(step[-25:] == 50_000_000)


@pytest.mark.parametrize("seed", range(5))
def test_rough_motions_end_up_within_all_limits_and_no_step_gets_shorter(seed):
    joints = np.cumsum(np.random.default_rng(seed).normal(0, 0.05, (200, 6)), axis=0)
    run = limit_by_joints(motion(joints), joints, SPEED, ACCELERATION)
    assert within_limits(run, joints)
    assert np.all(np.diff(run.time_ns) >= 50_000_000)
    np.testing.assert_array_equal(run.position, motion(joints).position)


def test_half_the_limits_never_make_it_faster():
    joints = np.cumsum(np.random.default_rng(9).normal(0, 0.05, (50, 6)), axis=0)
    durations = [limit_by_joints(motion(joints), joints, SPEED / n, ACCELERATION / n**2).duration_ns for n in (1, 2, 4)]
    assert durations[0] <= durations[1] <= durations[2]


def test_knot_velocities_slow_down_with_the_clock():
    joints = np.zeros((21, 6))
    joints[:, 3] = np.linspace(0, 3.0, 21)
    velocity = np.tile([1.0, 0, 0], (21, 1))
    run = limit_by_joints(motion(joints, velocity), joints, SPEED, ACCELERATION)
    np.testing.assert_allclose(run.velocity[:, 0], 1 / 3, rtol=1e-6)


def test_joints_that_do_not_fit_or_limits_of_nothing_are_refused():
    joints = np.zeros((21, 6))
    for arguments in ((joints[:20], SPEED), (np.full((21, 6), np.nan), SPEED), (joints, 0 * SPEED)):
        with pytest.raises(TrajectoryError):
            limit_by_joints(motion(joints), *arguments, ACCELERATION)
