"""Cartesian stiffness and compliance of loaded arms."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kr270_milling.base.record import find_file
from kr270_milling.physics.robot import (
    BARE,
    Mount,
    compliance,
    equilibrium,
    pose,
    rotate_matrix,
    singularity_measures,
    stiffness,
)  # fmt: skip
from kr270_milling.physics.robot.analysis import read_arm
from kr270_milling.physics.robot.errors import SingularityError

ARM, _ = read_arm(find_file("kr270_2.yaml"))
MOUNT = Mount(xyz=np.array([0.3, 0.0, 0.1]), mass=60.0, mass_centre=np.array([0.1, 0.0, 0.02]))
PAPER = np.radians([90, -50, 120, 180, 25, 180])
RNG = np.random.default_rng(8)
POSTURES = PAPER + RNG.uniform(-0.3, 0.3, (20, 6))
ON_BASE = ARM.replace(base_compliance=np.array([0.08e-6, 0.12e-6, 0.03e-6]))
BOTH = pytest.mark.parametrize("arm", [ARM, ON_BASE], ids=["rigid base", "compliant base"])


def kilonewton(moments):
    wrenches = RNG.normal(size=(len(POSTURES), 6))
    wrenches[:, :3] *= 1000 / np.linalg.norm(wrenches[:, :3], axis=-1, keepdims=True)
    return wrenches * ([1] * 3 + [200.0 if moments else 0.0] * 3)


@pytest.mark.parametrize(
    "name, lateral, in_plane, along",
    [("kr270_2.yaml", 0.7168, 0.6369, 0.1489), ("kr270_r2700_ultra.yaml", 0.7099, 0.7535, 0.1313)],
)  # [derived], facts.md
def test_the_unloaded_compliances_at_the_paper_posture_are_the_derived_ones(name, lateral, in_plane, along):
    arm, _ = read_arm(find_file(name))
    in_base = compliance(equilibrium(arm, BARE, PAPER, gravity=False), arm)
    in_flange = rotate_matrix(in_base, pose(arm, BARE, PAPER).rotation.T)
    np.testing.assert_allclose(np.diag(in_flange)[:3] * 1e6, [along, lateral, in_plane], atol=5e-5)


@BOTH
@pytest.mark.parametrize("moments", [False, True])
def test_compliance_is_the_difference_quotient_of_whole_loaded_equilibria(moments, arm):
    wrenches = kilonewton(moments)
    ours = compliance(equilibrium(arm, MOUNT, POSTURES, wrenches), arm)
    quotient = np.empty_like(ours)
    for k in range(6):
        step = (20.0 if k < 3 else 10.0) * np.eye(6)[k]
        ahead, behind = (equilibrium(arm, MOUNT, POSTURES, wrenches + s * step).pose for s in (1, -1))
        turn = Rotation.from_matrix(ahead.rotation @ np.swapaxes(behind.rotation, -1, -2)).as_rotvec()
        quotient[:, :, k] = np.concatenate([ahead.position - behind.position, turn], -1) / (2 * step[k])
    size = np.sqrt(np.einsum("nii,njj->nij", ours, ours))  # entries of mixed units, each beside its own diagonal
    assert (np.abs(quotient - ours) / size).max() < 1e-6


@BOTH
def test_stiffness_is_symmetric_and_definite_for_forces_and_not_symmetric_for_moments(arm):
    forces = stiffness(equilibrium(arm, MOUNT, POSTURES, kilonewton(False)), arm)
    np.testing.assert_allclose(forces, np.swapaxes(forces, -1, -2), rtol=1e-9, atol=1e-3)
    assert np.all(np.linalg.eigvalsh(forces) > 0)
    moments = stiffness(equilibrium(arm, MOUNT, POSTURES, kilonewton(True)), arm)
    assert np.abs(moments - np.swapaxes(moments, -1, -2)).max((-1, -2)).min() > 1.0


@BOTH
def test_stiffness_is_the_inverse_of_compliance(arm):
    solved = equilibrium(arm, MOUNT, POSTURES, kilonewton(True))
    k = stiffness(solved, arm)
    np.testing.assert_allclose(k @ compliance(solved, arm), np.broadcast_to(np.eye(6), k.shape), atol=1e-7)


def test_without_load_it_is_the_classic_formula():
    solved = equilibrium(ARM, MOUNT, PAPER, gravity=False)
    j = solved.jacobian
    np.testing.assert_allclose(compliance(solved, ARM), j @ np.diag(ARM.joint_compliance) @ j.T, rtol=1e-12, atol=1e-20)


def test_a_push_along_the_arm_softens_it_and_a_pull_stiffens_it():
    stretched = np.radians([0.0, -10.0, 20.0, 0.0, 25.0, 0.0])
    push, none, pull = (
        compliance(equilibrium(ARM, BARE, stretched, [f, 0, 0, 0, 0, 0], gravity=False), ARM)[2, 2]
        for f in (-5000.0, 0.0, 5000.0)
    )
    assert push > none > pull


def test_a_singular_posture_has_a_compliance_but_no_stiffness():
    straight = PAPER * [1, 1, 1, 1, 0, 1]
    solved = equilibrium(ARM, MOUNT, straight, gravity=False)
    assert np.linalg.matrix_rank(compliance(solved, ARM), tol=1e-12) == 5
    assert singularity_measures(ARM, straight)[2] == 0
    with pytest.raises(SingularityError, match="keep axis 5 away from 0"):
        stiffness(solved, ARM)


def test_a_rotated_matrix_keeps_the_energy():
    turn = Rotation.from_rotvec([0.3, -1.0, 0.7]).as_matrix()
    matrix, motion = RNG.normal(size=(6, 6)), RNG.normal(size=6)
    turned = np.concatenate([turn @ motion[:3], turn @ motion[3:]])
    assert turned @ rotate_matrix(matrix, turn) @ turned == pytest.approx(motion @ matrix @ motion)


def test_a_batch_of_stiffnesses_equals_the_single_ones():
    wrenches = kilonewton(True)
    solved = equilibrium(ARM, MOUNT, POSTURES, wrenches)
    single = equilibrium(ARM, MOUNT, POSTURES[7], wrenches[7])
    np.testing.assert_allclose(stiffness(solved, ARM)[7], stiffness(single, ARM), rtol=1e-12)
    assert solved.hessian.shape == (20, 6, 6)
