"""Identified intervals reach the plants of the verdict."""

from __future__ import annotations

import numpy as np
import pytest

from kr270_milling.base.errors import ParameterError
from kr270_milling.base.parameter_file import find_file
from kr270_milling.cell.cell import read_cell
from kr270_milling.decision.samples import perturbed

SPREADS = [0.01, 0.02, 0.04, 0.08, 0.16, 0.32]


def factors(*settings: str) -> np.ndarray:
    """Of the compliances and tangential coefficients of 400 plants, (400, 7)."""
    cell, rng = read_cell(find_file("test_piece.yaml"), settings), np.random.default_rng(6)
    plants = [perturbed(cell, rng) for _ in range(400)]
    rows = [[*plant.arm.joint_compliance, plant.cutting.linear_edge.tangential_cutting] for plant in plants]
    return np.array(rows) / [*cell.arm.joint_compliance, cell.cutting.linear_edge.tangential_cutting]


def test_each_joint_and_each_coefficient_scatters_by_its_own_spread():
    """Log-normal of relative deviation v: ln has the deviation sqrt(ln(1 + v^2)); 400 samples know it to 3.5 %."""
    joints = f"uncertainty.joint_compliances={SPREADS}"
    drawn = np.log(factors(joints, "uncertainty.force_coefficients=[0.05, 0.1, 0.1, 0.1]")).std(0)
    assert drawn == pytest.approx(np.sqrt(np.log1p(np.square([*SPREADS, 0.05]))), rel=0.12)


def test_without_them_the_common_spread_holds():
    assert np.log(factors()).std(0) == pytest.approx(np.full(7, np.sqrt(np.log1p(0.15**2))), rel=0.12)


def test_lists_of_another_length_are_refused():
    with pytest.raises(ParameterError, match="empty or one number"):
        factors("uncertainty.force_coefficients=[0.1]")
