"""Several tools in one program: the stock passes from tool to tool, and there is one decision."""

import re
from pathlib import Path

import numpy as np
import pytest
from hostile import answered, ask, settings
from samples.milled_part import RIGID

from kr270_milling.base.errors import ConfigError, InputError
from kr270_milling.base.parameter_file import find_file
from kr270_milling.cell.cell import Cell
from kr270_milling.cell.cell_file import read_cell, read_cells
from kr270_milling.cell.jobs import simulate
from kr270_milling.cell.models import path_of
from kr270_milling.cell.plant import coarser
from kr270_milling.cell.stage import swept
from kr270_milling.decide.check import check
from kr270_milling.decide.check_cut import engagement, rapid_violations
from kr270_milling.decide.compensation import in_turn
from kr270_milling.decide.part import assess
from kr270_milling.path.cam.gcode.reader import read_gcode

pytestmark = pytest.mark.usefixtures("few_robots")
#: a plate whose height maps have no level at half of a millimetre; a coarse and quick model
STOCK = ("stock.min_mm=[-30,-15,-9]", "stock.max_mm=[30,15,0]")
QUICK = (
    *STOCK, "stock.grid_step_um=50", "exchange.period_ms=0.5", "exchange.micro_step_deg=3", "tool.spindle_speed_rpm=0",
    "dynamics.follow_pose=false", "stock.floor_tolerance_um=0.2",
)  # fmt: skip


def tool_cells(folder, program: str, tools: dict[str, dict], *more: str) -> tuple[Cell, ...]:
    """The cells of a program, written into a folder, with ``tools`` in the shipped cell of the test piece."""
    path = Path(folder) / "part.nc"
    path.write_text(program)
    return read_cells(find_file("test_piece.yaml"), [*QUICK, f"path.file={path}", f"tools={tools}", *more])


def operation(tool: str, *moves: str, speed: int = 6000) -> str:
    return "\n".join([f"{tool} M6", f"S{speed} M3", *moves, "G0 Z20", "M5", ""])


ALONG = ("G0 X-40 Y0 Z5", "G0 Z-1", "G1 X40 F3000")  #: a slot over the whole stock, 1 mm deep
ACROSS = ("G0 X0 Y-25 Z5", "G0 Z-2", "G1 Y25 F3000")  #: 2 mm deep
HEAD, END = "G21 G90\n", "M30\n"
#: facing, a pocket with a helical ramp, a finished wall
PLATE = (
    "(T1 D=40. CR=0. - ZMIN=-0.5 - FACE MILL)\n(T2 D=10. CR=0. - ZMIN=-3. - FLAT END MILL 3 FLUTES)\n"
    "(T3 D=10. CR=0. - ZMIN=-3. - FLAT END MILL 3 FLUTES)\nG90 G94 G17 G21 G54\n"
    + "(FACE1)\n" + operation("T1", "G0 X-55 Y0", "Z15", "Z-0.5", "(LEAD IN)", "G1 X55 F1500", speed=3000)
    + "(POCKET2)\n" + operation(
        "T2", "G0 X0 Y0", "Z15", "Z2", "(HELICAL RAMP)", "G1 Z0 F1200", "X2", "G3 X2 Y0 Z-3 I-2 J0",
        "G1 X5.7 F2000", "G3 X5.7 Y0 I-5.7 J0", speed=8000)
    + "(CONTOUR3)\n" + operation(
        "T3", "G0 X5 Y0", "Z15", "Z-2", "G1 Z-3 F500", "X6 F1500", "G3 X6 Y0 I-6 J0", "G1 X5", speed=9000)
    + END
)  # fmt: skip
LARGE, SMALL = {"diameter_mm": 10, "teeth": 2}, {"diameter_mm": 6, "teeth": 2}
SLOTS = HEAD + operation("T1", *ALONG) + operation("T2", *ACROSS) + END
TWICE = HEAD + operation("T1", *ALONG) + operation("T2", *ALONG) + END


def run_in_turn(cells):
    return in_turn(cells, simulate, lambda ran: ran)


