"""Measured modes against the arm whose modes they are, closed forms, and what a file may say of them."""

from __future__ import annotations

import numpy as np
import pytest

from kr270_milling.base.errors import ConfigError
from kr270_milling.base.parameter_file import find_file
from kr270_milling.cell.cell import read_cell
from kr270_milling.cell.cell_file import cell_text
from kr270_milling.cell.jobs import simulate
from kr270_milling.path.trajectory import TOOL_DOWN, Trajectory
from kr270_milling.physics.motion.arm_model import MeasuredModes, arm_model, measured_model
from kr270_milling.physics.motion.exchange import Clock
from kr270_milling.physics.motion.milling_pass import CompliantArm

SHORT = "path.length_mm=14.4"
GROUPS = """/**:
  ros__parameters:
    includes: ["paper.yaml"]
    path: {length_mm: 14.4}
    dynamics:
      modes:
        - {frequency_hz: 7.07, damping_ratio: 0.037, shape: [0.01, 0.05, 0.0, 0.0, 0.0, 0.02]}
        - {frequency_hz: 10.3, damping_ratio: 0.022, shape: [0.04, -0.01, 0.02, 0.0, 0.01, 0.0]}
"""


def as_measured(model, damping_ratio: float) -> MeasuredModes:
    """The modes of a model as an experiment without errors gives them."""
    shapes = (model.output @ model.shape).T
    ratios = np.full(model.frequency.size, damping_ratio)
    return MeasuredModes(model.frequency / (2 * np.pi), ratios, shapes.ravel())


def test_the_modes_of_an_arm_in_the_place_of_the_arm_give_the_same_pass():
    cell = read_cell(find_file("paper.yaml"), (SHORT, "dynamics.mass_model=rigid", "dynamics.reference_inertia=true"))
    target = cell.target()
    bent = target.with_position(target.position + np.outer(np.arange(len(target)) % 2 * 2e-5, [1.0, 1.0, 0.5]))
    same = cell.replace(dynamics=cell.dynamics.replace(modes=as_measured(cell.modal_model, 0.182)))
    exact, found = (simulate(c, bent).result for c in (cell, same))
    np.testing.assert_allclose(found.deflection, exact.deflection, atol=1e-9 * np.abs(exact.deflection).max())
    assert found.volume.sum() > 0.0


def test_one_mode_gives_way_by_the_square_of_its_shape_over_that_of_its_frequency():
    shape = np.array([0.01, 0.05, 0.02, 0.3, 0.0, 0.1])
    model = measured_model(MeasuredModes(np.array([7.0]), np.array([0.5]), shape))
    arm = CompliantArm(arm_model([model], 0.182, 0.01))
    wrench = np.array([100.0, -50.0, 30.0, 4.0, -7.0, 5.0])
    for _ in range(400):
        deflection = arm.correct(wrench)
    np.testing.assert_allclose(deflection, shape * (shape @ wrench) / (14 * np.pi) ** 2, rtol=1e-9)


def test_each_mode_rings_down_with_its_own_ratio():
    model = measured_model(MeasuredModes(np.array([5.0, 20.0]), np.array([0.1, 0.02]), np.eye(6)[:2].ravel()))
    arm = CompliantArm(arm_model([model], 0.5, 1e-3))
    arm.state[:2] = 1e-3
    for _ in range(200):
        deflection = arm.correct(np.zeros(6))
    for k, (f, zeta) in enumerate(((5.0, 0.1), (20.0, 0.02))):
        w = 2 * np.pi * f
        damped = w * np.sqrt(1 - zeta**2)
        turned = np.cos(damped * 0.2) + zeta * w / damped * np.sin(damped * 0.2)
        assert deflection[k] == pytest.approx(1e-3 * np.exp(-zeta * w * 0.2) * turned, rel=1e-9)


def test_a_quick_jump_of_the_reference_leaves_the_tool_where_modes_move_it_and_takes_it_along_where_none_does():
    shapes = np.array([[0.05, 0.01, 0.0, 0.0, 0.05, 0.02], [-0.01, 0.04, 0.0, 0.02, 0.0, 0.0]])
    model = measured_model(MeasuredModes(np.array([7.0, 9.0]), np.array([0.03, 0.03]), shapes.ravel()))
    period = 1e-6
    jump = Trajectory(np.array([0, 1000, 100_000]), np.array([[0, 0, 0], [1e-3, 2e-3, 3e-3], [1e-3, 2e-3, 3e-3]]),
                      TOOL_DOWN)  # fmt: skip
    pushed = arm_model([model], 0.1, period, 1.0, True, np.zeros(6))
    arm = CompliantArm(pushed, pushed.push(jump, Clock(period, 1).stamp(np.arange(3))))
    arm.correct(np.zeros(6))
    tool = np.array([1e-3, 2e-3, 3e-3]) + arm.correct(np.zeros(6))[:3]
    np.testing.assert_allclose(tool, [0.0, 0.0, 3e-3], atol=2e-6)


def test_a_list_of_groups_is_read_and_handed_to_a_node_as_a_group_of_lists(tmp_path):
    (tmp_path / "cell.yaml").write_text(GROUPS)
    cell = read_cell(tmp_path / "cell.yaml")
    np.testing.assert_allclose(cell.dynamics.modes.frequency, [7.07, 10.3])
    np.testing.assert_allclose(cell.dynamics.modes.shape[6:8], [0.04, -0.01])
    (tmp_path / "node.yaml").write_text(cell_text(cell))
    again = read_cell(tmp_path / "node.yaml").dynamics.modes
    np.testing.assert_array_equal(again.shape, cell.dynamics.modes.shape)
    assert simulate(cell).result.wrench.any()


@pytest.mark.parametrize(
    "old, new, said",
    [
        ("0.0, 0.0, 0.02]", "0.0, 0.02]", "the same keys in every group"),
        ("frequency_hz: 10.3, ", "", "the same keys in every group"),
        ("frequency_hz: 10.3", "frequency_hz: 0.0", "above 0"),
        ("[0.04, -0.01, 0.02, 0.0, 0.01, 0.0]", "[0.02, 0.1, 0.0, 0.0, 0.0, 0.04]", "none is a combination"),
        ("[0.04,", "[.nan,", "finite"),
        ("dynamics:", "dynamics:\n      follow_pose: true", "one posture"),
    ],
)
def test_modes_that_cannot_be_are_refused_with_the_key(tmp_path, old, new, said):
    assert old in GROUPS
    (tmp_path / "cell.yaml").write_text(GROUPS.replace(old, new))
    with pytest.raises(ConfigError, match=said):
        read_cell(tmp_path / "cell.yaml")


def test_lists_that_do_not_fit_each_other_are_refused():
    for key, value in (("damping_ratio", "[0.1, 0.2]"), ("shape", "[1.0, 2.0]")):
        texts = {
            "frequency_hz": "[7.0]",
            "damping_ratio": "[0.1]",
            "shape": "[0.0, 1.0, 0.0, 0.0, 0.0, 0.0]",
            key: value,
        }
        with pytest.raises(ConfigError, match="for 1 modes"):
            read_cell(find_file("paper.yaml"), [f"dynamics.modes.{k}={v}" for k, v in texts.items()])
