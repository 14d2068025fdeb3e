"""Beam mass matrices, their reduction to the tool, natural frequencies."""

import numpy as np
import pinocchio as pin
import pytest

from kr270_milling.base.errors import ParameterError
from kr270_milling.base.record import find_file
from kr270_milling.physics.robot import (
    BARE,
    Mount,
    beam_mass,
    cartesian_mass,
    compliance,
    equilibrium,
    forward,
    jacobian,
    joint_mass,
    mode_frequencies,
    stiffness,
)  # fmt: skip
from kr270_milling.physics.robot.analysis import read_arm
from kr270_milling.physics.robot.errors import SingularityError
from kr270_milling.physics.robot.mass import assembled_mass

ARM, _ = read_arm(find_file("kr270_2.yaml"))
MOUNT = Mount(xyz=np.array([0.3, 0.0, 0.1]), mass=60.0, mass_centre=np.array([0.1, 0.03, 0.02]))
PAPER = np.radians([90, -50, 120, 180, 25, 180])
MASS, LENGTH, RHO_I = 7.0, 1.7, (0.9, 0.4, 0.6)
BEAM = beam_mass(MASS, LENGTH, *RHO_I)


def rigid(x):
    """Motion of a point at (x, 0, 0) from that of the origin, right-handed: v + omega x r."""
    move = np.eye(6)
    move[:3, 3:] = [[0, 0, 0], [0, 0, x], [0, -x, 0]]
    return move


def test_the_beam_matrix_is_the_integral_of_the_kinetic_energy():  # (18)-(22), 4 Gauss points are exact to x^7
    points, weights = np.polynomial.legendre.leggauss(4)
    integral, inertia = np.zeros((12, 12)), np.diag([MASS / LENGTH] * 3 + list(RHO_I))
    for x, weight in zip(LENGTH * (points + 1) / 2, weights * LENGTH / 2, strict=True):
        s = x / LENGTH
        shape = np.diag([s, *[s**2 * (3 - s) / 2] * 2, s, *[2 * s - s**2] * 2])
        motion = np.hstack([rigid(x) - shape @ rigid(LENGTH), shape])
        integral += weight * motion.T @ inertia @ motion
    np.testing.assert_allclose(BEAM, integral, atol=1e-14)


def test_a_translated_beam_has_its_mass_and_a_turned_one_its_moment_of_inertia():
    for axis in range(3):
        assert np.tile(np.eye(6)[axis], 2) @ BEAM @ np.tile(np.eye(6)[axis], 2) == pytest.approx(MASS)
    for axis, own in ((4, RHO_I[1]), (5, RHO_I[2])):
        motion = np.concatenate([np.eye(6)[axis], rigid(LENGTH)[:, axis]])
        assert motion @ BEAM @ motion == pytest.approx(MASS * LENGTH**2 / 3 + own * LENGTH)


def test_the_beam_matrix_is_symmetric_and_has_positive_energy():
    np.testing.assert_array_equal(BEAM, BEAM.T)
    assert np.linalg.eigvalsh(BEAM)[0] > 0


def test_the_assembled_arm_translated_as_a_whole_has_all_the_mass():
    total = assembled_mass(ARM, MOUNT, forward(ARM, MOUNT, PAPER))
    for axis in range(3):
        motion = np.tile(np.eye(6)[axis], 7)
        assert motion @ total @ motion == pytest.approx(790.4 + 60.0)


def test_an_arm_turned_by_axis_1_has_the_rigid_inertia_of_what_rides_on_it():
    """Link 1 bends with joint 1 in the beam's shape, so it is left out; the others are slender tubes in pinocchio."""
    arm = ARM.replace(link_mass=ARM.link_mass * [0, 1, 1, 1, 1, 1])
    q = np.array([0.3, -0.9, 1.4, 0.6, 0.8, -0.2])
    frames, total = forward(arm, MOUNT, q), np.zeros((3, 3))
    for j in range(1, 6):
        start, end = frames.nodes[j], frames.nodes[j + 1]
        length, mass, radius = np.linalg.norm(end - start), arm.link_mass[j], arm.link_section_radius[j]
        along = (end - start) / length if length else np.zeros(3)
        tube = mass * radius**2 * bool(length)  # a link without length is a point
        own = (mass * length**2 / 12 + tube / 2) * (np.eye(3) - np.outer(along, along)) + tube * np.outer(along, along)
        total += pin.Inertia(mass, (start + end) / 2, own * bool(length)).matrix()[3:, 3:]
    total += pin.Inertia(60.0, frames.mass_centre, np.zeros((3, 3))).matrix()[3:, 3:]
    assert joint_mass(arm, MOUNT, q)[0, 0] == pytest.approx(total[2, 2])


