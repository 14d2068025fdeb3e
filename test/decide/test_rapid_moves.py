"""Rapid moves through material: every one is a stop with its volume, and sound programs have none."""

from __future__ import annotations

import json

import numpy as np
import pytest
from program_table import DIAMETERS_MM, ISSUE, Row, dangerous, random_sound, sound, with_rapid_cut
from small_part import small_part

from kr270_milling.base.record import find_file
from kr270_milling.cell.cell import Cell, read_cell
from kr270_milling.cell.jobs import compensated, simulate
from kr270_milling.cli import main
from kr270_milling.decide.check import check
from kr270_milling.decide.check_cut import engagement, rapid_violations

STIFFNESS = {"rigid": 1e-3, "nominal": 1.0, "10 times softer": 10.0}  #: factor of the compliances
DANGEROUS = [row for diameter in DIAMETERS_MM for row in dangerous(diameter)]
SOUND = [row for diameter in DIAMETERS_MM for row in sound(diameter)]
BACK = "G21 G90 S8000 M3\nG0 X-14 Y0 Z2\nG0 Z-0.5\nG1 X26 F4000\nG0 Z-0.4\nG0 X-14\nG0 Z5\nM30\n"
THROUGH = "G21 G90 S8000 M3\nG0 X-14 Y0 Z2\nG0 Z-0.5\nG1 X12 F4000\nG0 X20\nG1 X26 F4000\nG0 Z5\nM30\n"
SHORT = ("timing.rapid_feed_m_per_min=4", "stock.grid_step_um=100")


def cell_of(directory, row: Row) -> Cell:
    return small_part(directory, row.program, *row.settings)


def moves(cell: Cell) -> list:
    """Along the programmed path; no pass is simulated."""
    return rapid_violations(cell, cell.target(), engagement(cell, cell.limits.rapid_contact))


def volume(contacts: list) -> float:
    return sum(one.amounts["volume_mm3"] for one in contacts)


@pytest.mark.parametrize("row", DANGEROUS, ids=lambda row: row.name)
def test_every_rapid_move_through_material_is_a_stop_with_its_volume(tmp_path, row):
    cell = cell_of(tmp_path, row)
    contacts = moves(cell)
    lines = {int(cell.fed_path.toolpath.line[one.block]) for one in contacts}
    assert contacts and all(one.severity == "stop" for one in contacts)
    assert not row.lines or lines == set(row.lines)
    assert 1e3 * max(one.value for one in contacts) == pytest.approx(row.depth_mm, rel=1e-6)
    assert volume(contacts) == pytest.approx(row.volume_mm3, rel=0.02)


@pytest.mark.parametrize("row", SOUND, ids=lambda row: row.name)
def test_a_sound_program_removes_nothing_by_rapid_moves(tmp_path, row):
    assert not moves(cell_of(tmp_path, row))


@pytest.mark.parametrize("seed", range(100))
def test_a_random_sound_program_is_released_and_a_rapid_plunge_in_it_is_a_stop(tmp_path, seed):
    row = random_sound(seed)
    assert not moves(cell_of(tmp_path, row))
    if seed % 10 == 0:
        row = with_rapid_cut(row)
        cell = cell_of(tmp_path, row)
        contacts = moves(cell)
        assert [int(cell.fed_path.toolpath.line[one.block]) for one in contacts] == list(row.lines)
        assert volume(contacts) == pytest.approx(row.volume_mm3, rel=0.02)


@pytest.mark.parametrize(("name", "file", "program", "line"), ISSUE, ids=[row[0] for row in ISSUE])
def test_the_programs_that_version_0_2_0_released_are_stops(tmp_path, name, file, program, line):
    path = tmp_path / "part.nc"
    path.write_text(program)
    stock = ("stock.min_mm=[-25,-25,-10]", "stock.max_mm=[25,25,0]")
    cell = read_cell(find_file("test_piece.yaml"), [f"path.file={path}", *(stock if file == "pocket" else ())])
    contacts = moves(cell)
    assert line in {int(cell.fed_path.toolpath.line[one.block]) for one in contacts}
    assert all(one.severity == "stop" for one in contacts) and volume(contacts) > 100.0


def test_the_shipped_examples_have_no_rapid_moves_in_material():
    for name in ("paper.yaml", "test_piece.yaml"):
        assert not moves(read_cell(find_file(name)))


