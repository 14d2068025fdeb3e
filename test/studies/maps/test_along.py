"""The turn of the tool along a path: known optima, the limits, better than any turn that stays the same."""

from __future__ import annotations

import json
from types import SimpleNamespace

import numpy as np
import pytest

from kr270_milling.base.record import find_file
from kr270_milling.cell.cell import read_cell
from kr270_milling.cli import main
from kr270_milling.physics.robot.analysis import read_arm
from kr270_milling.studies.maps.along import NoWayError, Turns, constant_way, find_way
from kr270_milling.studies.maps.placements import PathPlaces

GRID = np.radians(np.arange(-90.0, 91.0, 10.0))
ARM, _ = read_arm(find_file("kr270_2.yaml"))


class Known(Turns):
    """Joint 6 turns with the tool, and the error is the distance from a wish [rad] at each place."""

    def at(self, turn):
        q = np.zeros((*turn.shape, 8, 6))
        q[..., 1:3] = np.radians([-80.0, 100.0])
        q[..., 5] = turn[..., None]
        error = np.abs(turn - self.course.wish[:, None])[..., None] * np.where(np.arange(8) == 2, 1.0, 2.0)
        return q, error


def known(wish: np.ndarray, weight: float, step: float = 1.0) -> Known:
    course = SimpleNamespace(wish=wish, position=np.zeros((len(wish), 3)))
    return Known(SimpleNamespace(arm=ARM), course, step, weight)


def test_a_wish_and_a_price_of_turning_have_a_closed_solution():
    """d/dpsi of sum (psi_k - a_k)^2 + (w / dt)^2 sum (psi_k+1 - psi_k)^2 = 0 is a linear system."""
    wish = np.sin(np.linspace(0.0, 6.0, 40)) + 0.3
    matrix = np.eye(40)
    for k in range(39):
        matrix[k : k + 2, k : k + 2] += 4.0 * np.array([[1.0, -1.0], [-1.0, 1.0]])
    exact = np.linalg.solve(matrix, wish)
    way = find_way(known(wish, 2.0), GRID)
    assert way.branch == 2  # the others have twice the error
    assert way.turn == pytest.approx(exact, abs=2e-3)
    value = np.mean((exact - wish) ** 2) + 4.0 * np.sum(np.diff(exact) ** 2) / 40
    assert way.value**2 == pytest.approx(value, rel=1e-5)


def test_a_jump_is_taken_as_fast_as_the_joint_turns():
    """A wish that jumps by 0.8 rad in the middle is left and met on one straight line, half on each side."""
    way = find_way(known(np.where(np.arange(41) < 20, 0.0, 0.8), 1e-6, 0.05), GRID)
    room = ARM.joint_speed_limit[5] * 0.05
    exact = np.clip(0.4 + room * (np.arange(41) - 19.5), 0.0, 0.8)
    assert np.abs(np.diff(way.turn)).max() <= room * (1 + 1e-9)
    assert np.sum((way.turn - exact) ** 2) < 0.02 * np.sum((np.where(np.arange(41) < 20, 0.0, 0.8) - exact) ** 2)


def test_a_whole_turn_has_no_seam():
    """A wish that runs through 180 deg is followed on the way that is shorter."""
    wish = np.radians(np.linspace(150.0, 210.0, 60))

    class Round(Known):
        def at(self, turn):
            q, _ = super().at(turn)
            q[..., 5] = (turn[..., None] + np.pi) % (2 * np.pi) - np.pi
            away = (turn - self.course.wish[:, None] + np.pi) % (2 * np.pi) - np.pi
            return q, np.abs(away)[..., None] * np.ones(8)

    course = SimpleNamespace(wish=wish, position=np.zeros((60, 3)))
    way = find_way(Round(SimpleNamespace(arm=ARM), course, 1.0, 1e-3), np.radians(np.arange(-180.0, 181.0, 10.0)))
    assert way.value < 2e-3
    assert np.ptp(way.turn) == pytest.approx(np.ptp(wish), abs=0.02)
    assert np.abs(np.diff(way.q[:, 5])).max() < 0.1  # joint 6 has room for it and makes no jump


@pytest.fixture(scope="module")
def across() -> Turns:
    """A cut of 1.2 m across the front of the arm in 24 s, the spindle across axis 6."""
    cell = read_cell(find_file("test_piece.yaml"))
    y = np.linspace(-0.6, 0.6, 49)
    course = PathPlaces(np.stack([0 * y, y, 0 * y], 1), np.tile(np.diag([1.0, -1.0, -1.0]), (49, 1, 1)),
                    np.tile([0.0, 1.0, 0.0], (49, 1)), np.tile([150.0, -40.0, -20.0], (49, 1)))  # fmt: skip
    return Turns(cell, course, 0.5, np.degrees(0.05e-6))


def test_no_turn_that_stays_the_same_is_better_and_the_joints_keep_to_their_limits(across):
    grid = np.radians(np.arange(-180.0, 181.0, 10.0))
    way, arm = find_way(across, grid), across.cell.arm
    same = constant_way(across, np.radians(np.arange(-180.0, 181.0, 2.0)))
    assert way.value < 0.99 * same.value
    turning = np.degrees(np.gradient(way.turn, 0.5))
    own = np.sqrt(np.mean((1e6 * way.error) ** 2) + np.mean((0.05 * turning) ** 2))  # the criterion once more
    assert 1e6 * way.value == pytest.approx(own, rel=0.01)
    assert np.all(np.abs(np.diff(way.q, axis=0)) <= arm.joint_speed_limit * 0.5)
    assert np.all((way.q >= arm.joint_lower) & (way.q <= arm.joint_upper))


def test_what_is_too_fast_for_every_turn_is_refused(across):
    hasty = Turns(across.cell, across.course, 1e-3, across.weight)
    with pytest.raises(NoWayError, match="lower the feed"):
        find_way(hasty, GRID)


def test_the_command_writes_a_cell_that_runs(tmp_path, capsys):
    words = ["map", "test_piece.yaml", "--along", "--places", "20", "--tool-turn=-60:60:13", "--out", str(tmp_path)]
    slot = ("path.file=''", "path.start_mm=[-60,0]", "path.length_mm=15", "path.depth_of_cut_mm=1",
            "path.feed_rate_m_per_min=4", "stock.grid_step_um=60")  # fmt: skip
    assert main([*words, "--json", *(part for pair in slot for part in ("--set", pair))]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["criterion_um"] <= result["criterion_constant_um"] and max(result["joint_speed_share"]) < 1.0
    cell, old = read_cell(result["best"][0]["cell"]), read_cell(find_file("test_piece.yaml"), slot)
    run = cell.target()
    assert run.position == pytest.approx(old.target().position, abs=1e-12)
    assert cell.joints(run).shape == (len(run), 6)
    table = (tmp_path / "along.csv").read_text().splitlines()
    assert len(table) == len(run) + 1 and table[0].endswith("a6_deg")
    assert main([*words, "--x", "1:2:2"]) == 2
    assert main([*words, "--json", *(part for pair in slot for part in ("--set", pair))]) == 0  # over the rest
