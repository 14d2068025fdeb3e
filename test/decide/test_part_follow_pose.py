"""Stiffness and mass that follow the posture: interpolation against recomputing them at each exchange."""

from __future__ import annotations

import numpy as np
import pytest
from milled_part import HEAD, small_cell

from kr270_milling.physics.motion.arm_model import modal_models
from kr270_milling.physics.motion.dynamics import discretise

#: 200 mm away from the arm and 100 mm across, through the stock
FAR = HEAD + "(far)\nG0 X-100 Y-50 Z-1\nG1 X100 Y50 F3000\n"


def static(transition, held, output, feedthrough) -> np.ndarray:
    """Deflection under a wrench that stays, (6, 6)."""
    return output @ np.linalg.solve(np.eye(len(transition)) - transition, held) + feedthrough


def lowest(transition) -> float:
    """Angle of the slowest mode in one period [rad]."""
    return float(np.abs(np.angle(np.linalg.eigvals(transition))).min())


def interpolation_error(folder, spacing_mm: float) -> tuple[float, float]:
    """Largest relative error of translational compliance and of the lowest frequency, over exchanges along FAR."""
    cell = small_cell(folder, FAR, "dynamics.follow_pose=true", f"dynamics.posture_spacing_mm={spacing_mm}")
    target = cell.target()
    model = cell.arm_model(target)
    steps = np.arange(0, cell.clock.steps(target.duration_ns), 37)  # exchanges; 37 meets every place between postures
    stamps = cell.clock.stamp(steps)
    joints = cell.joints_at(target.sample(stamps), target.sample_orientation(stamps))
    exact = modal_models(cell.arm, cell.mount, cell.dynamics, cell.workpiece.pose, joints)
    worst = np.zeros(2)
    for step, mode in zip(steps, exact, strict=True):
        k, part = divmod(step / model.steps_per_knot, 1.0)
        arrays = [a[int(k)] + part * (a[int(k) + 1] - a[int(k)]) for a in model.arrays[:4]]
        fresh = discretise(mode, cell.dynamics.damping_ratio, cell.clock.period)
        soft, right = static(*arrays)[:3, :3], static(*fresh)[:3, :3]
        wrong = [np.abs(soft - right).max() / np.abs(right).max(), abs(lowest(arrays[0]) / lowest(fresh[0]) - 1)]
        worst = np.maximum(worst, wrong)
    return worst[0], worst[1]


def test_postures_5_mm_apart_give_stiffness_and_frequency_to_1e_3(tmp_path):
    # the shipped spacing: far below the few per cent to which joint compliances are known
    compliance, frequency = interpolation_error(tmp_path, 5.0)
    assert compliance < 1e-3 and frequency < 1e-3


def test_the_error_falls_with_the_square_of_the_spacing(tmp_path):
    coarse, fine = interpolation_error(tmp_path, 40.0), interpolation_error(tmp_path, 20.0)
    for a, b in zip(coarse, fine, strict=True):
        assert a / b == pytest.approx(4.0, rel=0.4)


def test_the_stiffness_of_the_start_alone_is_wrong_by_more_than_a_tenth_at_the_end(tmp_path):
    cell = small_cell(tmp_path, FAR)
    target = cell.target()
    ends = cell.joints_at(target.position[[0, -1]], target.quaternion[[0, -1]])
    first, last = (
        static(*discretise(m, 0.04, 5e-4))[:3, :3]
        for m in modal_models(cell.arm, cell.mount, cell.dynamics, cell.workpiece.pose, ends)
    )
    assert np.abs(first - last).max() > 0.1 * np.abs(last).max()
