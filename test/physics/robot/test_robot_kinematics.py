"""Forward kinematics and Jacobians against pinocchio, differences and closed forms."""

import numpy as np
import pinocchio as pin
import pytest

from kr270_milling.base.record import find_file
from kr270_milling.physics.robot import Mount, forward, jacobian, pose, singularity_measures, status_turn
from kr270_milling.physics.robot.analysis import read_arm
from kr270_milling.physics.robot.errors import SingularityError
from kr270_milling.physics.robot.kinematics import check_regular

ARM, _ = read_arm(find_file("kr270_2.yaml"))
MOUNT = Mount(xyz=np.array([0.31, -0.04, 0.12]), abc=np.radians([20.0, 70.0, -35.0]), mass=41.0)
POSTURES = np.random.default_rng(5).uniform(ARM.joint_lower, ARM.joint_upper, (100, 6))


def oracle():
    """The chain of the arm's data sheet as a pinocchio model with a frame at tool0."""
    model, parent, at = pin.Model(), 0, np.zeros(3)
    axes = [(0, 0, -1), (0, 1, 0), (0, 1, 0), (-1, 0, 0), (0, 1, 0), (-1, 0, 0)]
    ends = [(ARM.a1, 0, ARM.d1), (ARM.a2, 0, 0), (0, 0, ARM.a3), (ARM.d4, 0, 0), (0, 0, 0), (ARM.d6, 0, 0)]
    for axis, end in zip(axes, ends, strict=True):
        joint = pin.JointModelRevoluteUnaligned(np.array(axis, float))
        parent = model.addJoint(parent, joint, pin.SE3(np.eye(3), at), f"j{parent + 1}")
        at = np.array(end, float)
    a, b, c = np.radians([20.0, 70.0, -35.0])
    turn = pin.rpy.rpyToMatrix(c, b, a)
    place = pin.SE3(np.eye(3), at) * pin.SE3(turn, np.array([0.31, -0.04, 0.12]))
    model.addFrame(pin.Frame("tool0", parent, 0, place, pin.FrameType.OP_FRAME))
    return model


def test_pose_and_jacobian_equal_pinocchio_at_100_random_postures():
    model = oracle()
    data, frame = model.createData(), model.getFrameId("tool0")
    ours, matrix = pose(ARM, MOUNT, POSTURES), jacobian(ARM, MOUNT, POSTURES)
    for i, q in enumerate(POSTURES):
        pin.framesForwardKinematics(model, data, q)
        np.testing.assert_allclose(ours.position[i], data.oMf[frame].translation, atol=1e-9)
        np.testing.assert_allclose(ours.rotation[i], data.oMf[frame].rotation, atol=1e-9)
        theirs = pin.computeFrameJacobian(model, data, q, frame, pin.LOCAL_WORLD_ALIGNED)
        np.testing.assert_allclose(matrix[i], theirs, atol=1e-9)


@pytest.mark.parametrize("node", range(7))
def test_node_jacobians_are_the_derivatives_of_the_node_points(node):
    step, matrix = 1e-6, jacobian(ARM, MOUNT, POSTURES, node)
    for k in range(6):
        ahead, behind = (forward(ARM, MOUNT, POSTURES + s * step * np.eye(6)[k]).nodes[:, node] for s in (1, -1))
        np.testing.assert_allclose(matrix[:, :3, k], (ahead - behind) / (2 * step), atol=1e-8)


def test_the_end_of_a_link_turns_with_the_joints_up_to_it_and_no_later_one():
    axes = forward(ARM, MOUNT, POSTURES).axes
    for node in range(7):
        turning = jacobian(ARM, MOUNT, POSTURES, node)[:, 3:]
        np.testing.assert_array_equal(turning[:, :, :node], np.swapaxes(axes[:, :node], -1, -2))
        assert not turning[:, :, node:].any()


def test_at_zero_the_arm_is_stretched_horizontally_forward():
    frames = forward(ARM, Mount(), np.zeros(6))
    np.testing.assert_allclose(frames.flange.position, [0.35 + 1.25 + 1.1 + 0.23, 0, 0.75 - 0.055])
    np.testing.assert_allclose(frames.flange.rotation, np.eye(3), atol=1e-16)


def test_the_upper_arm_is_upright_at_minus_90_deg_and_axis_1_turns_clockwise_from_above():
    up = forward(ARM, Mount(), np.radians([0, -90, 0, 0, 0, 0])).nodes
    np.testing.assert_allclose(up[2] - up[1], [0, 0, ARM.a2], atol=1e-15)
    assert pose(ARM, Mount(), np.radians([30, 0, 0, 0, 0, 0])).position[1] < 0


def test_postures_of_any_batch_shape_give_what_single_ones_give():
    batch = POSTURES[:24].reshape(2, 3, 4, 6)
    np.testing.assert_array_equal(pose(ARM, MOUNT, batch).position[1, 2, 3], pose(ARM, MOUNT, POSTURES[23]).position)
    assert jacobian(ARM, MOUNT, np.empty((0, 6))).shape == (0, 6, 6)


def test_the_determinant_of_the_jacobian_is_the_product_of_the_three_measures_and_the_lengths():
    determinant = np.linalg.det(jacobian(ARM, MOUNT, POSTURES))
    lengths = (ARM.a2 + ARM.forearm) * ARM.a2 * ARM.forearm
    product = np.prod(singularity_measures(ARM, POSTURES), -1) * lengths
    np.testing.assert_allclose(np.abs(determinant), product, atol=1e-12)


@pytest.mark.parametrize(
    "which, q", [("wrist", [0.3, -1, 1, 0.2, 0, 0.1]), ("elbow", [0.3, -1, np.arctan2(-0.055, 1.1), 0.2, 1, 0.1])]
)
def test_a_singular_posture_in_a_batch_is_named_with_its_place(which, q):
    batch = np.stack([POSTURES[0], np.array(q)])
    with pytest.raises(SingularityError, match=which) as caught:
        check_regular(ARM, batch)
    assert caught.value.which == which and caught.value.index == (1,) and caught.value.measure < 1e-9


def test_status_tells_overhead_elbow_and_wrist_and_turn_the_negative_axes():
    home = np.radians([0, -90, 90, 0, 0, 0])
    assert status_turn(ARM, home) == (2, 0b000010)
    assert status_turn(ARM, np.radians([0, -90, 90, 0, -10, -1])) == (6, 0b110010)
    assert status_turn(ARM, np.radians([-5, -146, 0, 0, 10, 0]))[0] == 0b011  # leaning back over axis 1
    assert status_turn(ARM, np.radians([0, -20, -30, 0, 10, 0]))[0] == 0b000  # elbow down
    stretched = np.degrees(ARM.elbow_offset)
    sides = np.radians([[0, -20, stretched + d, 0, 10, 0] for d in (-0.01, 0, 0.01)])
    np.testing.assert_array_equal(status_turn(ARM, sides)[0], [0, 2, 2])


def test_rounding_noise_does_not_set_a_turn_bit():
    assert status_turn(ARM, np.array([-1e-15, -1.0, 1.0, -1e-16, -1e-15, 0.0])) == (2, 0b000010)
