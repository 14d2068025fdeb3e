"""Corrected G-code, read back by our own reader: the corrected path, and all else of the source program."""

import re
from pathlib import Path

import numpy as np
import pytest
from hostile import refused, settings
from samples.small_part import small_part, swayed

from kr270_milling.cell.jobs import simulate
from kr270_milling.cell.models import path_of
from kr270_milling.decide.programs.gcode import check_gcode, write_gcode
from kr270_milling.path.cam.gcode.reader import read_gcode
from kr270_milling.path.cam.gcode.rewriter import GcodeSource, expanded, read_source

#: of six posts; linuxcnc.ngc has incremental moves, which are refused
PROGRAMS = Path(__file__).parents[2] / "path" / "programs"
POSTS = sorted(path for path in PROGRAMS.iterdir() if path.stem != "linuxcnc" and path.suffix != ".h")
#: a line, arcs in two planes, a stop, a cycle, a feed move of no length, M9 at the end of a move, block skip
PART = """\
%
O0007 (PLATE)
(T3 D=20. - FLAT END MILL)
N10 G90 G21 G17 T3 M6
N20 S8000 M3 (spindle)
N30 G0 X0 Y0 Z5
N40 G43 H3 Z1 M8
(leg)
N50 G1 Z-0.5 F600
N60 G1 Z-0.5 F2000 (no length)
N70 X10 (first) M7
/N80 Y10
N90 G02 X20 Y10 I5 J0
(arc upright)
N100 G18 G3 X26 Z-0.5 R6
N110 G17 G1 X28 Y10.01 M9
N120 G0 Z5
N130 S8000 M3 G81 X28 Y20 Z-2 R1 F300
N140 X30
N145 Y22
N150 G80
N160 G0 X5 Y20 Z1
N170 G1 Z-0.3 F600
N180 X20 F3000
N190 G28 G91 Z0
N200 M30
%
"""
INCHES = re.sub(r"([XYZIJRF])(-?[\d.]+)", lambda w: f"{w[1]}{float(w[2]) / 25.4:.6f}", PART.replace("G21", "G20"))


def test_a_finishing_pass_repeats_the_moves_of_the_program_after_a_way_back_above_the_part(tmp_path):
    cell = small_part(tmp_path, PART, "compensation.finish=1")
    path = path_of(cell).timed.toolpath
    once = small_part(tmp_path, PART)
    jobs = [[(each, swayed(path_of(each).target))] for each in (cell, once)]
    (written, (tool,)), (_, (single,)) = (
        write_gcode(tmp_path, job, method="inverse", date="2026-01-01") for job in jobs
    )
    read = read_gcode(written)
    assert tool.error < 3e-6 and tool.blocks > 1.9 * single.blocks
    assert read.position[~read.rapid].shape[0] >= path.position[~path.rapid].shape[0]
    low = np.minimum(read.position[1:, 2], read.position[:-1, 2])[read.rapid[1:]]
    sideways = np.hypot(*np.diff(read.position[:, :2], axis=0).T)[read.rapid[1:]] > 1e-6
    assert np.all(low[sideways] > 0.0)
    assert written.read_text().count("M30") == 1


def rows_of(path) -> list[np.ndarray]:
    """The places of each row of feed moves, (k, 3)."""
    feed = ~path.rapid & ~path.drilling
    rows: list[list] = []
    for block in np.flatnonzero(feed).tolist():
        if not feed[block - 1] or not rows:
            rows.append([path.position[block - 1]])
        rows[-1].append(path.position[block])
    return [np.array(row) for row in rows]


def far(points: np.ndarray, line: np.ndarray) -> np.ndarray:
    """Distance of points (m, 3) from a row of straight lines (k, 3)."""
    start, move = line[:-1], np.diff(line, axis=0)
    nearest = np.full(len(points), np.inf)
    for one, way in zip(start, move, strict=True):
        share = np.clip((points - one) @ way / (way @ way), 0, 1)
        nearest = np.minimum(nearest, np.linalg.norm(points - one - share[:, None] * way, axis=1))
    return nearest


