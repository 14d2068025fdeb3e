"""Orders of convergence of the sweep."""

from __future__ import annotations

import numpy as np
import pytest
from cuttings import ALUMINIUM, PAPER_LAW
from slot import convergence, fitted_order, slot_chip, slot_errors, slot_force

from kr270_milling.physics.cutting import Tool

TOOL = Tool(diameter=20e-3, teeth=4, spindle_speed=837.0)
FEED = 0.125e-3


def test_exact_chip_tends_to_the_cosine_for_small_feeds():
    phi = np.radians([-80.0, -30.0, 0.0, 45.0, 85.0])
    for feed, slack in ((1e-6, 1e-3), (1e-8, 1e-5)):
        assert slot_chip(TOOL, feed, phi) / feed == pytest.approx(np.cos(phi), abs=slack)
    assert not slot_chip(TOOL, FEED, np.radians([100.0, 180.0, -120.0])).any()


def test_exact_chips_of_a_revolution_add_up_to_the_area_fed():
    """2 R f of slot a revolution, but for the scallops between the teeth's marks on both walls."""
    phi = np.linspace(-np.pi, np.pi, 200_001)[:-1]
    for feed in (0.02e-3, 0.125e-3, 0.5e-3):
        way = 10e-3 - 4 * feed / (2 * np.pi) * np.sin(phi)  # of a tooth's tip a radian
        area = 4 * np.sum(way * slot_chip(TOOL, feed, phi)) * 2 * np.pi / phi.size
        scallops = 2 * 4 * feed**3 / (24 * 10e-3)
        assert area == pytest.approx(2 * 10e-3 * 4 * feed - scallops, rel=1e-6)


def test_exact_slot_force_has_the_mean_that_is_known():
    phi = np.linspace(0, 2 * np.pi, 3600, endpoint=False)
    assert slot_force(TOOL, PAPER_LAW, FEED, phi).mean(0) == pytest.approx([-44.39, 147.98], rel=1e-2)
    wide = Tool(diameter=200e-3, teeth=4, spindle_speed=837.0)
    assert slot_force(wide, PAPER_LAW, FEED, phi).mean(0) == pytest.approx([-44.39, 147.98], rel=1e-3)


def test_mean_force_at_the_default_steps_is_right_to_a_few_parts_in_ten_thousand():
    for cutting in (PAPER_LAW, ALUMINIUM):
        assert slot_errors(TOOL, cutting, FEED, 10e-6, np.radians(1.0))[0] < 3e-4


def test_fitted_order_of_a_power_is_its_exponent():
    assert fitted_order([1.0, 0.5, 0.25], [3.0, 3 / 2**1.5, 3 / 4**1.5]) == pytest.approx(1.5)


@pytest.mark.parametrize("cutting", [PAPER_LAW, ALUMINIUM], ids=["fractional", "linear_edge"])
def test_sweep_converges_with_order_one_and_a_half_in_the_grid_and_two_in_the_angle(cutting):
    found = convergence(TOOL, cutting)
    assert 1.2 < found["grid_order"] < 2.0  # nodes near the border of a sector: noise as ds^1.5
    assert 1.6 < found["angle_order"] < 2.4  # force at mid-angle
    assert max(found["mean_force_error"]) < 2e-3
