"""Modes of the arm in workpiece axes, from its elastostatics and mass."""

from __future__ import annotations

import numpy as np
import pytest

from kr270_milling.base.record import find_file
from kr270_milling.cell.cell import read_cell
from kr270_milling.physics.motion.arm_model import Dynamics, arm_model, modal_models
from kr270_milling.physics.robot import cartesian_mass, compliance, equilibrium, mode_frequencies

PAPER = read_cell(find_file("paper.yaml"))
ZETA = 0.18


def flexibility(model):
    """Static deflection (6, 6) per wrench that the model stands for."""
    springs = model.shape @ np.diag(model.frequency**-2.0) @ model.shape.T
    return model.output @ springs @ model.force + model.feedthrough


@pytest.mark.parametrize("mass_model", ["lumped", "consistent"])
@pytest.mark.parametrize("gravity", [True, False])
def test_the_frequencies_are_those_of_the_arm_in_any_axes(mass_model, gravity):
    joints = PAPER.joints(PAPER.target())[:1]
    dynamics = Dynamics(mass_model, ZETA, gravity)
    (model,) = modal_models(PAPER.arm, PAPER.mount, dynamics, PAPER.workpiece.pose, joints)
    loaded = equilibrium(PAPER.arm, PAPER.mount, joints, None, gravity)
    mass = cartesian_mass(PAPER.arm, PAPER.mount, joints, mass_model)
    expected = mode_frequencies(compliance(loaded, PAPER.arm), mass)[0]
    np.testing.assert_allclose(model.frequency / (2 * np.pi), expected, rtol=1e-7)


def test_the_lumped_arm_is_condensed_and_the_consistent_one_is_not():
    joints = PAPER.joints(PAPER.target())[:1]
    for name, inertial in (("lumped", [0, 1, 2]), ("consistent", [0, 1, 2, 3, 4, 5])):
        (model,) = modal_models(PAPER.arm, PAPER.mount, Dynamics(name, ZETA), PAPER.workpiece.pose, joints)
        assert model.inertial.tolist() == inertial


@pytest.mark.parametrize("mass_model", ["lumped", "consistent"])
def test_the_static_limit_is_the_compliance_of_the_loaded_arm_in_workpiece_axes(mass_model):
    joints = PAPER.joints(PAPER.target())[:1]
    (model,) = modal_models(PAPER.arm, PAPER.mount, Dynamics(mass_model, ZETA), PAPER.workpiece.pose, joints)
    turn = np.kron(np.eye(2), PAPER.workpiece.pose.rotation)
    expected = turn.T @ compliance(equilibrium(PAPER.arm, PAPER.mount, joints), PAPER.arm)[0] @ turn
    np.testing.assert_allclose(flexibility(model), expected, rtol=1e-8, atol=1e-14)


def test_across_the_feed_the_papers_arm_gives_way_by_0_717_um_per_newton():
    """facts.md; with the stiffness matrix sliced to translations it would be 0.37."""
    assert flexibility(PAPER.modal_model)[1, 1] == pytest.approx(0.7168e-6, rel=2e-3)
    sliced = np.linalg.inv(np.linalg.inv(flexibility(PAPER.modal_model))[:3, :3])
    assert sliced[1, 1] < 0.55 * 0.7168e-6


def test_a_path_of_postures_gives_one_set_of_matrices_each():
    joints = PAPER.joints(PAPER.target())[::8]
    models = modal_models(PAPER.arm, PAPER.mount, PAPER.dynamics, PAPER.workpiece.pose, joints)
    stacked = arm_model(models, ZETA, 5e-4, 10.0)
    assert stacked.transition.shape == (4, 6, 6) and stacked.order == 6
    for k, model in enumerate(models):
        alone = arm_model([model], ZETA, 5e-4)
        np.testing.assert_array_equal(stacked.transition[k], alone.transition[0])
        np.testing.assert_array_equal(stacked.feedthrough[k], alone.feedthrough[0])
