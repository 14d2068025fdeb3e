"""Noise and repeatability of a plant: their statistics."""

from __future__ import annotations

import numpy as np
import pytest

from kr270_milling.base.record import find_file
from kr270_milling.cell.cell import read_cell
from kr270_milling.cell.jobs import simulate
from kr270_milling.cell.plant import Plant
from kr270_milling.physics.motion.imperfections import Imperfections

UM = 1e-6
SHORT = ("path.length_mm=12", "stock.grid_step_um=80", "exchange.micro_step_deg=3")


@pytest.fixture(scope="module")
def cell():
    return read_cell(find_file("paper.yaml"), SHORT)


def test_repeatability_is_that_of_a_data_sheet():
    """ISO 9283: mean distance from the barycentre of many passes + 3 standard deviations of that distance."""
    how = Imperfections(repeatability=60 * UM)
    shifts = np.array([how.shift(n) for n in range(4000)])
    distance = np.linalg.norm(shifts - shifts.mean(axis=0), axis=1)
    assert distance.mean() + 3 * distance.std() == pytest.approx(60 * UM, rel=0.03)


def test_noise_and_repeatability_of_a_pass_come_from_seed_and_number():
    how, zero = Imperfections(5 * UM, 60 * UM, seed=3), np.zeros((1000, 3))
    assert np.array_equal(how.measured(zero, 2), how.measured(zero, 2)) and np.array_equal(how.shift(2), how.shift(2))
    assert not np.any(how.measured(zero, 2) == how.measured(zero, 3)) and not np.any(how.shift(2) == how.shift(3))
    other = how.replace(seed=4)
    assert not np.any(other.shift(2) == how.shift(2))
    assert how.measured(zero, 2).std() == pytest.approx(5 * UM, rel=0.05)
    assert abs(np.corrcoef(how.measured(zero, 1)[:, 0], how.measured(zero, 2)[:, 0])[0, 1]) < 0.15


def test_a_plant_without_imperfections_is_its_cell(cell):
    plain, plant = simulate(cell), simulate(cell, plant=Plant(cell, cell))
    assert np.array_equal(plain.result.actual, plant.result.actual) and plain.scores == plant.scores
    assert np.array_equal(plant.record.position, plant.result.tool) and plant.record.noise == 0.0


def test_the_tracker_is_noisy_and_the_part_is_not(cell):
    clean = simulate(cell)
    noisy = simulate(cell, plant=Plant(cell, cell, Imperfections(pose_noise=20 * UM)))
    assert np.array_equal(noisy.result.actual, clean.result.actual) and noisy.scores == clean.scores
    assert np.std(noisy.record.position - noisy.result.tool) == pytest.approx(20 * UM, rel=0.1)


def test_a_pass_that_lies_beside_the_commanded_one_is_cut_there(cell):
    plant = Plant(cell, cell, Imperfections(repeatability=60 * UM))
    shift = plant.cell.imperfections.shift(0)
    ran = simulate(cell, plant=plant).result
    plain = simulate(cell).result
    assert ran.actual - plain.actual == pytest.approx(np.broadcast_to(shift, ran.actual.shape), abs=0.05 * 60 * UM)
    assert np.array_equal(ran.target, plain.target)


def test_the_path_is_the_models_and_the_arm_is_the_plants(cell):
    other = cell.replace(path=cell.path.replace(length=0.03), dynamics=cell.dynamics.replace(damping_ratio=0.04))
    plant = Plant(cell, other)
    assert plant.cell.path is cell.path and plant.cell.dynamics.damping_ratio == 0.04
    assert simulate(cell, plant=plant).result.time_ns[-1] == simulate(cell).result.time_ns[-1]
