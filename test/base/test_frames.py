"""Poses, KUKA angles and quaternions, against scipy."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from kr270_milling.base.frames import (
    Pose,
    abc_from_rotation,
    quaternion_from_rotation,
    rotation_from_abc,
    rotation_from_quaternion,
)

RANDOM = np.random.default_rng(3)
ABC = RANDOM.uniform(-np.pi, np.pi, (500, 3))
POSES = [Pose(RANDOM.uniform(-2, 2, (7, 3)), rotation_from_abc(RANDOM.uniform(-3, 3, (7, 3)))) for _ in range(3)]
ANGLE = st.floats(-360.0, 360.0)


def angle_between(first, second):
    """[rad]"""
    return np.linalg.norm(first - second, axis=(-2, -1)) / np.sqrt(2)


def test_abc_are_scipys_intrinsic_turns_about_z_y_x_and_come_back():
    turn = rotation_from_abc(ABC)
    np.testing.assert_allclose(turn, Rotation.from_euler("ZYX", ABC).as_matrix(), atol=1e-15)
    abc = ABC * [1, 0.4999, 1]  # B within a quarter turn
    np.testing.assert_allclose(abc_from_rotation(rotation_from_abc(abc)), abc, atol=1e-12)
    back = abc_from_rotation(turn)
    assert np.all(np.abs(back[:, 1]) <= np.pi / 2)
    np.testing.assert_allclose(rotation_from_abc(back), turn, atol=1e-14)


@given(st.tuples(ANGLE, st.sampled_from([90.0, -90.0, 270.0, 90 - 1e-8, -90 + 1e-9, 90 - 1e-5]), ANGLE))
def test_at_and_near_gimbal_lock_the_rotation_comes_back(abc_deg):
    turn = rotation_from_abc(np.radians(abc_deg))
    assert angle_between(rotation_from_abc(abc_from_rotation(turn)), turn) < 3e-9


@pytest.mark.parametrize("b", [90.0, -90.0])
def test_at_gimbal_lock_c_is_zero(b):
    abc = abc_from_rotation(rotation_from_abc(np.radians([[30.0, b, 50.0], [0.0, b, 0.0]])))
    assert np.all(abc[:, 2] == 0.0)
    np.testing.assert_allclose(np.degrees(abc[:, 0]), [30.0 - 50.0 * np.sign(b), 0.0], atol=1e-7)


def test_quaternions_have_the_order_x_y_z_w_a_w_that_is_not_negative_and_any_length():
    half = np.sqrt(0.5)
    quarter_about_z = rotation_from_abc([np.pi / 2, 0, 0])
    np.testing.assert_allclose(quaternion_from_rotation(quarter_about_z), [0, 0, half, half], atol=1e-15)
    for length in (half, 3.0):
        np.testing.assert_allclose(rotation_from_quaternion([0, 0, length, length]), quarter_about_z, atol=1e-15)
    np.testing.assert_array_equal(rotation_from_quaternion([1.0, 0, 0, 0]), np.diag([1, -1, -1]))  # tool down
    quaternion = quaternion_from_rotation(rotation_from_abc(ABC))
    assert np.all(quaternion[:, 3] >= 0)
    np.testing.assert_allclose(np.linalg.norm(quaternion, axis=1), 1.0, atol=1e-15)
    for sign in (1, -1):  # q and -q are one rotation
        np.testing.assert_allclose(rotation_from_quaternion(sign * quaternion), rotation_from_abc(ABC), atol=1e-14)


def test_poses_multiply_like_homogeneous_matrices_and_map_points():
    def matrix(pose):
        out = np.tile(np.eye(4), (7, 1, 1))
        out[:, :3, :3], out[:, :3, 3] = pose.rotation, pose.position
        return out

    a, b, c = POSES
    np.testing.assert_allclose(matrix(a @ b @ c), matrix(a) @ matrix(b) @ matrix(c), atol=1e-14)
    np.testing.assert_allclose(matrix(a.inverse()), np.linalg.inv(matrix(a)), atol=1e-14)
    points = RANDOM.uniform(-1, 1, (7, 3))
    there = a.apply(points)
    np.testing.assert_allclose(there, (a.rotation @ points[..., None])[..., 0] + a.position, atol=1e-15)
    np.testing.assert_allclose(a.inverse().apply(there), points, atol=1e-15)
    one = Pose.from_abc([1.0, 2.0, 3.0], [0.1, 0.2, 0.3])
    stacked = one @ a  # one pose carries a whole stack
    np.testing.assert_allclose(stacked.position[4], one.apply(a.position[4]), atol=1e-15)
    np.testing.assert_allclose(stacked.quaternion[4], quaternion_from_rotation(one.rotation @ a.rotation[4]))
