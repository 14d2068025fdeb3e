"""Arm records, forward and inverse kinematics, Jacobians: against pinocchio, differences and closed forms."""

import itertools

import numpy as np
import pinocchio as pin
import pytest
from arm_oracle import ARM, ARMS, PAPER, POSTURES, TURNED, arm_of, pinocchio_arm
from book import check

from kr270_milling.base.errors import ParameterError
from kr270_milling.base.frames import Pose
from kr270_milling.base.parameter_file import find_file, read_tree
from kr270_milling.base.record import ConfigError, build
from kr270_milling.physics.robot import BARE, Arm, Mount, forward, inverse_near, jacobian, pose
from kr270_milling.physics.robot.analysis import read_arm
from kr270_milling.physics.robot.errors import JointLimitError, ReachError, SingularityError
from kr270_milling.physics.robot.inverse import branches
from kr270_milling.physics.robot.kinematics import check_regular, singularity_measures, status_turn


@check("{name}: flange position", "data sheet chain at the posture of Table 1, rounded to 0.1 mm [derived]", "m",
       cases=("name expected", zip(ARMS, ((0, -1.6407, 0.4924), (0, -1.6308, 0.2446)), strict=True)))  # fmt: skip
def test_flange_position(name, expected):
    return 0.0, np.abs(pose(arm_of(name), BARE, PAPER).position - expected).max(), 5.1e-5


def test_arm_files_have_table_1_its_posture_and_a_bare_flange_and_an_impossible_arm_or_mount_is_refused():
    for name in ARMS:
        arm, mount = read_arm(find_file(f"{name}.yaml"))
        assert np.all((arm.joint_lower <= PAPER) & (arm.joint_upper >= PAPER))
        np.testing.assert_allclose(1 / arm.spring_stiffness, np.array([0.26, 0.15, 0.26, 1.79, 1.52, 2.13]) * 1e-6)
        assert arm.link_mass.sum() == pytest.approx(790.4)
        np.testing.assert_array_equal(mount.pose.rotation, np.eye(3))
    np.testing.assert_allclose(Mount().pose.rotation[:, 2], [1, 0, 0], atol=1e-15)  # the default: z out of the flange
    tree = read_tree(find_file("kr270_2.yaml"))["arm"]
    with pytest.raises(ConfigError, match="joint_upper_deg.*above joint_lower_deg"):
        build(Arm, tree | {"joint_upper_deg": [185.0, -200.0, 155.0, 350.0, 125.0, 350.0]})
    with pytest.raises(ParameterError, match="none is larger than the others' sum"):
        Mount(inertia=np.array([1.0, 0.2, 0.2]))


@check("pose at 100 postures", "pinocchio", "m, rad")
def test_pinocchio_pose():
    model, data, frame = pinocchio_arm(ARM, TURNED)
    ours, worst = pose(ARM, TURNED, POSTURES), 0.0
    for i, q in enumerate(POSTURES):
        pin.framesForwardKinematics(model, data, q)
        gap = np.abs(ours.position[i] - data.oMf[frame].translation).max()
        worst = max(worst, gap, np.abs(ours.rotation[i] - data.oMf[frame].rotation).max())
    return 0.0, worst, 1e-9


@check("Jacobian at 100 postures", "pinocchio", "m/rad")
def test_pinocchio_jacobian():
    model, data, frame = pinocchio_arm(ARM, TURNED)
    theirs = [pin.computeFrameJacobian(model, data, q, frame, pin.LOCAL_WORLD_ALIGNED) for q in POSTURES]
    return 0.0, np.abs(jacobian(ARM, TURNED, POSTURES) - theirs).max(), 1e-9


def test_jacobians_of_nodes_are_derivatives_of_their_points_and_the_determinant_is_that_of_measures_and_lengths():
    for node in range(7):
        step, matrix = 1e-6, jacobian(ARM, TURNED, POSTURES, node)
        for k in range(6):
            ahead, behind = (forward(ARM, TURNED, POSTURES + s * step * np.eye(6)[k]).nodes[:, node] for s in (1, -1))
            np.testing.assert_allclose(matrix[:, :3, k], (ahead - behind) / (2 * step), atol=1e-8)
        axes = forward(ARM, TURNED, POSTURES).axes
        np.testing.assert_array_equal(matrix[:, 3:, :node], np.swapaxes(axes[:, :node], -1, -2))
        assert not matrix[:, 3:, node:].any()
    determinant = np.linalg.det(jacobian(ARM, TURNED, POSTURES))
    lengths = (ARM.a2 + ARM.forearm) * ARM.a2 * ARM.forearm
    product = np.prod(singularity_measures(ARM, POSTURES), -1) * lengths
    np.testing.assert_allclose(np.abs(determinant), product, atol=1e-12)


@pytest.mark.parametrize(("degrees", "expected"), [
    ([0, -90, 90, 0, 0, 0], (2, 0b000010)),
    ([0, -90, 90, 0, -10, -1], (6, 0b110010)),
    ([-1e-13, -60, 60, -1e-14, -1e-13, 0], (2, 0b000010)),  # rounding noise sets no bit
    ([-5, -146, 0, 0, 10, 0], (0b011, 0b000011)),  # leaning back over axis 1
    ([0, -20, -30, 0, 10, 0], (0b000, 0b000110)),  # elbow down
    ([0, -20, np.degrees(ARM.elbow_offset) - 0.01, 0, 10, 0], (0, 0b000110)),
    ([0, -20, np.degrees(ARM.elbow_offset) + 0.01, 0, 10, 0], (2, 0b000110)),
])  # fmt: skip
def test_status_tells_overhead_elbow_and_wrist_and_turn_the_negative_axes(degrees, expected):
    assert status_turn(ARM, np.radians(degrees)) == expected


