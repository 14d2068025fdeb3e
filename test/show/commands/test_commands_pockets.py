"""From a CAM's file to the controller: a program of each dialect in two commands, and what the controller gets."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from krl_robot import Robot

from kr270_milling.cell.cell import read_cell
from kr270_milling.cli import main

PROGRAMS = Path(__file__).parents[2] / "path" / "programs"
DIALECTS = ["fusion_haas.nc", "freecad_linuxcnc.ngc", "mastercam_fanuc.nc", "linuxcnc.ngc", "haas.nc", "sinumerik.mpf"]
#: coarse, so that a pocket takes seconds
COARSE = (
    "stock.grid_step_um=100", "stock.floor_tolerance_um=10", "exchange.micro_step_deg=6", "exchange.period_ms=2",
    "timing.controller_step_ms=50", "dynamics.reference_inertia=false", "dynamics.posture_spacing_mm=20",
    'program.spindle_on=["$OUT[1]=TRUE"]', 'program.spindle_off=["$OUT[1]=FALSE"]',
)  # fmt: skip
SETS = [word for pair in COARSE for word in ("--set", pair)]


def run(capsys, *words) -> tuple[int, str]:
    code = main(list(map(str, words)))
    return code, capsys.readouterr().out


def drafted(capsys, directory: Path, name: str) -> Path:
    tool = ["--tool", "T1"] if name == "haas.nc" else []
    code, text = run(capsys, "init", "--gcode", PROGRAMS / name, *tool)
    (directory / "my.yaml").write_text(text)
    assert code == 0
    return directory / "my.yaml"


@pytest.mark.parametrize("name", DIALECTS)
def test_the_program_of_each_dialect_is_drafted_and_read_as_the_same_pocket(capsys, tmp_path, name):
    place = 1e3 * read_cell(drafted(capsys, tmp_path, name), COARSE).target().position
    assert_a_pocket(place, 1e-3)


@pytest.mark.parametrize("name", ["haas.nc", "sinumerik.mpf"])
def test_a_pocket_ends_in_a_program_a_report_and_a_decision(capsys, tmp_path, name):
    cell = drafted(capsys, tmp_path, name)
    code, text = run(capsys, "compensate", cell, "--method", "mirror", "--no-verdict", "--json", "--out",
                     tmp_path / "part", *SETS)  # fmt: skip
    result = json.loads(text)
    assert (
        code == 0 and result["may_be_run"] is True and result["decision"] == "caution" and result["method"] == "mirror"
    )
    for version in ("as_programmed", "compensated"):
        assert {"passes_tolerance", "wall_um", "floor_um"} <= set(result[version])
    assert result["compensated"]["wall_um"] < result["as_programmed"]["wall_um"]
    page = Path(result["report"]).read_text()
    assert '<span class="label">decision</span><strong>caution</strong>' in page
    folder = Path(result["programs"]["krl_spline"][0]).parent
    for kind in ("ORG", "CMP"):
        robot = Robot(folder, f"MILLING_{kind}")
        assert_a_pocket(robot.column("XYZ"), 1e3 * 100e-6 if kind == "CMP" else 1e-3)
        assert_in_order(robot)


def assert_a_pocket(place: np.ndarray, within: float) -> None:
    """28 by 20 mm of tool centre path with corners of 2 mm, 1 mm deep; within [mm]."""
    deep = place[place[:, 2] < -0.9]
    assert place[:, 2].min() == pytest.approx(-1.0, abs=within)
    np.testing.assert_allclose([*deep[:, :2].min(0), *deep[:, :2].max(0)], [-14, -10, 14, 10], atol=within)


def assert_in_order(robot: Robot) -> None:
    """Home, spindle, above the part, along the path, up, spindle off, home; never low before the approach."""
    moves = [line for line in robot.steps if line.startswith(("PTP", "LIN", "SPL ", "$OUT"))]
    assert moves[:4] == ["PTP XHOME", "$OUT[1]=TRUE", "PTP XAPPROACH", "LIN XP1"]
    assert moves[-3:] == ["LIN XRETRACT", "$OUT[1]=FALSE", "PTP XHOME"]
    assert robot.approach[2] >= 50.0 and not any("-0.0000" in line for line in robot.steps)


def test_check_accepts_a_drafted_cell(capsys, tmp_path):
    cell = drafted(capsys, tmp_path, "mastercam_fanuc.nc")
    code, text = run(capsys, "check", cell, "--json", *SETS)
    result = json.loads(text)
    assert code == 0 and result["may_be_run"] is True
    assert {row["word"]: row["count"] for row in result["read_over"]}["G43 H1"] == 1
    for finding in result["findings"]:
        assert set(finding) >= {"severity", "what", "where", "value", "limit", "unit", "advice", "count"}
        assert set(finding["where"]) == {"point", "line", "feature", "position_mm"}
        assert finding["severity"] in ("stop", "warning", "note")
