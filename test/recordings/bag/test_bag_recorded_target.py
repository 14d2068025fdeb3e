"""Trajectories of recordings as targets, and the cell and the commands on recorded paths."""

from __future__ import annotations

import numpy as np
import pytest
from small_part import path_error
from test_bag_recorded_path import CELL, FEED, NAV, SIDE, line, nav, record, refusal, stamped
from test_recording_samples import PATH, POSE, path, pose

from kr270_milling.base.errors import ConfigError, InputError, RecordingError
from kr270_milling.cell.cell import read_cell
from kr270_milling.cell.jobs import simulate
from kr270_milling.cli import main
from kr270_milling.path.timing import TimedPath
from kr270_milling.path.toolpath import Toolpath
from kr270_milling.path.trajectory import TOOL_DOWN, Trajectory
from kr270_milling.recordings.bag.recorded_path import read_recorded


def points_of(run: Trajectory, names=("tool0",), frame: str = "workpiece"):
    """A MultiDOFJointTrajectory with the knots of a trajectory."""
    velocity = None if run.velocity is None else np.hstack([run.velocity, np.zeros((len(run), 3))])[:, None]
    message = path(3, run.time_ns.tolist(), run.position[:, None], run.quaternion[:, None], velocity, names)
    message.header.frame_id = frame
    return message


# --- MultiDOFJointTrajectory ---


def arc(period: float = 0.05, speed: float = 0.05, radius: float = 0.02) -> Trajectory:
    """Half a circle as the knots of a cubic spline, counterclockwise."""
    time_ns = (np.arange(0.0, np.pi * radius / speed, period) * 1e9).astype(np.int64)
    angle = time_ns * 1e-9 * speed / radius
    zero = np.zeros(angle.size)
    at = np.stack([radius * np.cos(angle), radius * np.sin(angle), zero - SIDE], axis=1)
    return Trajectory(time_ns, at, TOOL_DOWN, speed * np.stack([-np.sin(angle), np.cos(angle), zero], axis=1))


@pytest.mark.parametrize("run", [arc(), Trajectory.straight_line([0, 0, -SIDE], [1, 0, 0], 0.01, FEED, 0.05)])
def test_a_trajectory_is_the_target_as_it_is(tmp_path, run):
    found = read_recorded(record(tmp_path / "a", reference=points_of(run)))
    assert isinstance(found, TimedPath) and found.timed_by_source
    np.testing.assert_array_equal(found.trajectory.time_ns, run.time_ns)
    np.testing.assert_array_equal(found.trajectory.position, run.position)
    assert (found.trajectory.velocity is None) == (run.velocity is None)
    np.testing.assert_allclose(found.toolpath.feed[1:].max(), np.max(run.feed(run.time_ns[:-1])), rtol=1e-3)


def test_an_arc_of_knots_is_an_arc_of_the_tool_path(tmp_path):
    """Length, tangent and place between the knots, against the circle itself."""
    run = arc()
    found = read_recorded(record(tmp_path / "a", reference=points_of(run)))
    way = run.duration_ns * 1e-9 * 0.05
    assert found.toolpath.length == pytest.approx(way, rel=1e-9)
    between = np.linspace(0, run.duration_ns, 999).astype(np.int64)
    np.testing.assert_allclose(found.distance_at(between), between * 1e-9 * 0.05, atol=1e-9)
    at, tangent, _ = found.toolpath.on_path(found.distance_at(between))
    angle = between * 1e-9 * 0.05 / 0.02
    np.testing.assert_allclose(tangent[:, 0], -np.sin(angle), atol=1e-6)
    np.testing.assert_allclose(np.hypot(at[:, 0], at[:, 1]), 0.02, atol=1e-9)
    assert path_error(found, between).max() < 1e-6


def test_the_tool_may_rest_on_its_way(tmp_path):
    at = line(5)[[0, 1, 1, 1, 2, 3, 3, 4]]
    run = Trajectory(np.arange(8) * 10**8, at, TOOL_DOWN)
    found = read_recorded(record(tmp_path / "a", reference=points_of(run)))
    assert len(found.toolpath) == 5
    np.testing.assert_allclose(found.distance, 0.0035 * np.array([0, 1, 1, 1, 2, 3, 3, 4]), atol=1e-15)
    np.testing.assert_allclose(found.distance_at(250_000_000), 0.0035, atol=1e-15)
    np.testing.assert_allclose(found.distance_at(350_000_000), 0.0035 * 1.5, atol=1e-15)
    assert path_error(found, np.linspace(0, run.duration_ns, 99).astype(np.int64)).max() < 1e-15