def test_a_rider_alone_is_the_joint_inertia_of_its_point_mass():
    arm = ARM.replace(link_mass=np.zeros(6))
    at_mass = jacobian(arm, Mount(xyz=MOUNT.mass_centre), PAPER)[:3]
    np.testing.assert_allclose(joint_mass(arm, MOUNT, PAPER), 60.0 * at_mass.T @ at_mass, atol=1e-12)


def test_the_energy_consistent_mass_is_the_sum_over_the_links_with_the_loaded_springs():  # (25) in the form of facts.md
    solved = equilibrium(ARM, MOUNT, PAPER, [300.0, -200.0, 100.0, 20.0, 0, 10.0])
    springs = np.diag(ARM.joint_stiffness) - solved.hessian
    follow = np.linalg.solve(springs, solved.jacobian.T) @ stiffness(solved, ARM)
    frames, total = forward(ARM, MOUNT, solved.posture), np.zeros((6, 6))
    whole = assembled_mass(ARM, MOUNT, frames)
    phi = np.concatenate([jacobian(ARM, MOUNT, solved.posture, j) @ follow for j in range(7)])
    total = phi.T @ whole @ phi
    ours = cartesian_mass(ARM, MOUNT, solved.posture, "consistent")
    np.testing.assert_allclose(ours, total, rtol=1e-9, atol=1e-7)
    assert np.linalg.eigvalsh(ours)[0] > 0


def test_lumped_mass_reproduces_the_low_frequency_of_the_paper():
    soft = compliance(equilibrium(ARM, BARE, PAPER, gravity=False), ARM)
    found = mode_frequencies(soft, cartesian_mass(ARM, BARE, PAPER, "lumped"))
    assert len(found) == 3  # rotations carry no mass and follow
    assert found[0] == pytest.approx(np.sqrt(1 / (0.7168e-6 * 790.4)) / (2 * np.pi), rel=1e-4)
    assert found[0] == pytest.approx(6.70, rel=0.01)  # paper, Table 2


def test_the_consistent_first_mode_is_twice_as_fast():
    soft = compliance(equilibrium(ARM, BARE, PAPER, gravity=False), ARM)
    found = mode_frequencies(soft, cartesian_mass(ARM, BARE, PAPER, "consistent"))
    assert len(found) == 6 and np.all(np.diff(found) > 0)
    assert 11 < found[0] < 14  # [derived], facts.md


def test_tool_mass_lowers_every_mode():
    soft = compliance(equilibrium(ARM, MOUNT, PAPER, gravity=False), ARM)
    light, heavy = (Mount(xyz=MOUNT.xyz, mass=m, mass_centre=MOUNT.mass_centre) for m in (0.0, 100.0))
    for model in ("lumped", "consistent"):
        slow, fast = (mode_frequencies(soft, cartesian_mass(ARM, mount, PAPER, model)) for mount in (heavy, light))
        assert np.all(slow <= fast * (1 + 1e-9)) and slow[0] < fast[0] * 0.99


def test_frequencies_of_two_masses_on_springs_follow_the_closed_form_and_a_massless_one_is_condensed():
    stiffness_matrix = np.array([[3.0, -1.0], [-1.0, 3.0]])  # eigenvalues 2 and 4 with unit masses
    soft = np.linalg.inv(stiffness_matrix)
    np.testing.assert_allclose(mode_frequencies(soft, np.eye(2)), np.sqrt([2, 4]) / (2 * np.pi))
    np.testing.assert_allclose(mode_frequencies(soft, np.diag([1.0, 0])), [np.sqrt(3 - 1 / 3) / (2 * np.pi)])
    assert mode_frequencies(soft, np.zeros((2, 2))).size == 0


def test_joint_and_tool_forms_have_the_same_frequencies():
    solved = equilibrium(ARM, MOUNT, PAPER)
    at_tool = mode_frequencies(compliance(solved, ARM), cartesian_mass(ARM, MOUNT, solved.posture, "consistent"))
    springs = np.diag(ARM.joint_stiffness) - solved.hessian
    at_joints = mode_frequencies(np.linalg.inv(springs), joint_mass(ARM, MOUNT, solved.posture))
    np.testing.assert_allclose(at_tool, at_joints, rtol=1e-9)


def test_batches_give_what_single_postures_give():
    batch = np.stack([PAPER, PAPER + 0.1])
    both = cartesian_mass(ARM, MOUNT, batch, "consistent")
    np.testing.assert_allclose(both[1], cartesian_mass(ARM, MOUNT, batch[1], "consistent"), rtol=1e-12)
    assert cartesian_mass(ARM, MOUNT, batch).shape == (2, 6, 6)


def test_an_unknown_model_and_a_singular_posture_are_refused():
    with pytest.raises(ParameterError, match="lumped, consistent"):
        cartesian_mass(ARM, MOUNT, PAPER, "heavy")
    with pytest.raises(SingularityError):
        cartesian_mass(ARM, MOUNT, PAPER * [1, 1, 1, 1, 0, 1], "consistent")
