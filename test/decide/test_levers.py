"""Ramps, feeds, finishing passes and turns of the tool as levers beside the correction."""

import re

import numpy as np
import pytest
from samples.small_part import CORNER, GCODE, assignments, small_part, swayed

from kr270_milling.base.errors import InputError, ParameterError
from kr270_milling.base.frames import TOOL0, Pose, rotation_from_abc, rotation_from_quaternion
from kr270_milling.base.parameter_file import find_file
from kr270_milling.cell.cell_file import read_cell
from kr270_milling.cell.jobs import simulate
from kr270_milling.cell.models import arm_of, cut_of, path_of
from kr270_milling.decide import levers as module
from kr270_milling.decide.compensation import compensate
from kr270_milling.decide.levers import RATIOS, levers, softened
from kr270_milling.decide.part.assessment import after_passes, judge
from kr270_milling.decide.programs.files import knot_feeds, write_programs
from kr270_milling.decide.programs.gcode import write_gcode
from kr270_milling.decide.programs.points import fixed_knots, program_points
from kr270_milling.path.cam.gcode.reader import read_gcode
from kr270_milling.physics.robot.kinematics import pose
from kr270_milling.studies.maps.along import own_turn, turned_cell

pytestmark = pytest.mark.usefixtures("few_robots")
WALL = """\
G21 G90 S8000 M3
G0 X{} Y40 Z5
G0 Z-0.5
(wall)
G1 X{} F2000
G0 Z5
M30
"""


@pytest.mark.parametrize("ends, share", [((-14, 54), 0.1), ((54, -14), 1.0)], ids=["conventional", "climb"])
def test_a_finishing_pass_cuts_what_the_first_one_leaves_and_fills_no_overcut(tmp_path, ends, share):
    def ran(*more):
        settings = "cutting.detail=engagement", "stock.max_mm=[40,34,0]", "part.tolerance_um=50", *more
        cell = small_part(tmp_path, WALL.format(*ends), *settings)
        return cell, simulate(cell)

    single, (cell, both) = ran(), ran("compensation.finish=1")
    one, two = after_passes(cell, both)
    assert one["wall_um"] == pytest.approx(1e6 * judge(*single).wall, rel=1e-3)
    assert two["wall_um"] == pytest.approx(1e6 * judge(cell, both).wall, rel=1e-9)
    assert two["wall_um"] == pytest.approx(share * one["wall_um"], abs=0.1 * one["wall_um"])
    assert two["end_s"] > 1.9 * one["end_s"] and two["max_force_n"] < 0.05 * one["max_force_n"]


def test_a_second_pass_removes_the_volume_that_the_first_one_leaves():
    cell = read_cell(find_file("test_piece.yaml"), ["cutting.detail=engagement"])
    cut, low, depth, left = cut_of(cell), cell.stock.min, 1e-3, 60e-6  # [m]
    for shift, end in ((left, 70e-3), (0.0, 45e-3)):
        x = np.linspace(low[0] + 15e-3, low[0] + end, 1200)
        path = np.column_stack([x, np.full(1200, low[1] + 3e-3 - shift), np.full(1200, cell.stock.max[2] - depth)])
        volume = cut.along(path, np.arange(1200) * 100)[2]
    assert volume[400:].sum() == pytest.approx(depth * left * (x[-1] - x[399]), rel=0.02)


def test_a_straight_cut_has_no_finishing_pass():
    cell = read_cell(find_file("paper.yaml"), ["compensation.finish=1"])
    with pytest.raises(ParameterError, match="compensation.finish"):
        path_of(cell)


def test_softer_ramps_take_at_most_the_stated_time(tmp_path):
    cell = small_part(tmp_path, GCODE, "cutting.detail=engagement")
    plain = path_of(cell).target.duration_ns
    for ratio in RATIOS:
        softer = softened(cell, ratio)
        assert (0.97 * ratio if ratio > 1.0 else 1.0) <= path_of(softer).target.duration_ns / plain <= ratio
        scale = softer.timing.acceleration / cell.timing.acceleration
        assert softer.timing.jerk / cell.timing.jerk == pytest.approx(scale**2, rel=0.01)