@pytest.mark.parametrize(("detail", "first"), [("cutting.detail=teeth", "T1"), ("cutting.detail=engagement", "T2")])
def test_two_tools_remove_the_union_of_their_slots(tmp_path, detail, first):
    slots = [operation("T1", *ALONG), operation("T2", *ACROSS)]
    program = HEAD + "".join(slots if first == "T1" else slots[::-1]) + END
    done = run_in_turn(tool_cells(tmp_path, program, {"T1": LARGE, "T2": SMALL}, detail, RIGID))
    alone, both = {"T1": 60 * 10 * 1, "T2": 30 * 6 * 2}, 6 * 10 * 1  # [mm3], closed form
    assert done[0][0].stage.tool == first
    for (cell, ran), shared in zip(done, (0, both), strict=True):
        assert 1e9 * ran.result.removed_volume == pytest.approx(alone[cell.stage.tool] - shared, rel=0.01)
    assert not any(check(cell, ran=ran).count("stop") for cell, ran in done)


@pytest.mark.parametrize("detail", ["cutting.detail=teeth", "cutting.detail=engagement"])
def test_the_second_tool_on_the_same_path_removes_nothing(tmp_path, detail):
    (_, cuts), (_, second) = run_in_turn(tool_cells(tmp_path, TWICE, {"T1": LARGE, "T2": LARGE}, detail, RIGID))
    assert np.abs(cuts.result.wrench).max() > 50.0
    assert second.result.removed_volume == 0.0 and not second.result.wrench.any()


def test_a_soft_arm_leaves_material_that_the_next_tool_finds(tmp_path):
    (_, first), (cell, second) = run_in_turn(tool_cells(tmp_path, TWICE, {"T1": LARGE, "T2": LARGE}))
    missed = np.abs(first.result.actual - first.result.target)[first.result.volume > 0.0, 1].mean()
    assert 1e9 * second.result.removed_volume == pytest.approx(1e9 * missed * 60e-3 * 1e-3, rel=0.5)
    (moved,) = cell.stage.earlier
    assert moved.spring_back > 0.5 * missed
    (quick,) = coarser(cell).stage.earlier  # simulated robots begin with fewer places, and nearly the same stock
    assert len(quick.actual) < 0.7 * len(moved.actual)
    left, few = (swept((removal,), cell.stock, True).map_heights()[2] for removal in (moved, quick))
    assert 0.0 < np.abs(few - left).sum() < 1e-3 * np.abs(left).sum()


def test_rapid_moves_where_the_tool_before_has_cut_are_no_contact(tmp_path):
    inside = ("G0 X-20 Y0 Z5", "G0 Z-1", "G0 X0", "G1 Z-2 F500", "G1 X20 F1000")
    program = HEAD + operation("T1", *ALONG) + operation("T2", *inside) + END
    cells = tool_cells(tmp_path, program, {"T1": LARGE, "T2": SMALL})
    alone = cells[1].replace(stage=None)
    margin = alone.limits.rapid_contact
    contacts = [rapid_violations(path_of(cell).target, engagement(cell, margin)) for cell in (cells[1], alone)]
    assert not contacts[0] and len(contacts[1]) == 2
    depth = engagement(cells[1], 0.0).depth.max(), engagement(alone, 0.0).depth.max()
    assert depth == (pytest.approx(1e-3), pytest.approx(2e-3))


def test_walls_and_floors_belong_to_the_last_tool_that_passes_there(tmp_path):
    """T1 leaves 0.3 mm at a wall, which T2 removes with a strip of the floor, from y = -10.4 to -4.4 mm."""
    rough = ("G0 X-45 Y-14.7 Z5", "G0 Z-1", "G1 X45 F3000")
    finish = ("G0 X-45 Y-7.4 Z5", "G0 Z-1", "G1 X45 F3000")
    program = HEAD + operation("T1", *rough) + operation("T2", *finish) + END
    tools = {"T1": {"diameter_mm": 20, "teeth": 2}, "T2": SMALL}
    (first, roughed), (second, finished) = run_in_turn(tool_cells(tmp_path, program, tools))
    before, after = assess(first, roughed), assess(second, finished)
    assert not before.walls.error.size and after.walls.error.size
    assert assess(first.replace(stage=None), roughed).walls.error.size
    for part, low, high in ((before, -15.0, -10.4), (after, -10.4, -4.4)):
        floors = part.floors
        own = 1e3 * floors.y[np.isfinite(floors.error).any(axis=0)]
        assert own.min() == pytest.approx(low, abs=0.4) and own.max() == pytest.approx(high, abs=0.4)
        assert low - 0.05 < own.min() and own.max() < high + 0.05


