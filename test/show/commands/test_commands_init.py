"""``init`` prints a cell that is read without a change; ``keys`` lists what the records check."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml
from hostile import answered, ask, refused

from kr270_milling.base.record import Record, flatten, specs
from kr270_milling.cell.cell import Cell, read_cell
from kr270_milling.cell.keys import keys_of

PROGRAMS = Path(__file__).parents[2] / "path" / "programs"
TEST_PIECE = Path(__file__).parents[3] / "config" / "test_piece.nc"
#: a shallow slot beside which the tool comes down
SLOT = "(T1 D=10 - flat end mill, 4 flutes)\nG21 G90 G54\nS6000 M3\nG0 X-20 Y0 Z5\nZ-0.5\nG1 X-2 F1200\nG0 Z5\nM30\n"


def printed(*words) -> str:
    answer = ask("init", *map(str, words))
    assert answer.code == 0 and answer.err == ""
    return answer.out


def cell_of(tmp_path, *words):
    (tmp_path / "my.yaml").write_text(printed(*words))
    return read_cell(tmp_path / "my.yaml")


@pytest.mark.parametrize(("name", "robot"), [
    ("fusion_haas.nc", "kr270_2"), ("fusion_grbl.nc", "kr270_r2700_ultra"), ("freecad_linuxcnc.ngc", "kr270_2"),
    ("mastercam_fanuc.nc", "kr270_r2700_ultra"), ("linuxcnc.ngc", "kr270_2"), ("sinumerik.mpf", "kr270_r2700_ultra"),
    ("haas.nc", "kr270_r2700_ultra"),
])  # fmt: skip
def test_a_cell_for_each_dialect_reaches_the_whole_pocket(tmp_path, name, robot):
    tool = ["--tool", "T1"] if name == "haas.nc" else []
    cell = cell_of(tmp_path, "--gcode", PROGRAMS / name, "--robot", robot, *tool)
    assert cell.tool.spindle_speed * 30 / np.pi == pytest.approx(5000)
    assert cell.tool.diameter == pytest.approx(0.010)
    np.testing.assert_allclose(1e3 * cell.stock.min, [-24, -20, -6], atol=1e-9)
    np.testing.assert_allclose(1e3 * cell.stock.max, [24, 20, 0], atol=1e-9)
    assert len(cell.target()) > 1000  # on the joints of the arm
    np.testing.assert_allclose(1e3 * cell.workpiece.xyz, [1500, 0, 800])


def test_the_stock_leaves_room_where_the_tool_comes_down_rapidly(tmp_path):
    (tmp_path / "slot.nc").write_text(SLOT)
    cell = cell_of(tmp_path, "--gcode", tmp_path / "slot.nc")
    assert cell.stock.min[0] >= -20e-3 + cell.tool.radius and cell.stock.max[0] >= 0.0
    piece = cell_of(tmp_path, "--gcode", TEST_PIECE)
    path = piece.timed_path.toolpath
    down = path.position[path.rapid & (path.position[:, 2] < 0.0)][:, :2]
    beside = np.maximum(np.maximum(piece.stock.min[:2] - down, down - piece.stock.max[:2]), 0.0)
    assert np.hypot(*beside.T).min() > piece.tool.radius


def test_a_program_that_takes_an_hour_is_modelled_at_as_many_postures_as_a_cell_may_have(tmp_path):
    (tmp_path / "slow.nc").write_text(SLOT.replace("F1200", "F1"))  # 18 mm at 1 mm/min
    cell = cell_of(tmp_path, "--gcode", tmp_path / "slow.nc")
    assert cell.target().duration_ns > 1000e9 and cell.dynamics.posture_spacing > 5e-3
    assert len(cell._postures(cell.target())[1]) < 50_000  # more than 100,000 are refused


def test_a_written_cell_moves_with_the_program_beside_it_and_an_error_leaves_no_file(tmp_path):
    (tmp_path / "part").mkdir()
    (tmp_path / "part" / "air.nc").write_text("G21 S6000 M3\nG0 X0 Y0 Z5\nX10 F600\nM30\n")
    (tmp_path / "part" / "slot.nc").write_text(SLOT)
    cell = tmp_path / "my.yaml"
    words = ("init", "--out", str(cell), "--gcode")
    assert "has no cutting move" in refused(*words, str(tmp_path / "part" / "air.nc")) and not cell.exists()
    assert "lines marked yours are guesses" in ask(*words, str(tmp_path / "part" / "slot.nc")).out
    moved = tmp_path.rename(tmp_path.with_name("moved")) / "my.yaml"
    drafted = yaml.safe_load(moved.read_text())["/**"]["ros__parameters"]
    assert drafted["path"]["file"] == "part/slot.nc" and drafted["program"]["name"] == "SLOT"
    assert "fixtures_mm" in drafted["workpiece"] and read_cell(moved).path.file.endswith("/moved/part/slot.nc")
    defaults = {row["key"].partition(".")[2]: row["default"] for row in keys_of("uncertainty")}
    assert drafted["uncertainty"].items() <= defaults.items()
    assert "exists already" in refused("init", "--out", str(moved))


def test_a_cell_without_a_program_is_a_straight_cut(tmp_path):
    cell = cell_of(tmp_path)
    assert cell.path.length == pytest.approx(0.040) and not cell.path.file


def test_a_program_with_several_tools_gives_a_cell_with_tools():
    cell = yaml.safe_load(printed("--gcode", PROGRAMS / "haas.nc"))["/**"]["ros__parameters"]
    assert "tool" not in cell and [one["diameter_mm"] for one in cell["tools"].values()] == [10.0, 6.0]
    sentence = refused("init", "--gcode", str(PROGRAMS / "haas.nc"), "--tool", "T9")
    assert "does not cut with T9; it does with T1" in sentence


def test_json_has_the_cell_with_marked_guesses_and_the_words_of_the_program():
    answer = answered("init", "--gcode", PROGRAMS / "sinumerik.mpf")
    assert yaml.safe_load(answer["cell"])["/**"]["ros__parameters"]["tool"]["diameter_mm"] == 10.0
    for text in ("teeth: 4                           # yours:", "# yours: the arm", "# [source: the program's S]"):
        assert text in answer["cell"]
    assert answer["program"]["work_offset"] == "G54"


# --- keys ---


def leaves(record: type[Record]) -> int:
    return sum(leaves(s.kind) if issubclass(s.kind, Record) else 1 for s in specs(record))


def test_every_parameter_has_a_key_with_a_meaning():
    result = keys_of()
    names = {key["key"] for key in result}
    assert len(result) == leaves(Cell) == len(names)
    assert all(key["text"] or key["choices"] for key in result)
    shipped = flatten(read_cell(TEST_PIECE.with_suffix(".yaml")))
    rest = names - set(shipped)
    assert set(shipped) < names and all(key.startswith("cutting.fractional") for key in rest)


def test_keys_of_a_section_have_bounds_and_defaults_in_their_unit():
    rows = {row["key"]: row for row in answered("keys", "timing")["keys"]}
    step = rows["timing.controller_step_ms"]
    assert (step["unit"], step["low"], step["high"], step["default"], step["required"]) == ("ms", 1, 1000, 50, False)
    table = ask("keys", "cutting.linear_edge").out
    assert "cutting.linear_edge.tangential_cutting_n_per_mm2" in table and "K_tc" in table
    assert "known are arm" in refused("keys", "tols")