def test_the_first_rows_are_those_of_the_verdict_and_the_cheapest_that_is_enough_is_run(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "ROUNDS", 2)
    monkeypatch.setattr(module, "PLANNED", 4)
    cell = small_part(
        tmp_path, CORNER, "cutting.detail=engagement", "part.tolerance_um=80", "compensation.method=inverse"
    )
    progress = []
    rows, chosen = levers(cell, 4, 1, "SPLINE", lambda done, total: progress.append(done / total), turned_cell)
    verdict = compensate(cell, robots=4, seed=1, motions=("SPLINE",)).decision.verdict
    assert [rows[0].median, rows[1].median] == pytest.approx([verdict.band(k)[1] for k in ("original", "compensated")])
    assert rows[1].within == verdict.within
    assert progress == sorted(progress) and progress[-1] <= 1.0
    enough = [row for row in rows[1:] if row.enough]
    assert chosen is (min(enough, key=lambda row: row.duration) if enough else max(rows[1:], key=lambda row: row.rank))
    fed = chosen.cell.replace(compensation=chosen.cell.compensation.replace(feed="keep"))  # the feeds are scheduled
    own = compensate(fed, robots=4, seed=1, motions=("SPLINE",)).decision.verdict
    assert chosen.name not in ("nothing", "correction") and chosen.median == pytest.approx(own.band("compensated")[1])
    assert all(row.duration <= 1.5 * rows[0].duration for row in rows if not row.cell.compensation.finish)
    assert [row.name for row in rows[:2]] == ["nothing", "correction"]
    again = read_cell(find_file("paper.yaml"), [*assignments(tmp_path, CORNER), *chosen.keys])
    assert again.compensation.finish == chosen.cell.compensation.finish
    assert again.timing.jerk == chosen.cell.timing.jerk


def test_the_program_of_a_turned_tool_brings_the_arm_to_the_turned_posture(tmp_path):
    settings = "workpiece.abc_deg=[60,0,0]", "cutting.detail=engagement", "compensation.turn=best"
    cell = read_cell(find_file("test_piece.yaml"), [*assignments(tmp_path), *settings])
    turned, turn = turned_cell(cell), own_turn(turned_cell(cell))
    assert turn != 0.0 and own_turn(cell) == 0.0
    before, after = path_of(cell).target, path_of(turned).target
    assert after.position == pytest.approx(before.position, abs=1e-12)
    relative = rotation_from_quaternion(before.quaternion[0]).T @ rotation_from_quaternion(after.quaternion[0])
    assert relative == pytest.approx(rotation_from_abc(np.array([turn, 0.0, 0.0])), abs=1e-9)
    # the program: $TOOL and the frame of its first point
    files, _ = write_programs(
        tmp_path, turned, after, after, method="x", date="2026-01-01", motions=["SPLINE"], tables=()
    )
    source, data = (files["krl_spline"][0].with_suffix(suffix).read_text() for suffix in (".src", ".dat"))
    frames = []
    for text in (re.search(r"\$TOOL=\{(.*?)\}", source)[1], re.search(r"XP1=\{(.*?)\}", data)[1]):
        row = np.array([float(value) for value in re.findall(r"[XYZABC] (-?[\d.]+)", text)])
        frames.append(Pose.from_abc(1e-3 * row[:3], np.radians(row[3:])))
    flange = frames[1] @ frames[0].inverse()
    arm = arm_of(turned)
    joints = arm.joints(after)[0]
    there = turned.workpiece.pose.inverse() @ pose(turned.arm, turned.mount, joints) @ turned.mount.pose.inverse()
    assert flange.position == pytest.approx((there @ TOOL0).position, abs=1e-6)
    assert np.abs(joints - arm.posture).max() < 0.2, "the posture is the hint of the turned cell"


