"""The static mirror (30)-(32): under load the modified target ends where the target is."""

from __future__ import annotations

import numpy as np
import pytest
from book import check
from scipy.spatial.transform import Rotation

from kr270_milling.base.frames import Pose, rotation_from_quaternion
from kr270_milling.base.record import find_file
from kr270_milling.cell.cell import read_cell
from kr270_milling.physics.compensation.mirror import LEVER, MirrorError, loaded_pose, mirror
from kr270_milling.physics.robot import Mount, compliance, equilibrium, pose

PAPER = read_cell(find_file("paper.yaml"))
ARM, SEED = PAPER.arm, PAPER.start_joints
SPINDLE = Mount(xyz=np.array([0.25, 0.0, 0.1]), mass=60.0, mass_centre=np.array([0.1, 0.0, 0.05]))
LINE = PAPER.target()
START = pose(ARM, SPINDLE, SEED)
TARGET = Pose(
    START.position + np.linspace(0, 0.08, 5)[:, None] * START.rotation[:, 0], np.tile(START.rotation, (5, 1, 1))
)
WRENCH = np.array([800.0, -600.0, 400.0, 60.0, -90.0, 40.0])
LOADS = {"1 kN and moments": [1] * 6, "1 kN": [1, 1, 1, 0, 0, 0], "moments": [0, 0, 0, 1, 1, 1]}


def gap(first: Pose, second: Pose) -> tuple[float, float]:
    """Largest distance [m] and angle [rad] between two stacks of poses."""
    turn = Rotation.from_matrix(first.rotation @ np.swapaxes(second.rotation, -1, -2)).magnitude()
    return np.linalg.norm(first.position - second.position, axis=-1).max(), np.max(turn)


@check(
    "mirror (31), {load}, alpha {relaxation}: loaded tool where the target is", "(31) solved: the target; link weights",
    "m", cases=("load relaxation", [(load, alpha) for load in LOADS for alpha in (0.5, 0.9, 1.0)]),
)  # fmt: skip
def test_mirror_target(load, relaxation):
    force = WRENCH * LOADS[load]
    found = mirror(ARM, SPINDLE, TARGET, force, SEED, relaxation=relaxation, sag_compensated=False)
    loaded = equilibrium(ARM, SPINDLE, found.joints, np.tile(force, (5, 1)), gravity=True).pose
    assert gap(loaded, TARGET)[1] < 1e-8
    assert gap(pose(ARM, SPINDLE, found.joints), found.pose)[0] < 1e-12  # the joints command the modified target
    return 0.0, gap(loaded, TARGET)[0], 1e-9


def test_with_the_sag_left_to_the_controller_the_wrench_alone_is_mirrored():
    found = mirror(ARM, SPINDLE, TARGET, WRENCH, SEED)
    heavy, light = (
        equilibrium(ARM, SPINDLE, found.joints, w * np.ones((5, 1)), gravity=True).pose for w in (WRENCH, 0 * WRENCH)
    )
    moved = found.pose.position + heavy.position - light.position
    np.testing.assert_allclose(moved, TARGET.position, atol=1e-9)
    turned = heavy.rotation @ np.swapaxes(light.rotation, -1, -2) @ found.pose.rotation
    assert gap(Pose(moved, turned), TARGET)[1] < 1e-8


def test_the_two_ways_to_see_the_weights_differ_by_the_sag():
    sag = equilibrium(ARM, SPINDLE, SEED, gravity=True).pose.position - START.position
    assert sag[2] < -1e-4
    lifted, level = (mirror(ARM, SPINDLE, TARGET, WRENCH, SEED, sag_compensated=s).pose for s in (False, True))
    np.testing.assert_allclose((lifted.position - level.position)[0], -sag, atol=0.02 * np.linalg.norm(sag))


def test_without_load_the_target_is_its_own_mirror_or_the_lift_against_the_sag():
    found = mirror(ARM, SPINDLE, TARGET, np.zeros(6), SEED)
    np.testing.assert_array_equal(found.pose.position, TARGET.position)
    assert len(found.history) == 1
    found = mirror(ARM, SPINDLE, TARGET, np.zeros(6), SEED, sag_compensated=False)
    assert gap(equilibrium(ARM, SPINDLE, found.joints, gravity=True).pose, TARGET)[0] < 1e-9
    assert np.all(found.pose.position[:, 2] > TARGET.position[:, 2] + 1e-4)


@check(
    "mirror (32): error of an iteration / of the one before, alpha {relaxation}", "1 - alpha for a nearly linear arm",
    cases=("relaxation", [(0.2,), (0.5,), (0.8,), (0.9,)]),
)  # fmt: skip
def test_mirror_rate(relaxation):
    history = np.array(mirror(ARM, SPINDLE, TARGET, WRENCH, SEED, relaxation=relaxation, max_iterations=200).history)
    assert np.all(np.diff(history) < 0)
    rate = np.exp(np.polyfit(np.arange(len(history) - 1), np.log(history[:-1]), 1)[0])
    return 1 - relaxation, rate, 0.05 * (1 - relaxation)


