"""The static mirror (30)-(32): under load the modified target ends where the target is."""

from __future__ import annotations

import numpy as np
import pytest
from arm_oracle import PAPER, arm_of
from book import check
from scipy.spatial.transform import Rotation

from kr270_milling.base.frames import Pose
from kr270_milling.physics.compensation.mirror import LEVER, MirrorError, loaded_pose, mirror
from kr270_milling.physics.robot import Mount, equilibrium, pose

ARM, SEED = arm_of(), PAPER
SPINDLE = Mount(xyz=np.array([0.25, 0.0, 0.1]), mass=60.0, mass_centre=np.array([0.1, 0.0, 0.05]))
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


@check(
    "mirror (32): error of an iteration / of the one before, alpha {relaxation}", "1 - alpha for a nearly linear arm",
    cases=("relaxation", [(0.2,), (0.5,), (0.8,), (0.9,)]),
)  # fmt: skip
def test_mirror_rate(relaxation):
    history = np.array(mirror(ARM, SPINDLE, TARGET, WRENCH, SEED, relaxation=relaxation, max_iterations=200).history)
    assert np.all(np.diff(history) < 0)
    rate = np.exp(np.polyfit(np.arange(len(history) - 1), np.log(history[:-1]), 1)[0])
    return 1 - relaxation, rate, 0.05 * (1 - relaxation)


def test_a_path_is_mirrored_point_by_point():
    wrenches = WRENCH * np.linspace(-1, 1, 5)[:, None]
    whole = mirror(ARM, SPINDLE, TARGET, wrenches, SEED).pose
    for k in range(5):
        one = mirror(ARM, SPINDLE, Pose(TARGET.position[k : k + 1], TARGET.rotation[:1]), wrenches[k], SEED).pose
        assert gap(one, Pose(whole.position[k : k + 1], whole.rotation[k : k + 1]))[0] < 2e-9


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