@pytest.mark.parametrize(
    ("program", "half_digit", "tolerance_um"), [(PART, 0.05e-6, 2.0), (INCHES, 0.127e-6, 20.0)], ids=["G21", "G20"]
)
def test_the_read_program_is_the_corrected_path(tmp_path, program, half_digit, tolerance_um):
    cell = small_part(tmp_path, program, f"program.tolerance_um={tolerance_um}")
    run = swayed(path_of(cell).target, 0.1e-3)
    path, (written,) = write_gcode(tmp_path, [(cell, run)], method="spline", date="2026-11-23")
    read = read_gcode(path)
    rows, source = rows_of(read), rows_of(path_of(cell).timed.toolpath)
    assert len(rows) == len(source) == 2
    times = np.linspace(0, run.duration_ns, 10_000).astype(np.int64)
    fine, block = run.sample(times), path_of(cell).timed.block_at(times)
    cut = (~path_of(cell).timed.toolpath.rapid & ~path_of(cell).timed.toolpath.drilling)[block]
    tolerance, digit = 1e-6 * tolerance_um, np.sqrt(3) * half_digit
    half = len(times) // 2
    for row, programmed, now in zip(rows, source, (slice(0, half), slice(half, None)), strict=True):
        planned = fine[now][cut[now]]
        assert far(row, fine[now]).max() < 0.1e-6 + digit  # each written point is on the corrected path
        assert far(planned, row).max() < tolerance + digit  # and the lines between them follow that path
        assert far(planned, row).max() <= written.error + 0.1e-6
        for end in (0, -1):  # not on the programmed one
            assert 20e-6 < np.linalg.norm(row[end] - programmed[end]) < 0.2e-3
    assert written.error < tolerance + digit
    assert written.blocks == sum(len(row) - 1 for row in rows) and written.source_blocks == 8
    assert written.duration == pytest.approx(written.planned_duration, rel=0.1)
    assert written.planned_duration == pytest.approx(run.duration_ns * 1e-9, rel=0.01)  # no joint is at its limit


def test_everything_but_the_feed_moves_stays_in_place_and_order(tmp_path):
    cell = small_part(tmp_path, PART.replace("(spindle)", "(Müller)").encode("latin-1"))
    run = swayed(path_of(cell).target, 0.1e-3)
    path, _ = write_gcode(tmp_path, [(cell, run)], method="spline", date="2026-11-23", decision=["decision: (yes)"])
    text = path.read_text("latin-1")
    lines = text.splitlines()
    assert "S8000 M3 (Müller)" in text
    assert lines[:2] == PART.splitlines()[:2] and "(part program: decision: [yes])" in lines
    assert re.findall(r"N\d+", text) == re.findall(r"N\d+", PART)
    assert text.count("/N80") == 1 and text.count("\n/G1") > 0
    assert "N60 G1 F2000 (no length)" in lines
    assert re.search(r"N70 G1 X[\d.-]+ Y[\d.-]+ Z[\d.-]+ M7 \(first\)", text)
    assert re.search(r"N100 G18 G1 X[^IJKR]*\n", text)
    end = next(k for k, line in enumerate(lines) if line.startswith("N120"))
    assert lines[end - 1].endswith(" M9") and text.count("M9") == 1  # the coolant runs until the move has ended
    assert re.search(r"N160 G0 X[\d.]+ Y[\d.]+ Z[\d.]+\n", text)  # to the corrected start of the cut


MACRO = """%
O1 (PART)
G20 G90 G54
T1 M6 (10 mm end mill)
S5000 M3
o10 sub
(wall)
G0 X0 Y0 Z.5
G1 Z-#1 F[20*2]
G2 X1 Y0 I.5
G5.1 X1.5 Y1 I.5 J0
G0 Z.5
o10 endsub
o11 sub
M73 S3000 M4
M70 M5
M71
o11 endsub
G43.1 Z-2
G54 G0 X0 Y0 Z1
M70
o11 call
M72
o10 call [.1]
G52 X2 Z.1
o10 call [.2]
G52 X0 Z0
G68 X0 Y0 R30
G91 G93 G1 X3 F2
G90 G94 F30
G69
(holes)
G98 G81 X.3 Y.3 Z-.2 R.1
X.5 M8
G80
G91 G28 Z0
M30
%
"""


