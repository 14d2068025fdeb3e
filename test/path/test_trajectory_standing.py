"""Where a tool stands still: one answer for the correction, the robot program and the check of its corners."""

from __future__ import annotations

import numpy as np
import pytest

from kr270_milling.decide.path_limits import corner_blending
from kr270_milling.decide.programs.krl import Program
from kr270_milling.decide.programs.krl_motion import point_numbers
from kr270_milling.path.trajectory import AT_REST, TOOL_DOWN, Trajectory
from kr270_milling.path.trajectory_csv import read_csv, write_csv
from kr270_milling.physics.compensation.revision import corrected, resting_segments

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


def sharp(rest_speed: float) -> Trajectory:
    """The same corner without the rest: one knot of it, and no segment without length."""
    run = corner(rest_speed)
    kept = np.delete(np.arange(12), 6)
    return Trajectory(np.arange(11) * 12_000_000, run.position[kept], TOOL_DOWN, run.velocity[kept])


def moved(run: Trajectory) -> Trajectory:
    """Corrected by 50 um, less than the 88 um by which a blended corner of these legs would be rounded off."""
    return run.with_position(run.position + [0.0, 0.0, 50e-6], run.velocity)


@pytest.mark.parametrize("speed", [0.0, 1e-12, 3e-9, 0.9 * AT_REST])
def test_a_stop_is_one_for_correction_program_and_check_whatever_rounding_left_of_its_speed(speed):
    """A reference that came back from a file or a message whose stop is no exact zero any more."""
    run = corner(speed)
    assert np.flatnonzero(run.standing).tolist() == [0, 5, 6, 11]
    assert np.flatnonzero(resting_segments(run)).tolist() == [5]
    shift = np.outer(np.linspace(0.0, 50e-6, 12), [0.0, 1.0, 0.0])
    revised, _ = corrected(run, shift, True)
    assert np.ptp(revised.position[5:7], axis=0).max() == 0.0  # the correction is held
    points = point_numbers(Program(point_spacing=0.6e-3), run, revised)
    assert STOP in points or STOP + 1 in points  # though it is nearer to the point before than others may be
    assert corner_blending(sharp(speed), moved(sharp(speed)), 1e-3) == []  # the robot stops: nothing is rounded off


def test_what_creeps_does_not_stand():
    run = corner(2 * AT_REST)
    assert not run.standing.any() and not resting_segments(run).any()
    rounded = corner_blending(sharp(2 * AT_REST), moved(sharp(2 * AT_REST)), 1e-3)
    assert [violation.point for violation in rounded] == [STOP + 1]


def test_a_reference_that_came_back_from_a_file_stands_where_it_stood(tmp_path):
    run = corner(1e-12)
    write_csv(tmp_path / "run.csv", run)
    assert np.array_equal(read_csv(tmp_path / "run.csv")[0].standing, run.standing)


def test_straight_lines_through_the_knots_never_stand():
    run = corner()
    assert not run.with_position(run.position).standing.any()