def test_a_tool_overrides_sections_and_one_tool_can_be_chosen(tmp_path):
    tools = {"T1": LARGE, "T2": SMALL | {"cutting": {"linear_edge": {"tangential_cutting_n_per_mm2": 700.0}}}}
    first, second = tool_cells(tmp_path, SLOTS, tools)
    assert second.cutting.active.tangential_cutting == 700e6 != first.cutting.active.tangential_cutting
    assert (first.krl.name, second.krl.name) == ("MILLING_T1", "MILLING_T2")
    (chosen,) = tool_cells(tmp_path, SLOTS, tools, "path.tool=T2")
    assert chosen.tool.diameter == 6e-3 and [one.tool for one in chosen.stage.earlier] == ["T1"]


@pytest.mark.parametrize(("tools", "more", "message"), [
    ({"T1": LARGE}, "", r"tools\.T2: is missing: the program cuts with T2"),
    ({"T1": LARGE, "T2": {"teeth": 2, "diameter": 6}}, "", r"tools\.T2\.diameter: is not a known key"),
    ({"T1": LARGE, "T2": SMALL | {"stock": {"min_mm": [0, 0, 0]}}}, "", r"tools\.T2\.stock: must not have min_mm"),
    ({"T1": LARGE, "T2": SMALL}, "path.tool=T9", r"path\.tool: 'T9' is not usable, it must be one of T1, T2"),
    ({"T1": LARGE, "T2": SMALL}, "program.name=LONGEST_NAME_1", r"program\.name: .*16 characters.*with the tool"),
    ({"T1": LARGE, "T2": SMALL}, "path.file=", r"tools: needs a program in path\.file"),
])  # fmt: skip
def test_tools_that_do_not_fit_are_refused(tmp_path, tools, more, message):
    with pytest.raises(ConfigError, match=message):
        tool_cells(tmp_path, SLOTS, tools, *filter(None, [more]))


def test_a_further_run_of_a_tool_has_the_keys_of_the_tool_and_takes_what_is_left(tmp_path):
    deeper = operation("T1", *ALONG[:1], "G0 Z-1", "G1 X-35 Z-2 F3000", "X40", speed=7000)
    program = SLOTS.replace(END, operation("T1", *ALONG) + deeper) + END
    cells = tool_cells(tmp_path, program, {"T1": LARGE, "T2": SMALL, "T1_3": {**LARGE, "teeth": 3}}, RIGID)
    assert [(cell.stage.tool, cell.stage.suffix) for cell in cells[2:]] == [("T1_2", "_N3"), ("T1_3", "_N4")]
    assert [cell.tool.teeth for cell in cells] == [2, 2, 2, 3] and not any(cell.stage.same_tip for cell in cells[2:3])
    assert [cell.tool.spindle_speed for cell in cells[2:]] == pytest.approx([200 * np.pi, 700 / 3 * np.pi])
    removed = [1e9 * ran.result.removed_volume for _, ran in run_in_turn(cells)]
    assert removed == pytest.approx([600, 360 - 60, 0, 600 - 60], rel=5e-3)  # [mm3], closed form


def test_a_run_that_the_program_does_not_make_and_a_command_for_one_tool_are_refused(tmp_path, drafted):
    with pytest.raises(ConfigError, match=r"path\.tool: 'T1_2' .*one of T1, T2"):
        tool_cells(tmp_path, SLOTS, {"T1": LARGE, "T2": SMALL}, "path.tool=T1_2")
    twice = SLOTS.replace("T2", 'T="T1_2"').replace(END, operation("T1", *ALONG)) + END
    (tmp_path / "twice.nc").write_text(twice)
    with pytest.raises(InputError, match=r"T1_2 is the name of a tool and of a further run"):
        read_gcode(tmp_path / "twice.nc", "T1_2")
    with pytest.raises(ConfigError, match=r"has 3 tools, .* --set path\.tool=T1"):
        read_cell(drafted, STOCK)


@pytest.fixture(scope="module")
def drafted(tmp_path_factory):
    """The cell that ``init`` writes for the plate."""
    folder = tmp_path_factory.mktemp("plate")
    (folder / "plate.nc").write_text(PLATE)
    (folder / "cell.yaml").write_text(ask("init", "--gcode", str(folder / "plate.nc")).out)
    return folder / "cell.yaml"


FAST = settings(
    *STOCK,
    "cutting.detail=engagement",
    "dynamics.follow_pose=false",
    "compensation.method=mirror",
    "cutting.end_share=0",
)