@pytest.mark.parametrize("post", [*POSTS, Path("macro.ngc"), Path("files.ngc")], ids=lambda path: path.name)
def test_programs_of_six_posts_and_one_with_macros_take_any_end_points(tmp_path, post):
    """In all of them the shift of each point by up to 0.1 mm is read back to the written digits.

    The sub-program of ``files`` is in another file.
    """
    tool = "T1" if post.stem == "haas" else ""
    macro = post.stem in ("macro", "files")
    if macro:
        before, sub, after = re.split(r"(?s)(o10 sub.*?endsub\n)", MACRO)
        (tmp_path / "10.ngc").write_text(sub)
        text = before + after if post.stem == "files" else MACRO
        post = tmp_path / post
        post.write_text(text)
    path = read_gcode(post, tool)
    source = read_source(post, {path.program.tool})
    written = source.lines_of(path, post, 0.0)
    cut = ~path.rapid & ~path.drilling
    wanted = path.position + np.random.default_rng(3).uniform(-1e-4, 1e-4, path.position.shape)
    ends = {line: wanted[cut & (written == line)] for line in np.unique(written[cut]).tolist()}
    copy = tmp_path / f"copy{post.suffix}"
    copy.write_text("\n".join(source.rewritten(ends)))
    read = read_gcode(copy, tool)
    moved = ~read.rapid & ~read.drilling
    assert np.abs(read.position[moved] - wanted[cut]).max() < 0.13e-6
    lines = iter(copy.read_text().splitlines())
    assert not re.search(r"^G54 X", copy.read_text(), re.M)  # its move has G0
    assert all(line in lines for k, line in enumerate(source.lines, 1) if k not in ends and line)
    assert source.written_out == macro and read.program.tools[0].diameter == path.program.tools[0].diameter
    assert [read.features[k] for k in read.feature[moved]] == [path.features[k] for k in path.feature[cut]]
    np.testing.assert_allclose(read.feed[moved], path.feed[cut], rtol=1e-12)
    np.testing.assert_array_equal(read.spindle_speed[moved], path.spindle_speed[cut])
    assert [tool.label for tool in read.program.tools] == [tool.label for tool in path.program.tools]


def test_start_sign_and_name_stay_the_first_lines_of_a_program_that_is_written_out():
    program = ["%", "O1042(PLATE)", "(FOR K1)", "#1=12", "G21 G90 S8000 M3", "G0 X0 Y0 Z2", "G1 X#1 F4000", "M30", "%"]
    lines = expanded("part.nc", program)
    assert lines[:4] == ["%", "O1042(PLATE)", "G21 G90 G17 G94 G40 G80", "(FOR K1)"] and lines[-3:] == ["M30", "%", ""]
    assert GcodeSource(tuple(lines), {}).head == 2


MOVE = "G21 G90 S8000 M3\nG0 X-14 Y0 Z2\nG0 Z-0.5\n"


