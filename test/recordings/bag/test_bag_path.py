"""Targets from recordings: paths and trajectories."""

import numpy as np
import pytest
from budget import budget
from hypothesis import given, settings
from hypothesis import strategies as st
from samples.recording_samples import PATH, STORE, header, make, path, pose, raw
from samples.small_part import path_error
from scipy.spatial.transform import Rotation

from kr270_milling.base.errors import ConfigError, InputError, RecordingError
from kr270_milling.base.parameter_file import find_file
from kr270_milling.cell.cell_file import read_cell
from kr270_milling.cell.models import path_of
from kr270_milling.cli import main
from kr270_milling.path.timing import TimedPath
from kr270_milling.path.toolpath import Toolpath
from kr270_milling.path.trajectory import TOOL_DOWN, Trajectory
from kr270_milling.recordings.bag.recorded_path import read_path, read_recorded
from kr270_milling.recordings.bag.writer import BagWriter

NAV = "nav_msgs/msg/Path"
SIDE = 0.00054725  # [m], depth of cut of the paper's cell
FEED = 4.0 / 60.0  # [m/s]
CELL = find_file("paper.yaml")


def nav(positions, stamps, quaternions=None, frame="workpiece", pose_frame=None, stamp=5):
    """stamps [ns]; quaternions: one, or one a pose; default: what an unset orientation is, 0 0 0 1."""
    turns = np.broadcast_to((0, 0, 0, 1) if quaternions is None else quaternions, (len(positions), 4))
    frames = frame if pose_frame is None else pose_frame
    poses = [pose(t, [*p, *q], frames) for t, p, q in zip(stamps, positions, turns, strict=True)]
    return make(NAV, header(stamp, frame), poses)


def line(count: int = 15, length: float = 0.014, depth: float = SIDE) -> np.ndarray:
    """Along +x from 10 mm before the stock of the paper's cell, which begins at x = 0."""
    return np.column_stack([np.linspace(-0.010, length - 0.010, count), np.zeros(count), np.full(count, -depth)])


def stamped(positions, feed: float = FEED, start: int = 7 * 10**9) -> list[int]:
    way = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(positions, axis=0), axis=1)))
    return (start + np.rint(way / feed * 1e9)).astype(int).tolist()


def record(directory, **messages):
    """topic -> message or list of messages, in a recording; returns its file."""
    with BagWriter(directory) as writer:
        for name, sent in messages.items():
            for message in sent if isinstance(sent, list) else [sent]:
                if f"/{name}" not in writer.topics:
                    writer.add_topic(f"/{name}", message.__msgtype__)
                writer.write(f"/{name}", raw(message), 0)
    return writer.path


def refusal(file, *args) -> str:
    with pytest.raises(RecordingError) as caught:
        read_recorded(file, *args)
    assert str(file) in str(caught.value) and "\n" not in str(caught.value)
    return str(caught.value)


# --- nav_msgs/Path ---


@pytest.mark.parametrize("count", [0, 1, 2, 12])
@pytest.mark.parametrize("frame", ["", "workpiece", "a", "abcdefgh"])
@pytest.mark.parametrize("little", [True, False])
def test_every_number_of_a_path_comes_out(count, little, frame):
    rng = np.random.default_rng(count)
    at, turns, stamps = rng.normal(size=(count, 3)), rng.normal(size=(count, 4)), rng.integers(0, 10**18, count)
    message = nav(at, stamps.tolist(), turns if count else None, pose_frame=frame)
    frames, *actual = read_path(bytes(STORE.serialize_cdr(message, NAV, little_endian=little)))
    for table, expected in zip(actual, (stamps, at.reshape(-1, 3), turns.reshape(-1, 4)), strict=True):
        np.testing.assert_array_equal(table, expected)
    assert set(frames) == ({"workpiece", frame} if count else {"workpiece"})


@given(st.integers(0, 400), st.binary(max_size=30))
@settings(max_examples=budget(200))
def test_a_damaged_path_is_refused_or_read_within_its_bytes(cut, tail):
    data = raw(nav(line(4), [0] * 4))[:cut] + tail
    try:
        _, time, *_ = read_path(data)
    except ValueError:
        return
    assert 64 * len(time) <= len(data)