def test_a_cell_without_ramps_or_without_a_tolerance_has_no_lever(tmp_path):
    for cell in (read_cell(find_file("paper.yaml")), small_part(tmp_path, GCODE, "part.tolerance_um=0")):
        with pytest.raises(InputError, match="--reach: needs part.tolerance_um, and a program"):
            levers(cell, 4, 1, "SPLINE")


def test_a_path_with_other_feeds_runs_the_same_way(tmp_path):
    path = small_part(tmp_path, GCODE).path.loaded().read()
    ends = np.append(np.sort(np.random.default_rng(1).uniform(0.0, path.length, 30)), path.length)
    shares = np.linspace(0.5, 1.5, 31)
    other = path.with_feeds(ends, shares)
    distance = np.linspace(0.0, path.length, 500)
    for one, two in zip(path.on_path(distance), other.on_path(distance), strict=True):
        assert two == pytest.approx(one, abs=1e-9)
    middle = 0.5 * (distance[1:] + distance[:-1])
    cut = ~path.rapid[path.block_at(middle)]
    before, after = (each.feed[each.block_at(middle)] for each in (path, other))
    assert after[cut] == pytest.approx((before * shares[np.searchsorted(ends, middle)])[cut])
    assert np.array_equal(after[~cut], before[~cut])


def scheduled_cell(directory, *more):
    """A cell whose feed differs from stretch to stretch, and the places of the stretches."""
    settings = "compensation.feed=schedule", "part.tolerance_um=80", "cutting.detail=engagement", *more
    cell = small_part(directory, GCODE, *settings)
    path = cell.path.loaded().read()
    ends = np.append(np.arange(4e-3, path.length, 4e-3), path.length)
    shares = np.random.default_rng(2).uniform(0.4, 1.0, len(ends))
    return cell.replace(path=cell.path.loaded().replace(content=path.with_feeds(ends, shares)))


@pytest.mark.parametrize("motion", ["SPLINE", "LIN"])
def test_a_robot_program_holds_the_feed_of_each_stretch_within_2_percent(tmp_path, motion):
    cell = scheduled_cell(tmp_path)
    target = path_of(cell).target
    files, _ = write_programs(
        tmp_path, cell, target, swayed(target), method="x", date="2026-01-01", motions=[motion], tables=()
    )
    (source,) = [file for file in files[f"krl_{motion.lower()}"] if file.name.endswith("CMP.src")]
    feeds = knot_feeds(path_of(cell), len(target))
    program = cell.krl.replace(motion=motion)
    knots, auxiliary = program_points(program, target, swayed(target), fixed_knots(target.standing, feeds))
    knots = knots[~auxiliary]
    speeds, usual = [], 0.0
    for line in source.read_text().partition("XP1")[2].splitlines():
        speed = re.search(r"\$VEL.CP=([\d.]+)", line)
        if re.match("(SPL|LIN|CIRC) {", line):
            speeds.append(float(speed[1]) if speed else usual)
        elif speed:
            usual = float(speed[1])
    assert len(speeds) == len(knots) - 1
    for first, last, speed in zip(knots, knots[1:], speeds, strict=False):
        assert speed <= 1.02 * np.nanmin([np.inf, *feeds[first : last + 1]])
        inside = feeds[first + 1 : last]
        assert inside.size == 0 or np.nanmax(inside) == np.nanmin(inside), "a stretch has its own points"


def test_the_f_words_of_a_scheduled_program_are_the_feeds_of_its_stretches(tmp_path):
    cell = scheduled_cell(tmp_path)
    path = path_of(cell).timed.toolpath
    file, (tool,) = write_gcode(tmp_path, [(cell, path_of(cell).target)], method="none", date="2026-01-01")
    read = read_gcode(file)
    assert tool.error < 3e-6
    assert tool.duration == pytest.approx(tool.planned_duration, rel=0.02)
    for block in np.flatnonzero(~read.rapid[1:]) + 1:
        middle = 0.5 * (read.position[block] + read.position[block - 1])
        away = np.linalg.norm(path.position_at(np.linspace(0.0, path.length, 4000)) - middle, axis=1)
        feed = path.feed[path.block_at(np.linspace(0.0, path.length, 4000)[np.argmin(away)])]
        assert read.feed[block] == pytest.approx(feed, rel=0.02)


