"""The command compensate: what it writes and prints, and that unusable input leaves nothing behind."""

import functools
import re
from pathlib import Path

import numpy as np
import pytest
from hostile import answered, ask, contents, printed, refused, settings
from samples.small_part import GCODE, assignments

from kr270_milling.base.errors import InputError
from kr270_milling.cli import main
from kr270_milling.decide import levers
from kr270_milling.decide.programs import krl

pytestmark = pytest.mark.usefixtures("few_robots")


@pytest.fixture
def quick(monkeypatch):
    """Without the report, which is not what the test is about."""
    monkeypatch.setattr("kr270_milling.show.commands.compensate.report_text", lambda *_, **__: "figures left out")


def command(tmp_path, *words: str, gcode: str | bytes = GCODE, sets=()) -> list[str]:
    pairs = settings(*assignments(tmp_path, gcode, *sets))
    return ["compensate", "paper.yaml", "--out", str(tmp_path / "out"), "--verdict", "0", *words, *pairs]


def test_a_tool_path_ends_with_table_report_programs_and_findings(tmp_path):
    words = ("--method", "spline", "--krl", "SPLINE", "--krl", "LIN", "--write", "joints,rsi,stl")
    answer = ask(*command(tmp_path, *words))
    out = tmp_path / "out"
    assert answer.code == 0 and "Commanded joints [deg]" in (out / "report.html").read_text()
    assert all(word in answer.out for word in ("leg", "arc", "whole part", "largest correction", "0 stops"))
    assert "decision: caution: largest wall or floor error is" in answer.out
    for motion in ("lin", "spline"):
        folder = {p.name for p in next(out.glob(f"krl_{motion}_*")).iterdir()}
        assert folder == {f"MILLING_{kind}.{end}" for kind in ("ORG", "CMP") for end in ("src", "dat")}
    assert "LIN XP" in (next(out.glob("krl_lin_*")) / "MILLING_CMP.src").read_text()
    (label,) = {p.name.partition("_lin_")[2] for p in out.glob("krl_lin_*")}
    tables = {f"joints_original_{label}.csv", f"joints_{label}.csv", f"rsi_offsets_{label}.csv", "reference_spline.csv"}
    assert {p.name for p in out.iterdir() if p.is_file()} == {"MANIFEST.txt", "part_spline.stl", "report.html", *tables}
    manifest = (out / "MANIFEST.txt").read_text()
    assert all(name in manifest and (out / name).read_text().startswith("time_s,") for name in tables)
    assert "every 12 ms" in manifest and "joint_1_deg to joint_6_deg" in manifest and "T1, 10 %" in manifest
    assert [p.name for p in tmp_path.iterdir() if p.name.startswith(".")] == []


def test_json_has_features_and_paths_and_the_reference_is_checked_and_simulated_as_predicted(quick, tmp_path):
    result = answered(*command(tmp_path, "--method", "linear", "--write", "stl"))
    rows = {name: {row["feature"]: row for row in table} for name, table in result["features"].items()}
    assert set(rows) == {"original", "linear"} and {"leg", "arc", "whole part"} <= set(rows["original"])
    before, after = (rows[name]["whole part"]["max_normal_um"] for name in ("original", "linear"))
    assert after < 0.4 * before and np.isfinite(rows["linear"]["whole part"]["max_wall_error_um"])
    assert result["check"]["may_be_run"] and result["limited"] == [] and result["verdict"] is None
    assert result["chord_error_um"] == pytest.approx(10.0, rel=0.02)  # 0.8 mm chords of a circle of 8 mm radius
    assert "krl_lin" in result["programs"]  # linear corrects in straight lines
    paths = [p for kind in result["programs"].values() for p in kind]
    paths += [result[key] for key in ("trajectory", "report", "part")]
    assert all((tmp_path / "out").joinpath(p).is_file() for p in paths)

    words = ["paper.yaml", "--reference", result["trajectory"], *settings(*assignments(tmp_path))]
    checked = answered("check", *words)["findings"]
    written = [f["what"] for f in result["check"]["findings"]]
    assert written[0] == "written program" and [f["what"] for f in checked] == written[1:]  # LIN motions are blended
    again = answered("simulate", *words)["max_deviation_um"]
    assert again == pytest.approx(result["planned_max_deviation_um"], rel=1e-6)
    assert after < answered("simulate", *words)["whole_part"]["max_normal_um"]  # arcs of the program, not chords