def test_a_pass_along_the_recorded_target_is_the_pass_of_the_straight_cut(tmp_path):
    short = ["path.length_mm=12", "stock.max_mm=[4,12,0]"]
    plain = read_cell(CELL, short)
    file = record(tmp_path / "a", target_trajectory=points_of(plain.target()))
    recorded = read_cell(CELL, [*short, f"path.file={file.parent}"])  # the directory does as well
    expected, found = simulate(plain).result, simulate(recorded).result
    np.testing.assert_array_equal(found.actual, expected.actual)
    np.testing.assert_array_equal(found.wrench, expected.wrench)
    assert np.abs(found.wrench).max() > 1.0


@pytest.mark.parametrize(
    ("message", "says"),
    [
        (points_of(arc(), frame="base_link"), "must be workpiece"),
        (points_of(arc(), names=("flange",)), "of flange, not of tool0"),
        (path(3, [0, 10**9], line(2)[:, None] * np.nan, [[[1, 0, 0, 0]]] * 2), "point 1 is more than"),
        (path(3, [0, 10**9], line(2)[:, None] * 1e9, [[[1, 0, 0, 0]]] * 2), "wrong unit"),
        (path(3, [0, 10**9], line(2)[:, None], [[[1, 0, 0, 1]]] * 2), "point 1: its quaternion"),
        (path(3, [0, 0], line(2)[:, None], [[[1, 0, 0, 0]]] * 2), "point 2: its time"),
        (path(3, [5, 10], line(2)[:, None], [[[1, 0, 0, 0]]] * 2), "point 1: the first time"),
        (
            path(3, [0, 10], line(2)[:, None], [[[1, 0, 0, 0]]] * 2, np.full((2, 1, 6), np.inf)),
            "velocity is not finite",
        ),
        (path(3, [0, 10], line(2)[[0, 0], None], [[[1, 0, 0, 0]]] * 2), "never moves"),
        (path(3, [], [], []), "never moves"),
    ],
)
def test_a_trajectory_that_cannot_be_run_is_refused(tmp_path, message, says):
    assert says in refusal(record(tmp_path / "a", reference=message))


# --- choice of the topic, and the cell ---


def test_of_several_topics_one_must_be_named(tmp_path):
    at = line()
    file = record(
        tmp_path / "a", plan=nav(at, stamped(at)), reference=points_of(arc()), tool_pose=pose(0, [0] * 7),
    )  # fmt: skip
    text = refusal(file)
    assert "/plan (nav_msgs/msg/Path)" in text and f"/reference ({PATH})" in text and "path.topic" in text
    assert "tool_pose" not in text
    assert isinstance(read_recorded(file, "/plan"), Toolpath)
    assert isinstance(read_recorded(file, "/reference"), TimedPath)
    for wrong in ("/tool_pose", "/none"):
        assert wrong in refusal(file, wrong) and "/plan" in refusal(file, wrong)
    cell = read_cell(CELL, [f"path.file={file}", "path.topic=/plan"])
    np.testing.assert_allclose(cell.feed_rate, FEED, rtol=1e-5)


def test_a_recording_without_a_path_is_refused(tmp_path):
    file = record(tmp_path / "a", tool_pose=pose(0, [0] * 7))
    assert POSE not in refusal(file) and NAV in refusal(file)


def test_a_topic_is_for_recordings_only():
    for file in ("", "test_piece.nc"):
        with pytest.raises(ConfigError, match="path.topic"):
            read_cell(CELL, [f"path.file={file!r}", "path.topic=/plan"])


def test_unusable_recordings_are_told_by_the_cell(tmp_path):
    (tmp_path / "empty.mcap").write_bytes(b"")
    (tmp_path / "text.mcap").write_text("G1 X1\n")
    (tmp_path / "folder").mkdir()
    for name in ("empty.mcap", "text.mcap", "folder"):
        with pytest.raises(RecordingError, match=name):
            read_cell(CELL, [f"path.file={tmp_path / name}"]).target()


def test_a_trajectory_of_days_is_refused_before_anything_is_simulated(tmp_path):
    slow = Trajectory([0, 10**14], line(2), TOOL_DOWN)
    file = record(tmp_path / "a", reference=points_of(slow))
    with pytest.raises(InputError, match="exchange periods"):
        read_cell(CELL, [f"path.file={file}"]).target()


def test_the_commands_take_a_recorded_trajectory(tmp_path, capsys):
    """Points and not lines are named, and the trajectory keeps its times although an axis would be too fast."""
    run = Trajectory(np.arange(15) * 15_000_000, line(), TOOL_DOWN)
    file = record(tmp_path / "a", reference=points_of(run))
    fast = ["--set", f"path.file={file}", "--set", f"arm.joint_speed_limit_deg_per_s={[0.5] * 6}"]
    assert main(["check", str(CELL), *fast]) == 1
    told = capsys.readouterr().out
    assert "speed of axis" in told and "line" not in told.lower().replace("straight line", "")
    out = tmp_path / "out"
    assert main(["compensate", str(CELL), *fast[:2], "--method", "linear", "--no-verdict", "--out", str(out)]) in (0, 1)
    assert (out / "reference_linear.csv").is_file() and (out / "report.html").is_file()
