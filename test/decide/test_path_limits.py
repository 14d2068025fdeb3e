"""Checks of a corrected path."""

from __future__ import annotations

import numpy as np
import pytest

from kr270_milling.decide.findings import violations
from kr270_milling.decide.path_limits import (
    corner_blending,
    correction_per_tick,
    correction_size,
    joint_rate_violations,
)
from kr270_milling.path.trajectory import TOOL_DOWN, Trajectory

LINE = Trajectory.straight_line(np.zeros(3), [1.0, 0.0, 0.0], 0.08, 4 / 60, 0.05)
TICK = 4_000_000  # [ns]


def shifted(lateral) -> Trajectory:
    return LINE.with_position(LINE.position + np.asarray(lateral)[:, None] * [0.0, 1.0, 0.0])


def test_neighbours_that_exceed_make_one_finding_named_by_the_worst():
    first, second = violations("spindle torque", np.array([0, 2, 3, 2, 0, 1.5, 1.0]), 1.0)
    assert (first.point, first.value, first.limit, first.severity) == (3, 3.0, 1.0, "stop")
    assert "points 2 to 4" in first.sentence and "3 N m at point 3" in first.sentence
    assert second.point == 6 and "(point 6)" in second.sentence


def test_what_is_not_a_number_is_a_finding_and_what_equals_the_limit_is_none():
    assert violations("spindle torque", np.array([0.0, np.nan]), 1.0)[0].point == 2
    assert violations("spindle torque", np.array([1.0, 1.0]), 1.0) == []


def test_a_large_correction_is_found_at_its_point():
    lateral = np.zeros(25)
    lateral[7] = 1.2e-3
    (finding,) = correction_size(LINE, shifted(lateral), TICK, 1e-3)
    assert finding.point == 8 and finding.value == pytest.approx(1.2e-3) and "1.2 mm" in finding.sentence
    assert correction_size(LINE, shifted(lateral), TICK, 1.3e-3) == []


def test_a_step_of_the_correction_is_shared_by_the_ticks_of_its_interval():
    lateral = np.where(np.arange(25) >= 10, 1e-4, 0.0)
    revised = shifted(lateral)  # 100 um within 50 ms: 8 um in each tick of 4 ms
    (finding,) = correction_per_tick(LINE, revised, 4_000_000, 7.9e-6)
    assert finding.point == 11 and finding.value == pytest.approx(8e-6)
    assert correction_per_tick(LINE, revised, 4_000_000, 8.1e-6) == []


def corner(stop: bool) -> tuple[Trajectory, Trajectory]:
    """10 mm along x, then 10 mm along y; the corner is corrected by 50 um."""
    position = np.array([[0, 0, 0], [0.01, 0, 0], [0.01, 0.01, 0]])
    velocity = np.array([[0, 0, 0], [0, 0, 0] if stop else [0.05, 0.05, 0], [0, 0, 0]])
    original = Trajectory(np.array([0, 10**8, 2 * 10**8]), position, TOOL_DOWN, velocity)
    return original, original.with_position(position + [[0, 0, 0], [5e-5, 0, 0], [0, 0, 0]])


def test_blending_rounds_a_corner_as_a_parabola_does():
    original, revised = corner(stop=False)
    (finding,) = corner_blending(original, revised, 1e-3)
    control = np.array([[-1e-3, 0], [0, 0], [0, 1e-3]])  # legs of 1 mm about a right angle
    u = np.linspace(0, 1, 2001)[:, None]
    parabola = (1 - u) ** 2 * control[0] + 2 * u * (1 - u) * control[1] + u**2 * control[2]
    missed = np.hypot(*parabola.T).min()
    assert finding.point == 2 and finding.value == pytest.approx(missed / 5e-5, rel=1e-2)
    assert finding.severity == "warning"


def test_no_blending_where_the_tool_stops_or_the_distance_is_nothing():
    assert corner_blending(*corner(stop=True), 1e-3) == []
    assert corner_blending(*corner(stop=False), 0.0) == []


def test_joint_speeds_and_accelerations_are_found_by_axis_and_point():
    time, none = np.arange(5) * 0.1, np.full(6, np.inf)
    joints = np.zeros((5, 6))
    joints[:, 2] = [0, 0, 0.2, 0.2, 0.2]  # 2 rad/s between points 2 and 3, 20 rad/s^2 at both
    (fast,) = joint_rate_violations(time, joints, np.full(6, 1.9), none)
    assert fast.point == 3 and "axis 3" in fast.sentence and fast.value == pytest.approx(2.0)
    (hard,) = joint_rate_violations(time, joints, none, np.full(6, 19.0), at_rest=False)
    assert hard.point in (2, 3) and hard.value == pytest.approx(20.0)
    assert joint_rate_violations(time, joints, np.full(6, 2.1), none) == []