def test_without_relaxation_each_iteration_leaves_the_change_of_stiffness_alone():
    """The displacement changes with the posture by a few per mille: three digits and more an iteration."""
    history = mirror(ARM, SPINDLE, TARGET, WRENCH, SEED, relaxation=1.0).history
    assert len(history) <= 4 and all(b < 5e-3 * a for a, b in zip(history, history[1:], strict=False))


def test_a_small_wrench_is_mirrored_by_the_linear_compliance():
    small = 1e-3 * WRENCH
    found = mirror(ARM, SPINDLE, TARGET, small, SEED, relaxation=1.0, tolerance=1e-13)
    for k, joints in enumerate(found.joints):
        linear = compliance(equilibrium(ARM, SPINDLE, joints), ARM) @ small
        np.testing.assert_allclose((TARGET.position - found.pose.position)[k], linear[:3], rtol=2e-3, atol=1e-11)
        turn = Rotation.from_matrix(TARGET.rotation[k] @ found.pose.rotation[k].T).as_rotvec()
        np.testing.assert_allclose(turn, linear[3:], rtol=2e-3, atol=1e-11)


def test_a_path_is_mirrored_point_by_point():
    wrenches = WRENCH * np.linspace(-1, 1, 5)[:, None]
    whole = mirror(ARM, SPINDLE, TARGET, wrenches, SEED, relaxation=1.0)
    for k in range(5):
        one = mirror(
            ARM, SPINDLE, Pose(TARGET.position[k : k + 1], TARGET.rotation[:1]), wrenches[k], SEED, relaxation=1.0
        )
        assert gap(one.pose, Pose(whole.pose.position[k : k + 1], whole.pose.rotation[k : k + 1]))[0] < 2e-9


def test_loaded_pose_without_a_wrench_is_where_the_joints_are_or_the_sag_below():
    joints = np.tile(SEED, (2, 1))
    level = loaded_pose(ARM, SPINDLE, joints, np.zeros((2, 6)), True)
    np.testing.assert_allclose(level.position, np.tile(START.position, (2, 1)), atol=1e-14)
    sagged = loaded_pose(ARM, SPINDLE, joints, np.zeros((2, 6)), False)
    np.testing.assert_array_equal(sagged.position, equilibrium(ARM, SPINDLE, joints).pose.position)


@pytest.mark.parametrize(("relaxation", "iterations"), [(0.01, 60), (0.9, 3), (1.0, 1)])
def test_an_iteration_that_is_cut_short_says_what_is_left(relaxation, iterations):
    with pytest.raises(MirrorError, match="did not converge") as caught:
        mirror(ARM, SPINDLE, TARGET, WRENCH, SEED, relaxation=relaxation, max_iterations=iterations)
    history = caught.value.history
    assert len(history) == iterations and history[-1] > caught.value.tolerance == 1e-9
    assert f"{history[-1]:.3g} m left" in str(caught.value)


def test_a_rotation_counts_with_its_lever():
    moment = np.array([0, 0, 0, 0, 0, 30.0])
    found = mirror(ARM, SPINDLE, TARGET, moment, SEED)
    tilted = loaded_pose(ARM, SPINDLE, np.tile(SEED, (1, 1)), moment[None], True)
    shift, turn = gap(tilted, Pose(START.position[None], START.rotation[None]))
    assert found.history[0] == pytest.approx(shift + LEVER * turn, rel=0.05)


def test_the_papers_mean_slot_force_is_mirrored_by_its_58_micrometres():
    force = np.array([-44.39, 147.98, 0, 0, 0, 0]) * PAPER.path.depth_of_cut * 1e3
    turn = PAPER.workpiece.pose.rotation
    tool = PAPER.workpiece.pose @ Pose(LINE.position, rotation_from_quaternion(LINE.quaternion))
    in_base = np.concatenate([turn @ force[:3], np.zeros(3)])
    found = mirror(ARM, PAPER.mount, tool, in_base, SEED)
    shift = (found.pose.position - tool.position) @ turn
    assert shift[0, 1] == pytest.approx(-58.1e-6, rel=0.01)
    softness = compliance(equilibrium(ARM, PAPER.mount, found.joints), ARM)  # changes by 6 % over the 80 mm
    linear = -np.einsum("nij,j->ni", softness, in_base)[:, :3] @ turn
    np.testing.assert_allclose(shift, linear, rtol=2e-3, atol=1e-9)