@check("inverse kinematics, every branch", "self-consistent: forward kinematics of every solution", "m, rad")
def test_inverse_round_trip():
    worst = 0.0
    for arm, q in itertools.product(map(arm_of, ARMS), POSTURES[:20]):
        target = pose(arm, TURNED, q)
        joints, _ = branches(arm, TURNED, target, q)
        back = pose(arm, TURNED, joints[np.isfinite(joints).all(-1)])
        worst = max(worst, np.abs(back.position - target.position).max(), np.abs(back.rotation - target.rotation).max())
    return 0.0, worst, 1e-9


def test_all_eight_branches_are_different_and_each_pose_of_a_batch_goes_to_its_seed():
    q = np.array([0.4, -1.7, 1.9, 0.7, 0.6, -0.3])  # near axis 1, so that the arm reaches it leaning back too
    joints, _ = branches(ARM, BARE, pose(ARM, BARE, q), q)
    reached = joints[np.isfinite(joints).all(-1)]
    assert len(reached) == len(np.unique(np.round(reached, 6), axis=0)) == 8
    rng = np.random.default_rng(3)
    q = rng.uniform(ARM.joint_lower, ARM.joint_upper, (40, 5, 6))
    seeds = q + rng.uniform(-1e-3, 1e-3, q.shape)
    np.testing.assert_allclose(inverse_near(ARM, TURNED, pose(ARM, TURNED, q), seeds), q, atol=1e-6)
    one = pose(ARM, TURNED, PAPER)
    assert inverse_near(ARM, TURNED, one, PAPER).shape == (6,)
    assert inverse_near(ARM, TURNED, one, np.stack([PAPER, PAPER])).shape == (2, 6)
    assert inverse_near(ARM, TURNED, Pose(np.empty((0, 3)), np.empty((0, 3, 3))), PAPER).shape == (0, 6)


def test_a_path_through_wrist_singularity_and_half_turn_is_followed_and_a_stretch_with_axis_5_at_zero_keeps_axis_4():
    share = np.linspace(0, 1, 5001)[:, None]  # A5 passes through 0 at a point of the path
    path = np.radians([90, -50, 120, 100, -25, 180]) + share * np.radians([-50, 10, -20, 160, 50, -400])
    joints = inverse_near(ARM, TURNED, pose(ARM, TURNED, path), path[0] + 0.01)
    regular = np.arange(5001) != 2500  # there A5 = 0 and A4 stays at its last value
    np.testing.assert_allclose(joints[regular], path[regular], atol=1e-7)
    assert joints[2500, 3] == joints[2499, 3]
    back, wanted = pose(ARM, TURNED, joints), pose(ARM, TURNED, path)
    assert np.abs(back.position - wanted.position).max() < 1e-10 > np.abs(back.rotation - wanted.rotation).max()
    path = np.radians([20, -70, 90, 33, 0, 10]) + np.linspace(0, 1, 50)[:, None] * np.radians([40, 10, -10, 0, 0, 80])
    np.testing.assert_allclose(inverse_near(ARM, TURNED, pose(ARM, TURNED, path), path[0]), path, atol=1e-9)
    single = inverse_near(ARM, TURNED, pose(ARM, TURNED, path[7]), path[7])
    np.testing.assert_allclose(single, path[7], atol=1e-9)


def test_what_the_arm_does_not_reach_is_refused_with_place_distance_limits_and_singularity():
    path = pose(ARM, BARE, np.tile(PAPER, (4, 1)))
    position = path.position.copy()
    position[2, 1] -= 3.0
    with pytest.raises(ReachError, match="reaches") as caught:
        inverse_near(ARM, BARE, Pose(position, path.rotation), PAPER)
    assert caught.value.index == (2,)
    assert caught.value.reach == pytest.approx((1.25 - np.hypot(1.1, 0.055), 1.25 + np.hypot(1.1, 0.055)))
    centre = position[2] - 0.23 * path.rotation[2, :, 0]
    away = np.hypot(np.hypot(centre[0], centre[1]) - 0.35, centre[2] - 0.75)
    assert caught.value.distance == pytest.approx(away)
    path = PAPER + np.linspace(0, 1, 11)[:, None] * np.radians([0, 0, 0, 0, 0, 200])
    with pytest.raises(JointLimitError, match="joint 6 would be at 360.000 deg") as caught:
        inverse_near(ARM, TURNED, pose(ARM, TURNED, path), PAPER)
    assert (caught.value.joint, caught.value.index) == (6, (9,))
    assert caught.value.limits == pytest.approx(tuple(np.radians([-350, 350])))
    above = Pose(np.array([0.23, 0.0, 2.6]), np.eye(3))
    with pytest.raises(SingularityError, match="shoulder"):
        inverse_near(ARM, BARE, above, np.radians([0, -90, 0, 0, 90, 0]))
    for which, q in (("wrist", [0.3, -1, 1, 0.2, 0, 0.1]), ("elbow", [0.3, -1, np.arctan2(-0.055, 1.1), 0.2, 1, 0.1])):
        with pytest.raises(SingularityError, match=which) as caught:
            check_regular(ARM, np.stack([POSTURES[0], np.array(q)]))
        assert caught.value.which == which and caught.value.index == (1,) and caught.value.measure < 1e-9
