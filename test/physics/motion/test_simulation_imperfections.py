"""Noise, repeatability and backlash of a plant: their statistics, and the play operator's own laws."""

from __future__ import annotations

import numpy as np
import pytest

from kr270_milling.base.record import find_file
from kr270_milling.cell.cell import read_cell
from kr270_milling.cell.jobs import simulate
from kr270_milling.cell.plant import Plant, imperfect_course
from kr270_milling.physics.motion.imperfections import Imperfections, play

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


def test_a_joint_behind_its_play_follows_at_half_of_it_and_rests_while_the_motor_crosses_it():
    motor = np.concatenate([np.linspace(0, 1, 101), np.linspace(1, 0, 101)[1:]])[:, None] * np.ones(6)
    width = np.array([0.1, 0.2, 0.0, 0.1, 0.1, 0.1])
    stands = play(motor, width)
    up, down = stands[:101], stands[101:]
    assert up[20:] == pytest.approx(motor[20:101] - width / 2) and np.array_equal(stands[:, 2], motor[:, 2])
    crossing = np.round(width / 0.01).astype(int)
    for axis, steps in enumerate(crossing.tolist()):
        assert np.all(down[: max(0, steps - 1), axis] == up[-1, axis])
        assert down[steps:, axis] == pytest.approx(motor[101 + steps :, axis] + width[axis] / 2)


def test_play_does_not_know_how_fast_it_is_run_through():
    motor = np.cumsum(np.random.default_rng(0).normal(size=(40, 6)), axis=0)
    slow = np.stack([np.interp(np.arange(0, 39.01, 0.25), np.arange(40), m) for m in motor.T], axis=1)
    width = np.full(6, 0.7)
    assert play(slow, width)[::4][1:] == pytest.approx(play(motor, width)[1:])


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


def test_backlash_shows_where_a_joint_turns_back_and_is_as_large_as_its_lever(cell):
    """Out and back across the arm: on the way back the tool stands beside the reference by the play of the joints."""
    target = cell.target()
    away = np.minimum(target.time_ns, target.duration_ns - target.time_ns)
    there_and_back = target.with_position(target.position[:1] + np.outer(away * 1e-9, [0.0, 0.05, 0.0]))
    width = np.radians([0.01, 0, 0, 0, 0, 0])
    plant = cell.replace(imperfections=Imperfections(backlash=width))
    course = imperfect_course(plant, there_and_back, 0)
    off = course.position - there_and_back.sample(course.time_ns)
    middle = len(off) // 2
    assert np.abs(off[: middle - 2]).max() < 1e-9  # it was touched off on that side
    lever = np.hypot(*(cell.workpiece.pose.apply(there_and_back.position[0]))[:2])  # of axis 1, about z of the base
    assert np.linalg.norm(off[-1]) == pytest.approx(width[0] * lever, rel=0.02)


def test_the_path_is_the_models_and_the_arm_is_the_plants(cell):
    other = cell.replace(path=cell.path.replace(length=0.03), dynamics=cell.dynamics.replace(damping_ratio=0.04))
    plant = Plant(cell, other)
    assert plant.cell.path is cell.path and plant.cell.dynamics.damping_ratio == 0.04
    assert simulate(cell, plant=plant).result.time_ns[-1] == simulate(cell).result.time_ns[-1]