@pytest.mark.parametrize("factor", STIFFNESS.values(), ids=STIFFNESS)
def test_the_answer_does_not_depend_on_the_stiffness_of_the_arm(tmp_path, factor):
    compliance = 1e6 * factor * read_cell(find_file("paper.yaml")).arm.joint_compliance
    soft = (*SHORT, f"arm.joint_compliance_urad_per_n_m={compliance.tolist()}", "dynamics.gravity=false")
    for program, answer in ((THROUGH, 2.0 * 10.0 * 8.0 * 0.5), (BACK, 0.0)):
        cell = small_part(tmp_path, program, *soft)
        for reference in (None, corrected(cell)):
            checked = check(cell, reference)
            assert checked.rapid_volume_mm3 == pytest.approx(answer, rel=0.02), checked.lines()
            stops = [f for f in checked.findings if f.what == "rapid in material"]
            assert [(f.severity, f.where.line) for f in stops] == [("stop", 5)] * bool(answer)


def corrected(cell: Cell, shift=(0.0, 5e-5, 0.0)):
    """The path with a constant correction [m]."""
    target = cell.target()
    return target.with_position(target.position + np.asarray(shift), target.velocity)


REAL = [(method, row) for method, diameter in (("spline", 6.0), ("mirror", 20.0), ("spline", 50.0))
        for row in (*dangerous(diameter), *sound(diameter))]  # fmt: skip


@pytest.mark.parametrize(("method", "row"), REAL, ids=[f"{method}, {row.name}" for method, row in REAL])
def test_the_answer_holds_for_the_corrected_path_of_a_method(tmp_path, method, row):
    grid = f"stock.grid_step_um={20 * row.diameter_mm:g}"
    cell = small_part(tmp_path, row.program, *row.settings, grid, "exchange.micro_step_deg=4", "exchange.period_ms=2")
    revised = compensated(cell, simulate(cell), method)
    assert not np.array_equal(revised.reference.position, cell.target().position)
    assert check(cell, revised.reference, ran=revised).rapid_volume_mm3 == pytest.approx(row.volume_mm3, rel=0.02)


def test_a_corrected_path_that_lowers_a_rapid_move_into_the_floor_is_a_stop(tmp_path):
    cell = small_part(tmp_path, BACK, *SHORT)
    target, fed = cell.target(), cell.timed_path
    back = fed.toolpath.line[fed.block] == 6
    lower = np.where(back, -0.6e-3, 0.0)[:, None] * [0.0, 0.0, 1.0]
    checked = check(cell, target.with_position(target.position + lower, target.velocity))
    stops = [f for f in checked.findings if f.what == "rapid in material"]
    assert stops and stops[0].where.line in (5, 6, 7) and checked.rapid_volume_mm3 > 0.0, checked.lines()


def test_terminal_and_json_give_line_depth_length_and_volume(tmp_path, capsys):
    (tmp_path / "part.nc").write_text(THROUGH)
    small_part(tmp_path, THROUGH)
    sets = (f"path.file={tmp_path / 'part.nc'}", "stock.min_mm=[0,-14,-10]", "stock.max_mm=[40,40,0]", *SHORT)
    words = ["check", "paper.yaml", *(part for pair in sets for part in ("--set", pair))]
    assert main(words) == 1
    text = capsys.readouterr().out
    assert "goes 8 mm through material, 0.5 mm deep at point" in text and "(line 5)" in text
    assert "removed by rapid moves: 80" in text
    assert main([*words, "--json"]) == 1
    answer = json.loads(capsys.readouterr().out)
    (move,) = answer["rapid_moves"]
    assert move["where"]["line"] == 5 and move["value"] == pytest.approx(0.5) and move["severity"] == "stop"
    assert move["amounts"] == pytest.approx({"length_mm": 8.0, "volume_mm3": 80.0}, rel=0.02)
    assert answer["removed_by_rapid_moves_mm3"] == pytest.approx(80.0, rel=0.02)


def test_a_sound_program_prints_a_volume_of_0(tmp_path):
    checked = check(small_part(tmp_path, BACK, *SHORT))
    assert "removed by rapid moves: 0 mm3" in checked.lines() and checked.may_be_run
    assert checked.as_dict()["removed_by_rapid_moves_mm3"] == 0.0
