"""Mass of rigid links against pinocchio, the parallel-axis theorem and the paper's beams."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from rigid_arm import rigid_arm

from kr270_milling.base.errors import ParameterError
from kr270_milling.base.record import find_file
from kr270_milling.physics.robot import (
    BARE,
    Mount,
    cartesian_mass,
    compliance,
    equilibrium,
    forward,
    joint_mass,
    mode_frequencies,
    rigid_joint_mass,
)
from kr270_milling.physics.robot.analysis import read_arm
from kr270_milling.physics.robot.mass import own_inertia, spatial_inertia
from kr270_milling.physics.robot.urdf import urdf

ARM = read_arm(find_file("kr270_2.yaml"))[0].replace(link_mass_centre=np.array([0.4, 0.3, 0.6, 0.45, 0.5, 0.7]))
MOUNT = Mount(
    xyz=np.array([0.3, 0.0, 0.1]), mass=60.0, mass_centre=np.array([0.1, 0.03, 0.02]), inertia=np.array([0.6, 0.5, 0.3])
)
PAPER = np.radians([90, -50, 120, 180, 25, 180])
POSTURES = np.random.default_rng(7).uniform(ARM.joint_lower, ARM.joint_upper, (50, 6))


def test_the_joint_space_mass_is_that_of_pinocchio():
    model = rigid_arm(ARM, MOUNT)
    data = model.createData()
    ours = rigid_joint_mass(ARM, MOUNT, POSTURES)
    for q, found in zip(POSTURES, ours, strict=True):
        upper = np.triu(pin.crba(model, data, q))
        np.testing.assert_allclose(found, upper + np.triu(upper, 1).T, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("mount", [MOUNT, BARE])
def test_the_urdf_has_the_same_joint_space_mass(mount):
    """pinocchio reads the text and computes the mass that the joints carry, by ``mass_model: rigid`` within 1e-9."""
    model = pin.buildModelFromXML(urdf(ARM, mount))
    data = model.createData()
    assert pin.computeTotalMass(model) == pytest.approx(ARM.link_mass.sum() + mount.mass, rel=1e-12)
    for q, ours in zip(POSTURES, rigid_joint_mass(ARM, mount, POSTURES), strict=True):
        upper = np.triu(pin.crba(model, data, q))
        np.testing.assert_allclose(upper + np.triu(upper, 1).T, ours, rtol=1e-9, atol=1e-9)


def test_the_cartesian_mass_holds_the_same_energy():
    """qdot M_theta qdot = V M_C V for V = J qdot."""
    solved = equilibrium(ARM, MOUNT, PAPER)
    speeds = np.random.default_rng(8).normal(size=(20, 6))
    at_tool = speeds @ solved.jacobian.T
    of_joints = np.einsum("ni,ij,nj->n", speeds, rigid_joint_mass(ARM, MOUNT, solved.posture), speeds)
    of_tool = np.einsum("ni,ij,nj->n", at_tool, cartesian_mass(ARM, MOUNT, solved.posture, "rigid"), at_tool)
    np.testing.assert_allclose(of_tool, of_joints, rtol=1e-9)


def test_a_translated_body_has_its_mass_and_a_turned_one_follows_the_parallel_axis_theorem():
    centre, own = np.array([0.3, -0.2, 0.5]), np.diag([0.2, 0.3, 0.4])
    body = spatial_inertia(7.0, centre, own)
    np.testing.assert_allclose(body[:3, :3], 7.0 * np.eye(3))
    assert body[5, 5] == pytest.approx(0.4 + 7.0 * (0.3**2 + 0.2**2))
    np.testing.assert_allclose(body, pin.Inertia(7.0, centre, own).matrix(), atol=1e-15)
    np.testing.assert_array_equal(body, body.T)


def test_a_link_without_length_is_a_point():
    assert not own_inertia(ARM, 4).any()
    assert own_inertia(ARM, 3)[0, 0] == pytest.approx(54.5 * 0.12**2)


def test_the_paper_s_beams_hold_so_much_of_the_inertia_of_rigid_links():
    """[derived] diagonal of M_theta at the paper's posture: 0.96, 0.90, 0.99, 0.45, 1.00, 0.33."""
    arm = ARM.replace(link_mass_centre=np.full(6, 0.5))
    share = np.diag(joint_mass(arm, BARE, PAPER)) / np.diag(rigid_joint_mass(arm, BARE, PAPER))
    np.testing.assert_allclose(share, [0.96, 0.90, 0.99, 0.45, 1.00, 0.33], atol=0.005)


def test_the_first_modes_are_those_derived_for_rigid_links():
    """[derived] 13.5, 20.3, 32.6, 121 Hz at the paper's posture."""
    arm = ARM.replace(link_mass_centre=np.full(6, 0.5))
    solved = equilibrium(arm, BARE, PAPER)
    found = mode_frequencies(compliance(solved, arm), cartesian_mass(arm, BARE, solved.posture, "rigid"))
    np.testing.assert_allclose(found[:3], [13.5, 20.3, 32.6], rtol=5e-3)
    assert found[3] == pytest.approx(121.0, rel=0.01)  # 121.5 for the other arm


def test_rotary_inertia_of_the_spindle_counts_about_the_joint_that_turns_it():
    without = MOUNT.replace(inertia=np.zeros(3))
    added = rigid_joint_mass(ARM, MOUNT, PAPER) - rigid_joint_mass(ARM, without, PAPER)
    axis = forward(ARM, MOUNT, PAPER).rotations[5].T @ forward(ARM, MOUNT, PAPER).axes[5]
    assert added[5, 5] == pytest.approx(axis @ np.diag(MOUNT.inertia) @ axis)
    assert np.trace(added) > 3 * added[5, 5]


def test_moments_of_inertia_that_no_body_has_are_refused():
    with pytest.raises(ParameterError, match="none is larger than the others' sum"):
        Mount(inertia=np.array([1.0, 0.2, 0.2]))


def test_batches_give_what_single_postures_give():
    for q, found in zip(POSTURES[:3], rigid_joint_mass(ARM, MOUNT, POSTURES[:3]), strict=True):
        np.testing.assert_allclose(rigid_joint_mass(ARM, MOUNT, q), found, rtol=1e-13, atol=1e-12)
