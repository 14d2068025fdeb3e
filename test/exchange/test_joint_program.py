"""The joint program against the spline that ros2_controllers documents between its points, and its safe start."""

import numpy as np
import pytest
from scipy.interpolate import BPoly
from scipy.spatial.transform import Rotation

from kr270_milling.base.errors import ModelError
from kr270_milling.base.parameter_file import find_file
from kr270_milling.base.samples import JointProgram
from kr270_milling.cell.arm import commanded_joints
from kr270_milling.cell.cell import Cell
from kr270_milling.cell.cell_file import read_cell
from kr270_milling.cell.jobs import compensated, simulate
from kr270_milling.cell.models import arm_of, path_of
from kr270_milling.exchange.compensator import joint_program
from kr270_milling.path.trajectory import Trajectory
from kr270_milling.physics.robot.kinematics import pose


def commanded(cell, reference):
    return commanded_joints(arm_of(cell), cell.compensation, reference)


def program_of(cell, *args):
    return joint_program(arm_of(cell), cell.compensation, cell.joint_names, *args)


@pytest.fixture(scope="module")
def cell() -> Cell:
    return read_cell(find_file("paper.yaml"))


@pytest.fixture(scope="module")
def revised(cell):
    """The reference of a method; computed once."""
    first, known = simulate(cell), {}
    return lambda method: known.setdefault(method, compensated(cell, first, method).reference)


def sampled(program: JointProgram, time_ns: np.ndarray, derivatives: int) -> np.ndarray:
    """Joints (m, 6) between two points as the documented controller joins them: positions: a line, velocities: a cubic,
    accelerations: a quintic; by the derivatives that both points have, at most so many."""
    rows = (program.position, program.velocity, program.acceleration)[: derivatives + 1]
    joined = []
    for at in time_ns.tolist():
        k = int(np.searchsorted(program.time, at, side="right")) - 1
        ends = [row[k : k + 2] for row in rows if np.isfinite(row[k : k + 2]).all()]
        step = (program.time[k + 1] - program.time[k]) * 1e-9
        spline = BPoly.from_derivatives([0.0, step], np.stack(ends, axis=1))
        joined.append(spline((at - program.time[k]) * 1e-9))
    return np.array(joined)


def distance(cell: Cell, program: JointProgram, reference: Trajectory, derivatives: int) -> float:
    """[m], largest, from the planned motion, in the middle between two knots of the pass."""
    begin = program.time[np.argmin(np.linalg.norm(program.position - commanded(cell, reference)[0], axis=1))]
    middle = (reference.time_ns[1:] + reference.time_ns[:-1]) // 2
    planned = Trajectory(
        np.append(0, middle),
        reference.sample(np.append(0, middle)),
        reference.sample_orientation(np.append(0, middle)),
    )
    wanted = pose(cell.arm, cell.mount, commanded(cell, planned)[1:]).position
    tip = pose(cell.arm, cell.mount, sampled(program, begin + middle, derivatives)).position
    return float(np.linalg.norm(tip - wanted, axis=1).max())


@pytest.mark.parametrize("method", ["spline", "learned", "inverse"])
def test_the_documented_quintic_runs_the_planned_spline_and_a_linear_joining_does_not(cell, revised, method):
    """The quintic's rest is h^6/46080 of the sixth derivative; a line cuts the correction's curve off, h^2/8 of x''."""
    reference = revised(method)
    program = program_of(cell, reference, arm_of(cell).posture, 0)
    assert distance(cell, program, reference, 2) < 1e-10
    assert distance(cell, program, reference, 0) > 5e-6


def test_velocities_fit_a_path_that_turns_the_tool_and_fights_the_sag(cell):
    """A quarter of a turn of 20 mm radius with the tool's x axis along the feed, at rest at both ends."""
    sagging = cell.replace(compensation=cell.compensation.replace(sag_compensated=False))
    u = np.linspace(0.0, 1.0, 41)
    angle, rate = 0.5 * np.pi * u**2 * (3 - 2 * u), 0.5 * np.pi * 6 * u * (1 - u)  # in 1 s
    zero = np.zeros(u.size)
    at = 0.02 * np.stack([np.sin(angle), 1 - np.cos(angle), zero], axis=1)
    along = np.stack([np.cos(angle), np.sin(angle), zero], axis=1)
    turned = Rotation.from_rotvec(angle[:, None] * [0.0, 0.0, 1.0]) * Rotation.from_quat([1.0, 0.0, 0.0, 0.0])
    reference = Trajectory((u * 1e9).astype(np.int64), at, turned.as_quat(), 0.02 * rate[:, None] * along)
    program = program_of(sagging, reference, arm_of(cell).posture, 0)
    assert distance(sagging, program, reference, 2) < 1e-8


def test_a_corner_has_a_position_only_and_a_straight_line_has_one_velocity(cell, revised):
    corners = program_of(cell, revised("linear"), arm_of(cell).posture, 0)
    straight = program_of(cell, path_of(cell).target, arm_of(cell).posture, 0)
    assert np.isnan(corners.velocity[3:-3]).all(axis=1).any() and np.isfinite(straight.velocity).all()
    assert distance(cell, straight, path_of(cell).target, 2) < 1e-12


def test_the_program_starts_at_rest_where_the_robot_stands_and_keeps_to_a_tenth_of_the_limits(cell, revised):
    reference, stands = revised("spline"), arm_of(cell).posture + np.radians([20.0, -5.0, 3.0, 40.0, -8.0, 90.0])
    program = program_of(cell, reference, stands, 123)
    assert program.stamp == 123 and np.array_equal(program.position[0], stands) and program.time[0] == 0
    assert not program.velocity[[0, 1, -1]].any() and not program.acceleration[[0, 1, -1]].any()
    (begin,) = np.flatnonzero((program.position == commanded(cell, reference)[0]).all(axis=1))
    np.testing.assert_array_equal(program.time[begin:-1] - program.time[begin], reference.time_ns)
    times = np.linspace(0, program.time[begin] - 1, 2001).astype(np.int64)
    joints, seconds = sampled(program, times, 2), times * 1e-9
    approach = times < program.time[1]
    away = (joints[approach] - stands) / (program.position[1] - stands)
    assert np.ptp(away, axis=1).max() < 1e-9  # all joints in proportion
    speed = np.abs(np.gradient(joints, seconds, axis=0))
    assert np.all(speed[approach] <= 0.1001 * cell.arm.joint_speed_limit)
    change = np.abs(np.gradient(np.gradient(joints, seconds, axis=0), seconds, axis=0))[2:-2]
    assert np.all(change <= 0.102 * cell.arm.joint_acceleration_limit)
    run_in = pose(cell.arm, cell.mount, joints[~approach]).position
    planned = cell.workpiece.pose.apply(reference.position[0])
    away = np.linalg.norm(run_in - planned, axis=1)
    half = 0.5 * reference.feed(0) * (program.time[begin] - program.time[1]) * 1e-9  # [m], of a speed that grows evenly
    assert away.max() == pytest.approx(half, rel=0.01) and np.all(np.diff(away) < 1e-9)  # and no overshoot


def test_a_joint_that_would_be_too_fast_is_named(cell):
    slow = cell.replace(arm=cell.arm.replace(joint_speed_limit=np.full(6, 1e-3)))
    with pytest.raises(ModelError, match=r"the speed of joint_\d would be .* deg/s at point \d+, but must be"):
        program_of(slow, path_of(cell).target, arm_of(cell).posture, 0)