def test_the_stamps_of_a_path_give_the_feed(tmp_path):
    at = line(29, 0.028)
    stamps = stamped(at[:15]) + (stamped(at[14:], 2 * FEED, 7 * 10**9 + 210_000_000)[1:])
    actual = read_recorded(record(tmp_path / "a", plan=nav(at, stamps)))
    assert isinstance(actual, Toolpath) and len(actual) == 29
    np.testing.assert_array_equal(actual.position, at)
    np.testing.assert_allclose(actual.feed[1:], [FEED] * 14 + [2 * FEED] * 14, rtol=1e-5)
    assert len(set(actual.feed[1:15])) == 1  # whole nanoseconds do not make it tremble
    np.testing.assert_array_equal(actual.quaternion, np.tile(TOOL_DOWN, (29, 1)))


def test_only_poses_of_one_stamp_take_the_feed_of_the_cell(tmp_path):
    for stamp in (0, 10**18):
        file = record(tmp_path / str(stamp), plan=nav(line(), [stamp] * 15))
        np.testing.assert_array_equal(read_recorded(file, "", 0.05).feed[1:], 0.05)
        assert "path.feed_rate_m_per_min" in refusal(file)
    file = record(tmp_path / "stamped", plan=[nav(line(), stamped(line()), stamp=s) for s in (1, 2, 3)])  # sent again
    actual = read_recorded(file, "", 0.5)
    assert len(actual) == 15
    np.testing.assert_allclose(actual.feed[1:], FEED, rtol=1e-5)


