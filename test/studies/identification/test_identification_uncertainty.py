"""Identified intervals reach the plants of the verdict."""

from __future__ import annotations

import numpy as np
import pytest

from kr270_milling.base.errors import ParameterError
from kr270_milling.base.parameter_file import find_file
from kr270_milling.cell.cell import read_cell
from kr270_milling.cell.plant import perturbed

SPREADS = [0.01, 0.02, 0.04, 0.08, 0.16, 0.32]


def factors(*settings: str) -> np.ndarray:
    """Of the compliances and of the coefficients K_tc, K_ac, K_ae of 400 plants, (400, 9)."""
    cell = read_cell(find_file("test_piece.yaml"), ["cutting.linear_edge.axial_edge_n_per_mm=-3", *settings])
    rng = np.random.default_rng(6)
    return np.array([known(perturbed(cell, rng)) for _ in range(400)]) / known(cell)


def known(cell) -> list[float]:
    law = cell.cutting.linear_edge
    return [*cell.arm.joint_compliance, law.tangential_cutting, law.axial_cutting, law.axial_edge]


def test_each_joint_and_each_coefficient_scatters_by_its_own_spread():
    """Log-normal of relative deviation v: ln has the deviation sqrt(ln(1 + v^2)); 400 samples know it to 3.5 %."""
    joints = f"uncertainty.joint_compliances={SPREADS}"
    for given, axial in (([0.05, 0.1, 0.1, 0.1], [0.15, 0.15]), ([0.05, 0.1, 0.1, 0.1, 0.2, 0.3], [0.2, 0.3])):
        drawn = np.log(factors(joints, f"uncertainty.force_coefficients={given}")).std(0)
        assert drawn == pytest.approx(np.sqrt(np.log1p(np.square([*SPREADS, 0.05, *axial]))), rel=0.12)


def test_without_them_the_common_spread_holds():
    assert np.log(factors()).std(0) == pytest.approx(np.full(9, np.sqrt(np.log1p(0.15**2))), rel=0.12)


def test_lists_of_another_length_are_refused():
    with pytest.raises(ParameterError, match="empty or one number"):
        factors("uncertainty.force_coefficients=[0.1]")
