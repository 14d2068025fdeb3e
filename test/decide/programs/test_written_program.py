"""The figures of a program are those of its written points, joined as the controller joins them."""

from __future__ import annotations

import numpy as np
import pytest
from krl_robot import Robot
from small_part import GCODE, small_part

from kr270_milling.base.errors import InputError
from kr270_milling.base.record import find_file
from kr270_milling.cell.cell import read_cell
from kr270_milling.cell.jobs import compensated, simulate
from kr270_milling.decide.compensation import compensate
from kr270_milling.decide.programs.files import time_law, write_programs
from kr270_milling.decide.programs.krl_reader import read_krl
from kr270_milling.decide.programs.written import softer_pass, written_pass, written_trajectory
from kr270_milling.path.controller_motion import block_ends, controller_motion

UM = 1e-6
SHARE = 0.02  #: of the planned deviation
ROUNDING = 0.12 * UM  #: points are written to 0.1 um, which an arm with a damping of 0.04 amplifies
SMOOTH = "spline", "learned", "inverse"


@pytest.fixture(scope="module", params=[0.04, 0.182])
def paper(request):
    assignments = ["dynamics.reference_inertia=true", f"dynamics.damping_ratio={request.param}"]
    cell = read_cell(find_file("paper.yaml"), assignments)
    return cell, simulate(cell)


@pytest.fixture(scope="module")
def part(tmp_path_factory):
    cell = small_part(tmp_path_factory.mktemp("part"), GCODE, "dynamics.reference_inertia=true")
    return cell, simulate(cell)


@pytest.mark.parametrize("method", ["linear", *SMOOTH])
def test_the_written_program_leaves_what_the_plan_leaves(paper, method):
    cell, original = paper
    planned = compensated(cell, original, method)
    written = written_pass(cell, planned)
    plan, left = planned.scores.max_deviation, written.scores.max_deviation
    assert left == pytest.approx(plan, rel=SHARE, abs=ROUNDING)
    assert method not in ("learned", "inverse") or left < 0.5 * UM


@pytest.mark.parametrize("method", SMOOTH)
def test_the_slopes_of_a_smooth_reference_follow_from_its_points(part, method):
    cell, original = part
    run, target = compensated(cell, original, method).reference, cell.target()
    np.testing.assert_array_equal(run.velocity, controller_motion(run, target).velocity)
    assert not run.velocity[block_ends(target)].any() and target.standing[1:-1].any()


@pytest.mark.parametrize("method", ["linear", *SMOOTH])
def test_a_program_with_stops_leaves_what_the_plan_leaves(part, method):
    cell, original = part
    planned = compensated(cell, original, method)
    left = written_pass(cell, planned).scores.max_deviation
    assert left == pytest.approx(planned.scores.max_deviation, rel=SHARE, abs=ROUNDING)


def test_a_program_in_straight_lines_of_a_smooth_plan_is_a_finding(part):
    cell, _ = part
    done = compensate(cell, "inverse", motions=("LIN",))
    (finding,) = [f for f in done.checked.findings if f.what == "written program"]
    assert finding.severity == "warning"
    assert finding.value == pytest.approx(1e6 * done.revised.scores.max_deviation)
    assert finding.value > 1.2 * finding.limit == pytest.approx(1.2e6 * done.planned.scores.max_deviation)
    assert not [f for f in compensate(cell, "inverse").checked.findings if f.what == "written program"]


@pytest.mark.parametrize(("motion", "limit"), [("SPLINE", 1400), ("SPLINE", 120), ("LIN", 1400)])
def test_the_reader_has_the_points_and_stops_of_an_independent_reader(part, tmp_path, motion, limit):
    cell, original = part
    cell = cell.replace(program=cell.program.replace(line_limit=limit))
    run = compensated(cell, original, "spline").reference
    files = write_programs(tmp_path, cell, cell.target(), run, method="spline", date="2030-01-01", motions=[motion])
    folder = files[f"krl_{motion.lower()}"][0].parent
    main = f"{cell.program.name}_CMP"
    found, robot = read_krl(folder, main), Robot(folder, main)
    assert found.spline == (motion == "SPLINE") and found.number.tolist() == robot.numbers.tolist()
    assert [1, *robot.rests] == found.number[found.stops].tolist()
    assert found.pose.position == pytest.approx(robot.column("XYZ") * 1e-3, abs=1e-12)
    assert (len(files[f"krl_{motion.lower()}"]) > 4) == (limit == 120)
    assert any(time_law(cell)[:40] in line for line in robot.steps)


def test_a_point_without_a_frame_is_refused(part, tmp_path):
    cell, _ = part
    target = cell.target()
    files = write_programs(tmp_path, cell, target, target, method="spline", date="2030-01-01", motions=["SPLINE"])
    data = files["krl_spline"][0].parent / f"{cell.program.name}_CMP.dat"
    data.write_text(data.read_text().replace("DECL FRAME XP7=", "DECL FRAME XP7777="))
    with pytest.raises(InputError, match="XP7 has no frame"):
        read_krl(data.parent, f"{cell.program.name}_CMP")


def test_a_module_that_ends_between_two_stops_stops_the_robot_there(paper):
    cell, _ = paper
    program = cell.program.replace(line_limit=100)
    cell = cell.replace(program=program, timing=cell.timing.replace(controller_step=0.012))
    run = controller_motion(cell.target(), cell.target())
    written = written_trajectory(cell, run, "SPLINE")
    assert not run.standing.any() and written.standing[1:-1].any()
    assert not written_trajectory(cell.replace(program=program.replace(line_limit=1400)), run, "SPLINE").standing.any()


def test_a_controller_with_less_acceleration_reaches_the_same_points_later(part):
    cell, original = part
    run = compensated(cell, original, "inverse").reference
    same, softer = softer_pass(cell, run, 1.0), softer_pass(cell, run)
    assert same.reference.position == pytest.approx(run.position, abs=1e-12)
    np.testing.assert_allclose(same.reference.time_ns, run.time_ns, atol=1000)  # the ends of the ramps are interpolated
    assert softer.reference.duration_ns > run.duration_ns
    assert softer.scores.max_deviation > same.scores.max_deviation


def test_a_straight_cut_has_a_constant_feed_and_no_second_time_law(paper):
    cell, original = paper
    assert softer_pass(cell, original.reference) is None
    assert "constant feed of 4 m/min" in time_law(cell) and "run-in" in time_law(cell)
