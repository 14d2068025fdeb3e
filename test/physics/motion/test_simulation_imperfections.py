"""Noise and repeatability of a plant: their statistics."""

from __future__ import annotations

import numpy as np
import pytest

from kr270_milling.base.record import find_file
from kr270_milling.cell.cell import read_cell
from kr270_milling.cell.jobs import compensated, simulate
from kr270_milling.cell.plant import Plant
from kr270_milling.path.trajectory import TOOL_DOWN, Trajectory
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


def test_the_compensator_receives_the_wrench_of_a_sensor(cell):
    """Noise while the tool cuts, its moments by a lever of 0.1 m; another one in each pass; the part is not noisy."""
    records = {
        how: simulate(cell, plant=Plant(cell, cell, Imperfections(wrench=how))) for how in ("exact", "noisy", "none")
    }
    true = records["exact"].record.wrench
    assert np.array_equal(true, records["exact"].result.wrench) and records["none"].record.wrench is None
    sensed, cuts = records["noisy"].record.wrench, true.any(axis=1)
    assert not np.any(sensed[~cuts]) and cuts.sum() > 100
    assert (sensed - true)[cuts].std(axis=0) == pytest.approx([2.0, 2.0, 2.0, 0.2, 0.2, 0.2], rel=0.2)
    assert np.array_equal(records["noisy"].result.actual, records["exact"].result.actual)
    how = Imperfections()
    assert not np.any(how.sensed(true, 0)[cuts] == how.sensed(true, 1)[cuts])


@pytest.mark.parametrize("frequency, delay", [(10.0, 0.0), (40.0, 0.012), (0.0, 0.004)])
def test_motors_follow_a_step_of_the_correction_as_a_second_order_after_a_dead_time(frequency, delay):
    """y = 1 - exp(-z w t) (cos(w_d t) + z w / w_d sin(w_d t)), z = 0.7; the programmed path itself is not late."""
    time_ns = np.array([0, 100, 101, 1000]) * 1_000_000
    target = Trajectory(time_ns, np.outer(time_ns * 1e-9, [0.05, 0.0, 0.0]), TOOL_DOWN)
    step = np.outer([0.0, 0.0, 1.0, 1.0], [0.0, 100 * UM, 0.0])
    how = Imperfections(servo_frequency=frequency, servo_delay=delay)
    course = how.lagged(target.with_position(target.position + step), target)
    stamps = np.arange(0, 1000, 3) * 1_000_000
    t = np.maximum(stamps * 1e-9 - 0.1005 - delay, 0.0)
    w, z = 2 * np.pi * frequency, 0.7
    d = w * np.sqrt(1 - z * z)
    expected = 1 - np.exp(-z * w * t) * (np.cos(d * t) + z * w / d * np.sin(d * t)) if frequency else np.sign(t)
    moved = course.sample(stamps) - target.sample(stamps)
    settled = np.abs(stamps * 1e-9 - 0.1005 - delay) > 0.001
    assert moved[settled, 1] == pytest.approx(100 * UM * expected[settled], abs=0.6 * UM)
    assert np.abs(moved[:, [0, 2]]).max() < 1e-15 and how.lagged(target, target) is target


def test_a_servo_lag_spoils_what_inverse_plans_and_learned_repairs_a_part(cell):
    """The lag is in no model. The pass with the lag of 10 Hz, against that without."""
    slow = Plant(cell, cell, Imperfections(servo_frequency=10.0, wrench="exact"))
    original = simulate(cell, plant=slow)
    left = {name: compensated(cell, original, name, plant=slow).scores.max_deviation for name in ("inverse", "learned")}
    perfect = compensated(cell, simulate(cell), "inverse").scores.max_deviation
    assert left["inverse"] > 2 * perfect and left["learned"] <= left["inverse"] < original.scores.max_deviation