def test_a_program_with_three_tools_is_checked_and_compensated_as_one(drafted, tmp_path):
    words = (*FAST, "--verdict", "0", "--gcode", "--write", "joints,rsi", "--out", tmp_path / "out")
    answer = answered("compensate", drafted, *words)
    assert answer["decision"] == "caution" and answer["may_be_run"]
    assert [one["tool"] for one in answer["tools"]] == ["T1", "T2", "T3"]
    assert not any(one["check"]["removed_by_rapid_moves_mm3"] for one in answer["tools"])
    programs = [path for one in answer["tools"] for path in one["programs"]["krl_spline"]]
    names = [path.rpartition("/")[2] for path in programs]
    assert len(set(names)) == len(names) and {"PLATE_T1_CMP.src", "PLATE_T3_ORG.dat"} <= set(names)
    tables = [path for one in answer["tools"] for kind in ("rsi", "joints") for path in one["programs"][kind]]
    assert len(set(tables)) == 9
    manifest = (tmp_path / "out" / "MANIFEST.txt").read_text()
    assert f"decision: caution: {answer['sentence']}" in manifest
    corrected = Path(answer["gcode"]["file"])  # one program with all tools
    assert corrected.name in manifest and "(part program: decision: caution: " in corrected.read_text()
    for cell, one in zip(read_cells(drafted, STOCK), answer["gcode"]["tools"], strict=True):
        read = read_gcode(corrected, one["tool"])
        assert one["error_um"] < 2.1 and one["blocks"] == np.count_nonzero(~read.rapid) > one["source_blocks"]
        assert read.length == pytest.approx(path_of(cell).timed.toolpath.length, rel=0.01)
    for one in answer["tools"]:  # one after the other the tools leave the part
        assert one["compensated"]["deciding_error_um"] < one["as_programmed"]["deciding_error_um"]


JUDGED = Path(__file__).parent / "judged"
DRILLED = ("sound/drill_alone_g83", "sound/drill_last", "dangerous/rapid_sideways_out_of_a_hole")


@pytest.mark.parametrize("name", DRILLED)
def test_compensate_and_check_of_a_drill_alone_give_the_answer_that_a_judged_program_expects(tmp_path, name):
    program, sound = JUDGED / f"{name}.nc", name.startswith("sound")
    (tmp_path / "cell.yaml").write_text(ask("init", "--gcode", str(program)).out)
    changes = settings("compensation.method=mirror", *re.findall(r"\(set: (.*)\)", program.read_text()))
    words, out = (tmp_path / "cell.yaml", *changes), tmp_path / "out"
    answer = answered("compensate", *words, "--verdict", "0", "--gcode", "--out", out, code=int(not sound))
    rows = answer.get("tools", [answer])
    stops = {f["what"] for row in rows for f in row["check"]["findings"] if f["severity"] == "stop"}
    assert stops == (set() if sound else {"rapid in material"})
    if "tools" in answer:
        assert answered("check", *words, *settings("path.tool=T3"))["may_be_run"]
    drill = next(row for row in rows if row["check"]["notes"])
    assert drill["method"] == "none" and drill["as_programmed"]["passes_tolerance"] is (None if sound else False)
    assert ("not judged: no milled wall or floor" in (out / "MANIFEST.txt").read_text()) == sound
    assert bool(list(out.glob("krl_*"))) == bool(list(out.glob("gcode_*"))) == sound
    assert "nan um" not in (out / "report.html").read_text()


def test_a_stop_of_one_tool_stops_the_program(drafted, tmp_path):
    program = tmp_path / "dangerous.nc"
    program.write_text(PLATE.replace("G1 X5.7 F2000", "G0 X5.7"))
    words, out = [str(drafted), *FAST, *settings(f"path.file={program}")], tmp_path / "out"
    answer = answered("compensate", *words, "--verdict", "0", "--gcode", "--out", out, code=1)
    assert answer["decision"] == "no" and answer["deciding_tool"] == "T2" and "rapid" in answer["sentence"]
    assert [one["level"] for one in answer["tools"]] == ["caution", "no", "caution"]
    assert not [*out.glob("krl_*"), *out.glob("*gcode_*")]
    assert "NOT RELEASED" in (out / "MANIFEST.txt").read_text()
    assert "must not be run: stops of T2" in ask("check", *words).out
