"""RSI offset tables and joint tables."""

from __future__ import annotations

import csv

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from splines import spline

from kr270_milling.decide.programs.files import JOINT_NAMES, offsets, write_joint_table, write_rsi_table
from kr270_milling.path.trajectory import TOOL_DOWN, Trajectory, TrajectoryError

LINE = Trajectory.straight_line(np.zeros(3), [1.0, 0.0, 0.0], 0.08, 4 / 60, 0.05)
BENT = spline(LINE.time_ns, LINE.position + np.sin(LINE.time)[:, None] * [0, 1e-4, -2e-5], ends="not-a-knot")


def rows(path) -> list[dict[str, float]]:
    with open(path, newline="") as stream:
        return [{k: float(v) for k, v in row.items()} for row in csv.DictReader(stream)]


@pytest.mark.parametrize("tick_ms", [4, 12])
def test_the_table_holds_the_difference_of_both_paths_at_every_tick(tmp_path, tick_ms):
    write_rsi_table(tmp_path / "rsi.csv", LINE, BENT, tick_ms * 10**6)
    table = rows(tmp_path / "rsi.csv")
    assert len(table) == 1200 // tick_ms + 1 and table[-1]["time_s"] == 1.2
    time = np.array([row["time_s"] for row in table])
    lateral = np.array([[row["dX_mm"], row["dY_mm"], row["dZ_mm"]] for row in table])
    np.testing.assert_allclose(lateral[:, 1], 0.1 * np.sin(time), atol=2e-6)  # spline error and the last digit
    np.testing.assert_allclose(lateral[:, 2], -0.02 * np.sin(time), atol=2e-6)
    assert np.abs(lateral[:, 0]).max() < 1e-6 and all(row["dA_deg"] == row["dB_deg"] == 0 for row in table)


def test_small_turns_come_out_as_angles_about_the_axes_of_the_frame():
    turn = Rotation.from_rotvec([1e-4, -2e-4, 3e-4])
    turned = Trajectory(LINE.time_ns, LINE.position, (turn * Rotation.from_quat(TOOL_DOWN)).as_quat())
    _, shift, abc = offsets(LINE, turned, 4_000_000)
    np.testing.assert_allclose(abc, np.tile([3e-4, -2e-4, 1e-4], (301, 1)), atol=1e-7)  # A, B, C about z, y, x
    assert not shift.any()


def test_the_last_tick_covers_the_end_of_a_path_that_is_no_multiple_of_it():
    line = Trajectory.straight_line(np.zeros(3), [1.0, 0, 0], 0.0801, 4 / 60, 0.05)
    assert offsets(line, line, 12_000_000)[0][-1] >= line.duration_ns


def test_other_ticks_and_paths_of_unlike_duration_are_refused(tmp_path):
    longer = Trajectory.straight_line(np.zeros(3), [1.0, 0, 0], 0.09, 4 / 60, 0.05)
    for arguments in ((LINE, BENT, 5_000_000), (LINE, longer, 4_000_000)):
        with pytest.raises(TrajectoryError):
            write_rsi_table(tmp_path / "rsi.csv", *arguments)
    assert not list(tmp_path.iterdir())


def test_joint_positions_are_written_in_degrees(tmp_path):
    joints = np.random.default_rng(2).uniform(-3, 3, (25, 6))
    write_joint_table(tmp_path / "joints.csv", LINE, joints)
    table = rows(tmp_path / "joints.csv")
    assert [row["time_s"] for row in table] == [t / 1e9 for t in LINE.time_ns.tolist()]
    for column, name in enumerate(JOINT_NAMES):
        assert [row[f"{name}_deg"] for row in table] == np.degrees(joints[:, column]).tolist()


def test_joints_that_do_not_fit_the_knots_are_refused(tmp_path):
    for joints in (np.zeros((24, 6)), np.full((25, 6), np.nan)):
        with pytest.raises(TrajectoryError):
            write_joint_table(tmp_path / "joints.csv", LINE, joints)