def test_a_straight_cut_keeps_its_contract_and_gets_programs_and_a_reference(tmp_path):
    cell = ["paper.yaml", *settings("path.length_mm=20", "stock.grid_step_um=40", "stock.max_mm=[20,12,0]")]
    result = answered("compensate", *cell, "--method", "spline", "--out", tmp_path / "out", "--verdict", "0")
    assert set(result["programs"]) == {"krl_spline", "manifest"} and "part" not in result
    assert "<h1>paper.yaml: before and after" in Path(result["report"]).read_text()
    assert result["max_deviation_um"] < 0.1 * result["original"]["max_deviation_um"]
    again = answered("simulate", *cell, "--reference", result["trajectory"])["max_deviation_um"]
    assert again == pytest.approx(result["planned_max_deviation_um"], rel=1e-6)
    assert again == pytest.approx(result["max_deviation_um"], abs=0.5)  # of the fewer points of the program


def test_limited_corrections_are_a_warning_and_a_stop_leaves_no_program(quick, tmp_path):
    sets = ["compensation.max_correction_mm=0.03", "limits.spindle_power_kw=0.01"]
    answer = ask(*command(tmp_path, sets=sets))
    finding = r"\nwarning +the correction is too large at points \d+ to \d+: .* left out at point \d+"
    assert re.search(finding, answer.out)
    assert answer.code == 1 and answer.out.startswith("decision: no: the path must not be run: the spindle power")
    assert not list((tmp_path / "out").glob("krl*")) and "no robot program is written" in answer.out


def test_programs_of_an_earlier_run_move_aside_also_where_the_decision_is_no(quick, tmp_path):
    """A second cell gives other programs of the same names; no program stays in the folder after the decision no."""
    out, older = tmp_path / "out", tmp_path / "out" / "older"
    ask(*command(tmp_path, "--method", "linear", "--write", "joints,rsi"))
    first = {path.name for path in [*out.glob("krl_*"), *out.glob("joints_*"), *out.glob("rsi_*")]}
    assert len(first) == 4 and not older.exists()
    answer = ask(*command(tmp_path, "--method", "linear", sets=["limits.spindle_power_kw=0.01"]))
    assert answer.code == 1 and f"programs of an earlier run moved to {older}" in answer.err
    assert {path.name for path in older.iterdir()} == first and not list(out.glob("krl_*"))
    assert next(older.glob("krl_*/MILLING_CMP.src")).exists()


def test_repeating_lists_the_errors_of_its_passes(quick, tmp_path):
    result = answered(*command(tmp_path, "--method", "mirror", sets=["compensation.repeat=true"]))
    errors = result["remaining_errors_um"]
    assert len(errors) > 2 and min(errors) < 0.5 * errors[0]


def test_a_path_out_of_reach_is_one_sentence_with_its_line_and_leaves_nothing(tmp_path):
    far = "G21 S8000 M3\nG0 X-14 Y0 Z-0.5\nG1 X12 F4000\nG1 Y2500\nM30\n"
    assert re.search(r"part\.nc, line 4: point \d+ of the path: the wrist", refused(*command(tmp_path, gcode=far)))
    assert list(contents(tmp_path)) == ["part.nc"]


def test_a_failure_while_writing_leaves_the_directory_as_it_was(tmp_path, monkeypatch):
    def fails(*_):
        raise InputError("program", "cannot be written")

    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "mine.txt").touch()
    monkeypatch.setattr(krl, "write_krl", fails)
    assert main(command(tmp_path)) == 2
    assert list(contents(tmp_path)) == ["out", "out/mine.txt", "part.nc"]


# --- The verdict as a part of ``compensate``: on by default, or left out ---
SHORT = settings(
    "path.length_mm=16", "stock.grid_step_um=40", "stock.max_mm=[16,12,0]", "uncertainty.reference_inertia=0",
    "uncertainty.repeatability_um=0",
)  # fmt: skip


@pytest.fixture
def judged(quick, tmp_path, capsys):
    """The command on a short cut."""
    return functools.partial(printed, capsys, "compensate", "paper.yaml", "--out", str(tmp_path / "o"), *SHORT)


def test_the_verdict_is_part_of_the_decision_unless_it_is_switched_off(judged):
    _, text, result, _ = judged("--method", "spline", "--seed", "7", "--verdict", "2")
    assert "2 simulated robots, seed 7: largest path deviation [um]" in text and "verdict: compensation helps" in text
    verdict = result["verdict"]
    assert (verdict["verdict"], verdict["samples"], verdict["seed"]) == ("helps", 2, 7)
    assert "inverse" in verdict["methods_um"] and result["recommended_method"] == verdict["recommended_method"]
    code, text, result, _ = judged("--verdict", "0")
    assert result["verdict"] is None and result["recommended_method"] is None
    assert code == 0 and text.startswith("decision: caution: ")


def test_the_levers_plan_with_the_method_of_the_command(quick, tmp_path, monkeypatch):
    def program(cell, method, motion):
        raise InputError("planned by", method)

    monkeypatch.setattr(levers, "_program", program)
    words = command(tmp_path, "--method", "spline", "--reach", sets=["part.tolerance_um=50"])
    assert "planned by: spline" in refused(*words)