def test_a_pause_of_a_path_is_no_feed(tmp_path):
    at = np.repeat(line(5), 2, axis=0)
    stamps = [k // 2 * 10**9 + k % 2 * 5 * 10**8 for k in range(10)]  # half a second to rest, half to go 3.5 mm
    actual = read_recorded(record(tmp_path / "a", plan=nav(at, stamps)))
    assert len(actual) == 5
    np.testing.assert_allclose(actual.feed[1:], 0.0035 / 0.5, rtol=1e-5)


def test_headings_say_nothing_about_the_tool_and_a_tilt_does(tmp_path):
    turn = Rotation.from_rotvec(np.outer(np.linspace(0, 3, 15), [0, 0, 1]))
    flat = read_recorded(record(tmp_path / "a", plan=nav(line(), [0] * 15, turn.as_quat())), "", FEED)
    np.testing.assert_array_equal(flat.quaternion, np.tile(TOOL_DOWN, (15, 1)))
    tilt = (Rotation.from_quat(TOOL_DOWN) * Rotation.from_euler("y", 10, degrees=True)).as_quat()
    tilted = read_recorded(record(tmp_path / "b", plan=nav(line(), [0] * 15, tilt)), "", FEED)
    np.testing.assert_allclose(tilted.quaternion, np.tile(tilt, (15, 1)), atol=1e-15)


def test_a_recorded_path_is_cut_like_the_same_points_from_a_table(tmp_path):
    at = line()
    file = record(tmp_path / "a", plan=nav(at, stamped(at, 0.05)))
    table = tmp_path / "points.csv"
    rows = [f"{x * 1e3!r},{y * 1e3!r},{z * 1e3!r},50.0" for x, y, z in at.tolist()]
    table.write_text("\n".join(["x_mm,y_mm,z_mm,feed_mm_per_s", *rows]) + "\n")
    ours, other = (read_cell(CELL, [f"path.file={name}"]) for name in (file, table))
    np.testing.assert_allclose(path_of(ours).target.position, path_of(other).target.position, atol=1e-12)
    np.testing.assert_array_equal(path_of(ours).target.time_ns, path_of(other).target.time_ns)


# --- MultiDOFJointTrajectory ---


def points_of(run: Trajectory, names=("tcp",), frame: str = "workpiece"):
    """A message with the knots of a trajectory."""
    velocity = None if run.velocity is None else np.hstack([run.velocity, np.zeros((len(run), 3))])[:, None]
    message = path(3, run.time_ns.tolist(), run.position[:, None], run.quaternion[:, None], velocity, names)
    message.header.frame_id = frame
    return message


def arc(period: float = 0.05, speed: float = 0.05, radius: float = 0.02) -> Trajectory:
    """Half a circle as the knots of a cubic spline, counterclockwise."""
    time_ns = (np.arange(0.0, np.pi * radius / speed, period) * 1e9).astype(np.int64)
    angle = time_ns * 1e-9 * speed / radius
    zero = np.zeros(angle.size)
    at = np.stack([radius * np.cos(angle), radius * np.sin(angle), zero - SIDE], axis=1)
    return Trajectory(time_ns, at, TOOL_DOWN, speed * np.stack([-np.sin(angle), np.cos(angle), zero], axis=1))


@pytest.mark.parametrize("run", [arc(), Trajectory.straight_line([0, 0, -SIDE], [1, 0, 0], 0.01, FEED, 0.05)])
def test_a_trajectory_is_the_target_as_it_is(tmp_path, run):
    for name in ("tcp", "tool0"):  # before 0.3 the tool tip was tool0
        file = record(tmp_path / name, reference=points_of(run, names=(name,)))
        np.testing.assert_array_equal(
            path_of(read_cell(CELL, [f"path.file={file.parent}"])).target.position, run.position
        )
        actual = read_recorded(file)
        assert isinstance(actual, TimedPath) and actual.timed_by_source
        np.testing.assert_array_equal(actual.trajectory.time_ns, run.time_ns)
        np.testing.assert_array_equal(actual.trajectory.position, run.position)
        assert (actual.trajectory.velocity is None) == (run.velocity is None)
        np.testing.assert_allclose(actual.toolpath.feed[1:].max(), np.max(run.feed(run.time_ns[:-1])), rtol=1e-3)


def test_an_arc_of_knots_is_an_arc_of_the_tool_path(tmp_path):
    """Length, tangent and place between the knots, against the circle itself."""
    run = arc()
    actual = read_recorded(record(tmp_path / "a", reference=points_of(run)))
    way = run.duration_ns * 1e-9 * 0.05
    assert actual.toolpath.length == pytest.approx(way, rel=1e-9)
    between = np.linspace(0, run.duration_ns, 999).astype(np.int64)
    np.testing.assert_allclose(actual.distance_at(between), between * 1e-9 * 0.05, atol=1e-9)
    at, tangent, _ = actual.toolpath.on_path(actual.distance_at(between))
    angle = between * 1e-9 * 0.05 / 0.02
    np.testing.assert_allclose(tangent[:, 0], -np.sin(angle), atol=1e-6)
    np.testing.assert_allclose(np.hypot(at[:, 0], at[:, 1]), 0.02, atol=1e-9)
    assert path_error(actual, between).max() < 1e-6


def test_the_tool_may_rest_on_its_way(tmp_path):
    at = line(5)[[0, 1, 1, 1, 2, 3, 3, 4]]
    run = Trajectory(np.arange(8) * 10**8, at, TOOL_DOWN)
    actual = read_recorded(record(tmp_path / "a", reference=points_of(run)))
    assert len(actual.toolpath) == 5
    np.testing.assert_allclose(actual.distance, 0.0035 * np.array([0, 1, 1, 1, 2, 3, 3, 4]), atol=1e-15)
    np.testing.assert_allclose(actual.distance_at(250_000_000), 0.0035, atol=1e-15)
    np.testing.assert_allclose(actual.distance_at(350_000_000), 0.0035 * 1.5, atol=1e-15)
    assert path_error(actual, np.linspace(0, run.duration_ns, 99).astype(np.int64)).max() < 1e-15


def knots(times, at, turn=(1, 0, 0, 0), velocities=None):
    return path(3, times, at[:, None], [[turn]] * len(times), velocities)


@pytest.mark.parametrize(("message", "sentence"), [
    (nav(line(), [0] * 15, frame="base_link"), "frame is 'base_link', but must be workpiece"),
    (nav(line(), [0] * 15, pose_frame="map"), "frame is 'map'"),
    (nav(line() * np.nan, [0] * 15), "point 1 is more than"),
    (nav(line(1), [0]), "never moves"),
    (nav(line(), [0] * 15, (1, 0, 0, 1)), "pose 1 does not have length 1"),
    (nav(line(), [0] * 15, (np.inf, 0, 0, 1)), "not finite"),
    (nav(line(), [0] * 15, (0.6, 0, 0, 0.8)), "points out of the part"),
    ([nav(line(), [0] * 15), nav(line(14), [0] * 14)], "different paths"),
    (nav(line(4), [0, 10**9, 10**9, 2 * 10**9]), "pose 3 needs a later stamp"),
    (nav(line(4), [3 * 10**9, 2 * 10**9, 10**9, 0]), "pose 2 needs a later stamp"),
    (nav(line(4), [0, 10**9, 10**9 + 1, 2 * 10**9]), "pose 3 at 4.67e+06 m/s"),
    (points_of(arc(), frame="base_link"), "must be workpiece"),
    (points_of(arc(), names=("flange",)), "of flange, not of tcp"),
    (knots([0, 10**9], line(2) * 1e9), "wrong unit"),
    (knots([0, 10**9], line(2), (1, 0, 0, 1)), "point 1: its quaternion"),
    (knots([0, 0], line(2)), "point 2: its time"),
    (knots([5, 10], line(2)), "point 1: the first time"),
    (knots([0, 10], line(2), velocities=np.full((2, 1, 6), np.inf)), "velocity is not finite"),
    (knots([0, 10], line(2)[[0, 0]]), "never moves"),
])  # fmt: skip
def test_what_cannot_be_run_is_refused(tmp_path, message, sentence):
    assert sentence in refusal(record(tmp_path / "a", target=message), "", FEED)


def test_of_several_topics_one_must_be_named(tmp_path):
    sent = dict(plan=nav(line(), stamped(line())), reference=points_of(arc()), tool_pose=pose(0, [0] * 7))
    file = record(tmp_path / "a", **sent)
    text = refusal(file)
    assert text.endswith(f"path.topic: /plan ({NAV}), /reference ({PATH})")
    assert isinstance(read_recorded(file, "/plan"), Toolpath)
    assert isinstance(read_recorded(file, "/reference"), TimedPath)
    assert "'/tool_pose', but on: /plan" in refusal(file, "/tool_pose")
    cell = read_cell(CELL, [f"path.file={file}", "path.topic=/plan"])
    np.testing.assert_allclose(path_of(cell).feed_rate, FEED, rtol=1e-5)
    for other in ("", "test_piece.nc"):
        with pytest.raises(ConfigError, match="path.topic"):
            read_cell(CELL, [f"path.file={other!r}", "path.topic=/plan"])
    assert f"has no {NAV}" in refusal(record(tmp_path / "b", tool_pose=sent["tool_pose"]))


def test_the_commands_take_a_recorded_trajectory_and_one_of_days_is_refused(tmp_path, capsys):
    """Points and not lines are named, and the trajectory keeps its times although an axis would be too fast."""
    slow = record(tmp_path / "slow", reference=points_of(Trajectory([0, 10**14], line(2), TOOL_DOWN)))
    with pytest.raises(InputError, match="exchange periods"):
        assert path_of(read_cell(CELL, [f"path.file={slow}"])).target
    run = Trajectory(np.arange(15) * 15_000_000, line(), TOOL_DOWN)
    file = record(tmp_path / "a", reference=points_of(run))
    fast = ["--set", f"path.file={file}", "--set", f"arm.joint_speed_limit_deg_per_s={[0.5] * 6}"]
    assert main(["check", str(CELL), *fast]) == 1
    printed = capsys.readouterr().out
    assert "speed of axis" in printed and "line" not in printed.lower().replace("straight line", "")
    out = tmp_path / "out"
    assert main(["compensate", str(CELL), *fast[:2], "--method", "linear", "--verdict", "0", "--out", str(out)]) in (
        0,
        1,
    )
    assert (out / "reference_linear.csv").is_file() and (out / "report.html").is_file()
