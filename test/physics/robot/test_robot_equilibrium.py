"""Static equilibria under load: balance, both ways, stability against closed forms."""

import numpy as np
import pytest

from kr270_milling.base.frames import Pose
from kr270_milling.base.record import find_file
from kr270_milling.physics.robot import BARE, Mount, equilibrium, jacobian, link_loads, pose, wrench_for_pose
from kr270_milling.physics.robot.analysis import read_arm
from kr270_milling.physics.robot.errors import DeflectionError, EquilibriumError, SingularityError, UnstableLoadError
from kr270_milling.physics.robot.kinematics import forward
from kr270_milling.physics.robot.loads import load_torque

RNG = np.random.default_rng(2)
ARM, _ = read_arm(find_file("kr270_2.yaml"))
MOUNT = Mount(xyz=np.array([0.3, 0.0, 0.1]), mass=60.0, mass_centre=np.array([0.1, 0.0, 0.02]))
PAPER = np.radians([90, -50, 120, 180, 25, 180])
POSTURES = PAPER + RNG.uniform(-0.3, 0.3, (50, 6))
WRENCHES = RNG.normal(size=(50, 6)) * [600, 600, 600, 100, 100, 100]


def stretched():
    """An arm without offset, only joint 2 soft (K = 1e6 N m/rad), stretched along x: a column on one hinge."""
    soft = np.array([1e-12, 1e-6, 1e-12, 1e-12, 1e-12, 1e-12])
    return ARM.replace(a3=0.0, joint_compliance=soft), 1e6 / (1.25 + 1.1 + 0.23)


def test_springs_hold_wrench_and_weights_to_a_nano_newton_metre():
    solved = equilibrium(ARM, MOUNT, POSTURES, WRENCHES)
    torque = load_torque(forward(ARM, MOUNT, solved.posture), WRENCHES, link_loads(ARM, MOUNT))
    assert np.abs(ARM.joint_stiffness * solved.theta - torque).max() <= 1e-9
    assert solved.residual.max() <= 1e-9
    np.testing.assert_array_equal(solved.pose.position, pose(ARM, MOUNT, POSTURES + solved.theta).position)
    np.testing.assert_array_equal(solved.jacobian, jacobian(ARM, MOUNT, solved.posture))


def test_without_load_nothing_moves_and_gravity_alone_makes_the_arm_sag():
    still = equilibrium(ARM, MOUNT, PAPER, gravity=False)
    assert not still.theta.any() and still.pose.position.shape == (3,)
    assert equilibrium(ARM, MOUNT, PAPER).pose.position[2] < still.pose.position[2]


def test_a_batch_gives_exactly_what_single_postures_give():
    batch = equilibrium(ARM, MOUNT, POSTURES.reshape(5, 10, 6), WRENCHES.reshape(5, 10, 6))
    single = equilibrium(ARM, MOUNT, POSTURES[23], WRENCHES[23])
    np.testing.assert_array_equal(batch.theta[2, 3], single.theta)
    np.testing.assert_array_equal(batch.hessian[2, 3], single.hessian)
    assert equilibrium(ARM, MOUNT, np.empty((0, 6))).theta.shape == (0, 6)


def test_one_posture_meets_many_wrenches():
    assert equilibrium(ARM, MOUNT, PAPER, WRENCHES).theta.shape == (50, 6)


@pytest.mark.parametrize("base", [0.0, 0.08e-6])
@pytest.mark.parametrize("gravity", [False, True])
def test_the_wrench_found_for_a_loaded_pose_is_the_one_that_bent_the_arm(gravity, base):
    arm = ARM.replace(base_compliance=np.array([base, base, 0.0]))
    there = equilibrium(arm, MOUNT, POSTURES, WRENCHES, gravity)
    back = wrench_for_pose(arm, MOUNT, POSTURES, there.pose, gravity)
    np.testing.assert_allclose(back.wrench, WRENCHES, atol=1e-4)  # 1e-12 m and rad times 1e7 N m/rad, some singular
    np.testing.assert_allclose(back.theta, there.theta, atol=1e-10)
    assert back.residual.max() <= 1e-9 and back.iterations.max() <= 5  # quadratic: 1e-3 rad to 1e-12 in few steps