@pytest.mark.parametrize(("program", "more", "message"), [
    (MOVE + "G91 G1 X26 F4000\nM30\n", [], "part.nc, line 4: the move is incremental"),
    (MOVE + "G1 X12 F4000\nG91 G0 Z5\nM30\n", [], "part.nc, line 5: the rapid move along Z is incremental"),
    (MOVE + "G1 X12 F4000\nG81 X12 Y0 Z-1 R1\nM30\n", [], "part.nc, line 5: the drilling cycle begins at the end"),
    (MOVE + "G93 G1 X12 F100\nM30\n", [], "part.nc, line 4: a feed in inverse time (G93)"),
    (MOVE + "G1 X12 F4000\nG28 X0 Y0\nM30\n", [], "line 5: the move home of X Y leaves sideways 0.5 mm below the top"),
    (MOVE + "G1 X12 F4000\nG91 G28 X0 Y0 Z0\nM30\n", [], "line 5: the move home of X Y Z leaves sideways 0.5 mm below"),
    (MOVE + "G1 X12 F4000\nG30\nM30\n", [], "line 5: the move home of X Y Z leaves sideways 0.5 mm below the top"),
    (MOVE + "G1 X12 F4000\nG0 Z-0.1\nG53 G0 X0\nM30\n", [], "line 6: the move home of X leaves sideways 0.1 mm below"),
    (MOVE.replace(" S8000 M3", "") + "G1 X12 F4000\nM30\n", ["program.spindle_on=[HALT]"], "with the spindle off"),
    (MOVE + "G1 X12 F4000\nM30\n", ["compensation.sag_compensated=false"], "--gcode: G-code states no joints"),
    (None, [], "--gcode: corrected G-code needs path.file"),
])  # fmt: skip
def test_a_program_that_cannot_be_corrected_is_refused_before_a_pass(tmp_path, program, more, message):
    if program:
        (tmp_path / "part.nc").write_text(program)
        more = [*more, f"path.file={tmp_path / 'part.nc'}", "stock.min_mm=[0,-14,-10]", "stock.max_mm=[40,40,0]"]
    out = tmp_path / "out"
    words = ["compensate", "paper.yaml", "--verdict", "0", "--gcode", "--out", str(out), *settings(*more)]
    assert message in refused(*words) and not out.exists()


@pytest.mark.parametrize("home", ["G0 Z0\nG28 X0 Y0", "G91 G28 Z0\nG28 X0 Y0", "G53 G0 Z0\nG53 X0 Y0", "G30 Z0\nG28"])
def test_a_tool_that_goes_up_before_it_goes_home_sideways_is_corrected(tmp_path, home):
    cell = small_part(tmp_path, f"{MOVE}G1 X12 F4000\n{home}\nM30\n")
    assert len(check_gcode([cell]).moves) >= 3


CORNERS = "G21 G90 S8000 M3\n{}\nG0 X0 Y0 Z1\nG1 Z-0.3 F600\nX10 F3000\nX18 Y1\nX26 Y4\nG0 Z5\nM30\n"


@pytest.mark.parametrize(("words", "rounding", "blend"), [
    ("G64 P0.004", 4e-6, 0.0), ("G64 P0.5", 0.5e-3, 0.0), ("G61", 0.0, 0.0), ("G64", 0.0, 0.2e-3), ("", 0.0, 2e-3),
])  # fmt: skip
def test_the_figures_are_those_of_the_rounded_corners(tmp_path, words, rounding, blend):
    """A parabola from d before a point misses it by d |e1 - e0| / 4; P of G64 is that miss, d at most half a block."""
    settings = f"program.blend_distance_mm={1e3 * blend}", "program.tolerance_um=500"
    cell = small_part(tmp_path, CORNERS.format(words), *settings)
    target = path_of(cell).target
    assert cell.path.source.rounding == pytest.approx(rounding)
    path, (written,) = write_gcode(tmp_path, [(cell, target)], method="none", date="2026-11-23")
    most = 0.0
    for row in rows_of(read_gcode(path)):
        length = np.linalg.norm(np.diff(row, axis=0), axis=1)
        turn = np.linalg.norm(np.diff(np.diff(row, axis=0) / length[:, None], axis=0), axis=1)
        wanted = 4 * rounding / np.maximum(turn, 1e-9) if rounding else blend
        d = np.minimum(wanted, np.minimum(length[1:], length[:-1]) / 2)
        most = max(most, np.max(d * turn / 4, initial=0.0))
    assert written.blended == pytest.approx(max(most, written.error), abs=0.2e-6)
    moved = abs(written.deviation - simulate(cell, target).scores.max_deviation)
    assert (moved > 10e-6) == (most > 10e-6)
    assert f"with rounded corners within {1e6 * written.blended:.2g} um" in written.text
