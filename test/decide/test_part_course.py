"""Directions, distances and features along a pass."""

from __future__ import annotations

import numpy as np
import pytest
from milled_part import CONFIG, HEAD, POCKET, small_cell

from kr270_milling.cell.cell import read_cell
from kr270_milling.decide.part.course import course, deviations


@pytest.fixture(scope="module")
def cell(tmp_path_factory):
    return small_cell(tmp_path_factory.mktemp("course"), POCKET)


@pytest.fixture(scope="module")
def stamps(cell):
    return np.arange(0, cell.target().duration_ns, 500_000)


def test_the_tangent_is_the_direction_of_the_motion_wherever_the_tool_moves(cell, stamps):
    path, target = course(cell, stamps), cell.target()
    velocity = target.sample_velocity(stamps)
    speed = np.linalg.norm(velocity, axis=1)
    moving = speed > 5e-3
    assert moving.sum() > 500
    along = np.sum(velocity[moving] / speed[moving, None] * path.tangent[moving], axis=1)
    assert np.quantile(along, 0.01) > 0.999  # the controller's knots round arcs a little
    np.testing.assert_allclose(np.linalg.norm(path.tangent, axis=1), 1.0, atol=1e-12)


def test_the_tangent_is_there_while_the_tool_rests(cell):
    end = cell.target().duration_ns
    resting = course(cell, np.array([0, end, end + 10**9]))
    np.testing.assert_allclose(np.linalg.norm(resting.tangent, axis=1), 1.0, atol=1e-12)


def test_a_move_along_the_spindle_keeps_the_side_of_the_last_horizontal_move(cell, stamps):
    path = course(cell, stamps)
    upright = np.abs(path.tangent[:, 2]) > 0.999
    assert upright.any()
    changes = np.flatnonzero(np.abs(np.diff(path.heading)) > 1e-9) + 1
    assert not upright[changes].any()


def test_distance_only_grows_and_ends_at_the_length_of_the_path(cell, stamps):
    distance = course(cell, np.append(stamps, cell.target().duration_ns)).distance
    assert np.all(np.diff(distance) >= -1e-12)
    assert distance[-1] == pytest.approx(cell.timed_path.toolpath.length, abs=1e-12)


def test_the_parts_of_a_deviation_on_a_horizontal_path_make_up_its_length(cell, stamps):
    path = course(cell, stamps)
    error = np.random.default_rng(1).normal(size=(stamps.size, 3))
    parts = deviations(path, error)
    level = np.abs(path.tangent[:, 2]) < 1e-12
    np.testing.assert_allclose(np.linalg.norm(parts[level], axis=1), np.linalg.norm(error[level], axis=1), rtol=1e-12)


def test_normal_deviation_is_positive_to_the_left_of_the_path(tmp_path):
    cell = small_cell(tmp_path, HEAD + "G0 X-28 Y0 Z-1\nG1 X20 F3000\nG1 X20 Y28\nG0 Z2\n")
    stamps = np.linspace(0, cell.target().duration_ns, 200).astype(np.int64)
    path = course(cell, stamps)
    shifted = deviations(path, np.tile([-1.0, 2.0, 3.0], (stamps.size, 1)))
    flat = np.abs(path.tangent[:, 2]) < 0.5
    along_x, along_y = flat & (path.tangent[:, 0] > 0.9), flat & (path.tangent[:, 1] > 0.9)
    np.testing.assert_allclose(shifted[along_x], np.tile([-1, 2, 3], (along_x.sum(), 1)), atol=1e-12)
    np.testing.assert_allclose(shifted[along_y], np.tile([2, 1, 3], (along_y.sum(), 1)), atol=1e-12)


def test_a_straight_cut_without_a_file_is_one_feature_along_x():
    cell = read_cell(CONFIG / "paper.yaml")
    path = course(cell, np.array([0, 10**9, 2 * 10**9]))
    assert path.features == ("straight cut",)
    np.testing.assert_allclose(path.tangent, np.tile([1.0, 0, 0], (3, 1)), atol=1e-12)
    assert path.distance[1] == pytest.approx(4.0 / 60)  # 4 m/min for 1 s


def test_features_are_those_of_the_programme(cell, stamps):
    path = course(cell, stamps)
    assert path.features == ("unnamed", "side", "ring")
    assert set(np.unique(path.feature)) <= {0, 1, 2} and {1, 2} <= set(np.unique(path.feature))
