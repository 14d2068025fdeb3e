"""Torques of loads and their derivatives against pinocchio and finite differences."""

import numpy as np
import pinocchio as pin
import pytest

from kr270_milling.base.record import find_file
from kr270_milling.physics.robot import Mount, forward, jacobian, link_loads
from kr270_milling.physics.robot.analysis import read_arm
from kr270_milling.physics.robot.loads import load_hessian, load_torque

RNG = np.random.default_rng(11)
ARM = read_arm(find_file("kr270_2.yaml"))[0].replace(link_mass_centre=np.array([0.5, 0.4, 0.7, 0.3, 0.5, 0.9]))
MOUNT = Mount(xyz=np.array([0.31, -0.04, 0.12]), mass=41.0, mass_centre=np.array([0.15, 0.02, -0.03]))
POSTURES = RNG.uniform(ARM.joint_lower, ARM.joint_upper, (100, 6))
WRENCHES = RNG.normal(size=(100, 6)) * [900, 900, 900, 200, 200, 200]


def oracle():
    """Point masses on the links' own lines in pinocchio, spindle and tool on the last link."""
    model, parent, at = pin.Model(), 0, np.zeros(3)
    axes = [(0, 0, -1), (0, 1, 0), (0, 1, 0), (-1, 0, 0), (0, 1, 0), (-1, 0, 0)]
    ends = [(ARM.a1, 0, ARM.d1), (ARM.a2, 0, 0), (0, 0, ARM.a3), (ARM.d4, 0, 0), (0, 0, 0), (ARM.d6, 0, 0)]
    for j, (axis, end) in enumerate(zip(axes, ends, strict=True)):
        joint = pin.JointModelRevoluteUnaligned(np.array(axis, float))
        parent = model.addJoint(parent, joint, pin.SE3(np.eye(3), at), f"j{j}")
        at = np.array(end, float)
        inertia = pin.Inertia(ARM.link_mass[j], ARM.link_mass_centre[j] * at, np.zeros((3, 3)))
        model.appendBodyToJoint(parent, inertia, pin.SE3.Identity())
    rider = pin.Inertia(MOUNT.mass, at + MOUNT.mass_centre, np.zeros((3, 3)))
    model.appendBodyToJoint(parent, rider, pin.SE3.Identity())
    model.gravity.linear = np.array([0, 0, -9.80665])
    return model


def test_the_weights_pull_as_pinocchio_says_at_100_random_postures():
    model = oracle()
    data, loads = model.createData(), link_loads(ARM, MOUNT)
    ours = load_torque(forward(ARM, MOUNT, POSTURES), np.zeros((100, 6)), loads)
    bent = load_hessian(forward(ARM, MOUNT, POSTURES), np.zeros((100, 6)), loads)
    for i, q in enumerate(POSTURES):
        motors = pin.computeGeneralizedGravity(model, data, q)  # what holds the arm up
        np.testing.assert_allclose(ours[i], -motors, atol=1e-9)
        np.testing.assert_allclose(bent[i], -pin.computeGeneralizedGravityDerivatives(model, data, q), atol=1e-9)


def test_split_weights_keep_their_sum_and_switch_off():
    loads = link_loads(ARM, MOUNT)
    np.testing.assert_allclose(loads.forces.sum(0), [0, 0, -9.80665 * (790.4 + 41.0)])
    assert not link_loads(ARM, MOUNT, 0.0).forces.any()


def test_node_jacobians_times_split_weights_give_the_same_torque():  # (5), (6) written out
    loads, torque = link_loads(ARM, MOUNT), np.zeros((100, 6))
    for j in range(7):
        torque += np.einsum("nij,i->nj", jacobian(ARM, MOUNT, POSTURES, j)[:, :3], loads.forces[j])
    at_mass = Mount(xyz=MOUNT.mass_centre)
    torque += np.einsum("nij,i->nj", jacobian(ARM, at_mass, POSTURES)[:, :3], loads.forces[7])
    np.testing.assert_allclose(load_torque(forward(ARM, MOUNT, POSTURES), np.zeros((100, 6)), loads), torque, atol=1e-9)


@pytest.mark.parametrize("gravity", [0.0, 9.80665])
def test_the_hessian_is_the_difference_quotient_of_the_torque_for_forces_and_moments(gravity):
    loads, step = link_loads(ARM, MOUNT, gravity), 1e-5
    bent = load_hessian(forward(ARM, MOUNT, POSTURES), WRENCHES, loads)
    for k in range(6):
        ahead, behind = (
            load_torque(forward(ARM, MOUNT, POSTURES + s * step * np.eye(6)[k]), WRENCHES, loads) for s in (1, -1)
        )
        np.testing.assert_allclose(bent[:, :, k], (ahead - behind) / (2 * step), atol=1e-5)  # of some 1e3 N m/rad


def test_the_torque_of_a_wrench_is_the_transposed_jacobian_times_it():
    ours = load_torque(forward(ARM, MOUNT, POSTURES), WRENCHES, link_loads(ARM, MOUNT, 0.0))
    np.testing.assert_allclose(ours, np.einsum("nij,ni->nj", jacobian(ARM, MOUNT, POSTURES), WRENCHES), atol=1e-9)


def test_the_hessian_is_symmetric_for_forces_and_not_for_moments():
    forces, loads = WRENCHES * [1, 1, 1, 0, 0, 0], link_loads(ARM, MOUNT)
    bent = load_hessian(forward(ARM, MOUNT, POSTURES), forces, loads)
    np.testing.assert_allclose(bent, np.swapaxes(bent, -1, -2), atol=1e-9)
    turned = load_hessian(forward(ARM, MOUNT, POSTURES), WRENCHES, loads)
    assert np.all(np.abs(turned - np.swapaxes(turned, -1, -2)).max((-1, -2)) > 1.0)