def test_a_feed_that_changes_within_a_straight_line_has_a_point_there(tmp_path):
    cell = small_part(tmp_path, GCODE.replace("G1 X12 F4000", "G1 X0 F1000\nG1 X12 F4000"))
    target = path_of(cell).target
    files, _ = write_programs(
        tmp_path, cell, target, target, method="x", date="2026-01-01", motions=["SPLINE"], tables=()
    )
    text = files["krl_spline"][0].read_text()
    assert "$VEL.CP=0.0167" in text and "$VEL.CP=0.067" in text  # [m/s], 1000 and 4000 mm/min


def test_feeds_meet_a_linear_load_and_stay_where_the_load_does_not_respond(tmp_path, monkeypatch):
    """Loads a + b f: f = (0.95 - a) / b where the feed may be so, f = 1 where a is 90 % of the load."""
    cell = small_part(
        tmp_path, GCODE, "part.tolerance_um=80", "compensation.feed=schedule", "compensation.feed_most=1.3",
        "limits.least_chip_um=1",
    )  # fmt: skip
    path = cell.path.loaded().read()
    ends = module._stretches(path)
    middle = ends - 0.5 * np.diff(ends, prepend=0.0)
    group = np.arange(len(ends)) // 3 % 4  # the next stretch answers the feed, too
    constant, slope = np.array([0.2, 1.9, 0.1, 0.4])[group], np.array([1.0, 0.1, 0.6, 0.2])[group]
    tried = []

    def loads(tried_cell, method, motion, ends, count):
        content = tried_cell.path.loaded().read()
        share = np.where(cut, content.feed[content.block_at(middle)] / programmed, 1.0)
        tried.append(share)
        load = np.vstack([np.where(cut, constant + slope * share, 0.0), np.zeros((2, len(ends)))])
        return np.tile(load, (16, 1, 1)), np.full(16, 0.5 + 0.5 * len(tried) % 2)

    cut = ~path.rapid[path.block_at(middle)]
    programmed = np.where(cut, path.feed[path.block_at(middle)], 1.0)
    monkeypatch.setattr(module, "_loads", loads)
    monkeypatch.setattr(module, "_within_time", lambda cell, path, ends, aiming, aim, limit: aiming(aim))
    wanted = np.clip((0.95 - constant) / slope, 0.25, 1.3)
    module.scheduled(cell, "none", "SPLINE")
    inside = cut & np.append(group[1:] == group[:-1], True)
    assert tried[-1][inside] == pytest.approx(np.where(constant > 1.0, 1.0, wanted)[inside], abs=0.02)
    assert tried[-1][~cut] == pytest.approx(1.0)


def test_a_scheduled_feed_keeps_more_robots_within_the_tolerance_and_its_limits(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "PLANNED", 4)
    settings = "cutting.detail=engagement", "part.tolerance_um=60", "limits.cutting_force_n=70"
    plain, cell = (small_part(tmp_path, GCODE, *settings, *more) for more in ((), ["compensation.feed=schedule"]))
    before, after = (compensate(each, "none", robots=4, seed=1) for each in (plain, cell))
    assert after.feeds["duration_s"][0] == pytest.approx(1e-9 * path_of(plain).target.duration_ns)
    assert 1.0 < after.feeds["duration_s"][1] / after.feeds["duration_s"][0] <= 1.5
    assert after.feeds["feed_percent"][1] <= 100.0
    force = [np.linalg.norm(run.revised.result.wrench[:, :3], axis=1).max() for run in (before, after)]
    assert force[1] < force[0]
    assert after.decision.verdict.band("compensated")[1] < before.decision.verdict.band("compensated")[1]
    with pytest.raises(InputError, match="compensation.feed: needs part.tolerance_um"):
        compensate(small_part(tmp_path, GCODE, "compensation.feed=schedule", "part.tolerance_um=0"), "none")