def test_a_tool_held_where_the_unloaded_arm_has_it_takes_the_weights_only():
    held = wrench_for_pose(ARM, MOUNT, PAPER, pose(ARM, MOUNT, PAPER))
    np.testing.assert_allclose(held.theta, 0, atol=1e-12)
    torque = load_torque(forward(ARM, MOUNT, PAPER), np.zeros(6), link_loads(ARM, MOUNT))
    np.testing.assert_allclose(jacobian(ARM, MOUNT, PAPER).T @ held.wrench, -torque, atol=1e-5)


def test_the_wrench_for_a_pose_is_not_defined_in_a_singular_posture():
    straight = PAPER * [1, 1, 1, 1, 0, 1]
    with pytest.raises(SingularityError, match="wrist"):
        wrench_for_pose(ARM, MOUNT, straight, pose(ARM, MOUNT, PAPER))


def test_a_pose_too_far_for_any_spring_is_an_error():
    away = pose(ARM, MOUNT, PAPER)
    with pytest.raises((EquilibriumError, SingularityError)):
        wrench_for_pose(ARM, MOUNT, PAPER, Pose(away.position + [0, -3.0, 0], away.rotation))


@pytest.mark.parametrize("share", [0.5, 0.99])
def test_a_column_on_one_hinge_stands_below_its_critical_load(share):
    arm, critical = stretched()
    solved = equilibrium(arm, BARE, np.zeros(6), [-share * critical, 0, 0, 0, 0, 0], gravity=False)
    np.testing.assert_allclose(solved.theta, 0, atol=1e-15)
    np.testing.assert_allclose(solved.hessian[1, 1], share * 1e6, rtol=1e-12)


def test_a_column_on_one_hinge_falls_above_its_critical_load():
    arm, critical = stretched()
    with pytest.raises(UnstableLoadError, match="unstable") as caught:
        equilibrium(arm, BARE, np.stack([np.zeros(6)] * 2), [[0.0] * 6, [-1.01 * critical, 0, 0, 0, 0, 0]], False)
    assert caught.value.index == (1,) and caught.value.eigenvalue < 0
    assert caught.value.load_factor == pytest.approx(1.0, abs=0.01)


def test_a_soft_hinge_bent_far_by_a_dead_load_follows_its_closed_form():
    arm, critical = stretched()
    force = 0.15 * critical  # sideways: K theta = F L cos(theta), large enough for the load steps
    theta = equilibrium(arm, BARE, np.zeros(6), [0, 0, -force, 0, 0, 0], gravity=False).theta[1]
    assert theta > 0.14
    assert 1e6 * theta == pytest.approx(force * 2.58 * np.cos(theta), rel=1e-6)


def test_a_spring_bent_beyond_belief_is_an_error_with_joint_and_angle():
    arm, critical = stretched()
    with pytest.raises(DeflectionError, match="joint 2") as caught:
        equilibrium(arm, BARE, np.zeros(6), [0, 0, -0.5 * critical, 0, 0, 0], gravity=False)
    theta, share = caught.value.deflection, caught.value.load_factor
    assert theta == pytest.approx(share * 0.5 * np.cos(theta)) and theta > 0.2


def test_an_absurd_load_is_an_error_that_says_so_whatever_its_direction():
    for load in [1e7, 1e12, 1e30]:
        for axis in [*np.eye(6), *-np.eye(6)]:
            with pytest.raises((UnstableLoadError, EquilibriumError, DeflectionError), match="load"):
                equilibrium(ARM, MOUNT, PAPER, load * axis)


def test_an_arm_too_soft_for_its_own_weight_is_an_error():
    with pytest.raises((UnstableLoadError, EquilibriumError, DeflectionError), match="load"):
        equilibrium(ARM.replace(joint_compliance=np.full(6, 1e-2)), MOUNT, PAPER * [1, 1, 1, 1, 1, 0])


def test_a_wrench_that_is_no_number_is_an_error():
    with pytest.raises(EquilibriumError):
        equilibrium(ARM, MOUNT, PAPER, [np.nan, 0, 0, 0, 0, 0])
