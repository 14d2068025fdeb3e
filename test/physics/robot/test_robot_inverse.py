"""Closed-form inverse kinematics: round trips, branches, paths, errors that carry their numbers."""

import numpy as np
import pytest
from budget import budget
from hypothesis import given, settings
from hypothesis import strategies as st

from kr270_milling.base.frames import Pose
from kr270_milling.base.record import find_file
from kr270_milling.physics.robot import BARE, Mount, inverse_near, pose
from kr270_milling.physics.robot.analysis import read_arm
from kr270_milling.physics.robot.errors import JointLimitError, ReachError, SingularityError
from kr270_milling.physics.robot.inverse import branches

ARMS = [read_arm(find_file(name))[0] for name in ("kr270_2.yaml", "kr270_r2700_ultra.yaml")]
ARM = ARMS[0]
MOUNT = Mount(xyz=np.array([0.2, 0.01, -0.15]))
PAPER = np.radians([90, -50, 120, 180, 25, 180])


def same_pose(a: Pose, b: Pose, tolerance=1e-10):
    return np.abs(a.position - b.position).max() < tolerance and np.abs(a.rotation - b.rotation).max() < tolerance


@settings(max_examples=budget(100), deadline=None)
@given(st.sampled_from(ARMS), st.lists(st.floats(0.001, 0.999), min_size=6, max_size=6))
def test_every_branch_leads_back_to_the_pose_and_one_is_the_posture_itself(arm, shares):
    q = arm.joint_lower + np.array(shares) * (arm.joint_upper - arm.joint_lower)
    target = pose(arm, MOUNT, q)
    found, _ = branches(arm, MOUNT, target, q)
    found = found[np.isfinite(found).all(-1)]
    assert same_pose(pose(arm, MOUNT, found), Pose(target.position[None], target.rotation[None]))
    if abs(np.sin(q[4])) > 1e-6:
        away = (found - q) / (2 * np.pi)
        assert np.abs(away - np.round(away)).max(-1).min() < 1e-6


def test_all_eight_branches_are_different_and_right_where_limits_do_not_matter():
    q = np.array([0.4, -1.7, 1.9, 0.7, 0.6, -0.3])  # near axis 1, so that the arm reaches it leaning back too
    target = pose(ARM, MOUNT, q)
    found, _ = branches(ARM, MOUNT, target, q)
    reached = found[np.isfinite(found).all(-1)]
    assert len(reached) == 8
    assert len(np.unique(np.round(reached, 6), axis=0)) == 8
    for one in reached:
        assert same_pose(pose(ARM, MOUNT, one), target)


def test_each_pose_of_a_batch_goes_to_its_own_seed():
    rng = np.random.default_rng(3)
    q = rng.uniform(ARM.joint_lower, ARM.joint_upper, (40, 5, 6))
    seeds = q + rng.uniform(-1e-3, 1e-3, q.shape)
    np.testing.assert_allclose(inverse_near(ARM, MOUNT, pose(ARM, MOUNT, q), seeds), q, atol=1e-6)


def test_a_path_through_wrist_singularity_and_half_turn_is_followed_without_a_jump():
    share = np.linspace(0, 1, 5001)[:, None]  # A5 passes through 0 at a point of the path
    path = np.radians([90, -50, 120, 100, -25, 180]) + share * np.radians([-50, 10, -20, 160, 50, -400])
    found = inverse_near(ARM, MOUNT, pose(ARM, MOUNT, path), path[0] + 0.01)
    regular = np.arange(5001) != 2500  # there A5 = 0 and A4 stays at its last value
    np.testing.assert_allclose(found[regular], path[regular], atol=1e-7)
    assert found[2500, 3] == found[2499, 3]
    assert same_pose(pose(ARM, MOUNT, found), pose(ARM, MOUNT, path))


def test_a_whole_stretch_with_axis_5_at_zero_keeps_axis_4_of_the_seed():
    path = np.radians([20, -70, 90, 33, 0, 10]) + np.linspace(0, 1, 50)[:, None] * np.radians([40, 10, -10, 0, 0, 80])
    np.testing.assert_allclose(inverse_near(ARM, MOUNT, pose(ARM, MOUNT, path), path[0]), path, atol=1e-9)
    single = inverse_near(ARM, MOUNT, pose(ARM, MOUNT, path[7]), path[7])
    np.testing.assert_allclose(single, path[7], atol=1e-9)


def test_a_batch_of_paths_and_seeds_keeps_its_shape_and_an_empty_path_is_empty():
    one = pose(ARM, MOUNT, PAPER)
    assert inverse_near(ARM, MOUNT, one, PAPER).shape == (6,)
    assert inverse_near(ARM, MOUNT, one, np.stack([PAPER, PAPER])).shape == (2, 6)
    assert inverse_near(ARM, MOUNT, Pose(np.empty((0, 3)), np.empty((0, 3, 3))), PAPER).shape == (0, 6)


def test_a_pose_out_of_reach_is_refused_with_distance_reach_and_place():
    path = pose(ARM, BARE, np.tile(PAPER, (4, 1)))
    position = path.position.copy()
    position[2, 1] -= 3.0
    with pytest.raises(ReachError, match="reaches") as caught:
        inverse_near(ARM, BARE, Pose(position, path.rotation), PAPER)
    assert caught.value.index == (2,)
    low, high = caught.value.reach
    assert high == pytest.approx(1.25 + np.hypot(1.1, 0.055)) and low == pytest.approx(1.25 - np.hypot(1.1, 0.055))
    centre = position[2] - 0.23 * path.rotation[2, :, 0]
    away = np.hypot(np.hypot(centre[0], centre[1]) - 0.35, centre[2] - 0.75)
    assert caught.value.distance == pytest.approx(away)
    with pytest.raises(ReachError):
        inverse_near(ARM, BARE, Pose(position[2], path.rotation[2]), PAPER)


def test_a_path_that_leaves_a_joint_range_is_refused_with_joint_angle_limits_and_place():
    path = PAPER + np.linspace(0, 1, 11)[:, None] * np.radians([0, 0, 0, 0, 0, 200])
    with pytest.raises(JointLimitError, match="joint 6 would be at 360.000 deg") as caught:
        inverse_near(ARM, MOUNT, pose(ARM, MOUNT, path), PAPER)
    assert (caught.value.joint, caught.value.index) == (6, (9,))
    assert caught.value.limits == pytest.approx(tuple(np.radians([-350, 350])))


def test_a_wrist_centre_on_axis_1_is_a_shoulder_singularity():
    above = Pose(np.array([0.23, 0.0, 2.6]), np.eye(3))
    with pytest.raises(SingularityError, match="shoulder"):
        inverse_near(ARM, BARE, above, np.radians([0, -90, 0, 0, 90, 0]))
