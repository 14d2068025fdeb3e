"""The command compensate: what it writes and prints, and that unusable input leaves nothing behind."""

from __future__ import annotations

import itertools
import json
import re
from pathlib import Path

import numpy as np
import pytest
from krl_robot import Robot
from small_part import GCODE, assignments

from kr270_milling.cli import _parser, main

HEAD = "G21 S8000 M3\nG0 X-14 Y0 Z-0.5\n"


@pytest.fixture
def quick(monkeypatch):
    """Without the figures of the report, which are not what the test is about."""

    def page(directory, *_, **__):
        path = directory / "report.html"
        path.write_text("figures left out")
        return path

    monkeypatch.setattr("kr270_milling.show.report.write_report", page)


def command(tmp_path, *words: str, gcode: str | bytes = GCODE, sets=()) -> list[str]:
    pairs = assignments(tmp_path, gcode, *sets)
    more = [part for pair in pairs for part in ("--set", pair)]
    verdict = () if {"--verdict", "--quick"} & set(words) else ("--no-verdict",)
    return ["compensate", "paper.yaml", "--out", str(tmp_path / "out"), *verdict, *words, *more]


def test_a_tool_path_ends_with_table_report_programs_and_findings(tmp_path, capsys):
    assert main(command(tmp_path, "--method", "spline", "--krl", "SPLINE", "--krl", "LIN")) == 0
    text = capsys.readouterr().out
    assert "Commanded joints [deg]" in (tmp_path / "out" / "report.html").read_text()
    for word in (
        "commanded joints at the start",
        "leg",
        "arc",
        "whole part",
        "largest correction",
        "0 stops",
        "decision: caution: largest wall or floor error is",
        "report.html",
    ):
        assert word in text
    out = tmp_path / "out"
    for motion in ("lin", "spline"):
        folder = {p.name for p in next(out.glob(f"krl_{motion}_*")).iterdir()}
        assert folder == {f"MILLING_{kind}.{end}" for kind in ("ORG", "CMP") for end in ("src", "dat")}
    assert "LIN XP" in (next(out.glob("krl_lin_*")) / "MILLING_CMP.src").read_text()
    (label,) = {p.name.partition("_lin_")[2] for p in out.glob("krl_lin_*")}
    assert re.fullmatch(r"spline_\d{8}_[0-9a-f]{8}", label)
    assert {p.name for p in out.iterdir() if p.is_file()} == {
        "MANIFEST.txt", f"joints_original_{label}.csv", f"joints_{label}.csv", "part_spline.stl",
        "reference_spline.csv", "report.html", f"rsi_offsets_{label}.csv",
    }  # fmt: skip
    manifest = (out / "MANIFEST.txt").read_text()
    for path in out.glob("*.csv"):
        header = path.read_text().splitlines()[0].split(",")
        assert path.name in manifest and (header[0] in manifest and header[0] == "time_s")
    assert "every 12 ms" in manifest and "joint_1_deg to joint_6_deg" in manifest and "T1, 10 %" in manifest
    assert [p.name for p in tmp_path.iterdir() if p.name.startswith(".")] == []


def test_json_has_the_features_before_and_after_and_all_paths(quick, tmp_path, capsys):
    assert main(command(tmp_path, "--method", "linear", "--json")) == 0
    result = json.loads(capsys.readouterr().out)
    rows = {name: {row["feature"]: row for row in table} for name, table in result["features"].items()}
    assert set(rows) == {"original", "linear"} and {"leg", "arc", "whole part"} <= set(rows["original"])
    before, after = (rows[name]["whole part"]["max_normal_um"] for name in ("original", "linear"))
    assert after < 0.3 * before
    assert result["check"]["may_be_run"] and result["limited"] == [] and result["verdict"] is None
    assert result["chord_error_um"] == pytest.approx(10.0, rel=0.02)  # 0.8 mm chords of a circle of 8 mm radius
    assert "krl_lin" in result["programs"]  # linear corrects in straight lines
    paths = [p for kind in result["programs"].values() for p in kind]
    paths += [result[key] for key in ("trajectory", "report", "part")]
    assert all((tmp_path / "out").joinpath(p).is_file() for p in paths)


def test_a_straight_cut_keeps_its_contract_and_gets_programs(tmp_path, capsys):
    words = ["compensate", "paper.yaml", "--method", "spline", "--out", str(tmp_path / "out"), "--json", "--no-verdict"]
    words += ["--set", "path.length_mm=20", "--set", "stock.grid_step_um=40", "--set", "stock.max_mm=[20,12,0]"]
    assert main(words) == 0
    result = json.loads(capsys.readouterr().out)
    keys = {"method", "trajectory", "points", "static_deviation_um", "max_deviation_um", "low_frequency_hz", "original"}
    assert keys <= set(result) and set(result["programs"]) == {"krl_spline", "rsi", "joints", "manifest"}
    assert "<h1>paper.yaml: before and after" in Path(result["report"]).read_text()
    assert result["max_deviation_um"] < 0.1 * result["original"]["max_deviation_um"]


def test_limited_corrections_are_printed(quick, tmp_path, capsys):
    assert main(command(tmp_path, sets=["compensation.max_correction_mm=0.03"])) == 0
    assert re.search(
        r"the correction is too large at points \d+ to \d+: .* left out at point \d+", capsys.readouterr().out
    )


def test_a_path_that_must_not_be_run_ends_with_1_and_a_sentence(quick, tmp_path, capsys):
    assert main(command(tmp_path, sets=["limits.spindle_power_kw=0.01"])) == 1
    text = capsys.readouterr().out
    assert text.startswith("decision: no: the path must not be run: the spindle power")
    assert not list((tmp_path / "out").glob("krl*")) and "no robot program is written" in text


def test_programs_of_different_trajectories_never_share_a_folder(quick, tmp_path):
    for method in ("spline", "linear", "spline"):
        assert main(command(tmp_path, "--method", method, "--krl", "SPLINE")) == 0
    assert len(list((tmp_path / "out").glob("krl_spline_*"))) == 2


def test_repeating_lists_the_errors_of_its_passes(quick, tmp_path, capsys):
    assert main(command(tmp_path, "--json", "--method", "mirror", sets=["compensation.repeat=true"])) == 0
    errors = json.loads(capsys.readouterr().out)["remaining_errors_um"]
    assert len(errors) > 2 and min(errors) < 0.5 * errors[0]


BAD = {  # every refused word: test/path
    "a point out of reach": (HEAD + "G1 X12 F4000\nG1 Y2500\nM30\n", 4, r"point \d+ of the path: the wrist centre"),
    "a joint beyond its range": (HEAD + "G1 X12 F4000\nG1 X400 Z1500\nM30\n", 4, r"point \d+ of the path: joint"),
    "a missed stock": (HEAD + "G0 Z2\nG1 X12 F4000\nM30\n", 4, "never reaches the stock"),
    "another spindle speed": (HEAD.replace("8000", "9000") + "G1 X12 F4000\nM30\n", 3, "spindle speed"),
    "another language": ("DEF PART( )\nPTP HOME\nEND\n", 1, "DEF"),
}


@pytest.mark.parametrize("name", BAD)
def test_unusable_input_is_one_sentence_with_its_line_and_leaves_nothing(tmp_path, capsys, name):
    gcode, line, what = BAD[name]
    assert main(command(tmp_path, gcode=gcode)) == 2
    out, errors = capsys.readouterr()
    sentences = errors.splitlines()  # one for each kind of word that cannot be run
    assert out == "" and len(sentences) == (2 if name == "another language" else 1)
    assert all(sentence.startswith("kr270_milling: ") for sentence in sentences)
    assert re.search(rf"part\.nc, line {line}: .*{what}", errors), errors
    assert sorted(p.name for p in tmp_path.iterdir()) == ["part.nc"]


@pytest.mark.parametrize("name", ["a point out of reach", "a joint beyond its range"])
def test_check_reports_a_path_beyond_the_arm_with_1(tmp_path, capsys, name):
    words = command(tmp_path, gcode=BAD[name][0])
    assert main(["check", words[1], *words[words.index("--no-verdict") + 1 :]]) == 1
    assert "must not be run" in capsys.readouterr().out


def test_a_failure_while_writing_leaves_the_directory_as_it_was(tmp_path, monkeypatch):
    from kr270_milling.base.errors import InputError
    from kr270_milling.decide.programs import krl

    def fails(*_):
        raise InputError("program", "cannot be written")

    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "mine.txt").touch()
    monkeypatch.setattr(krl, "write_krl", fails)
    assert main(command(tmp_path)) == 2
    assert [p.name for p in (tmp_path / "out").iterdir()] == ["mine.txt"]
    assert sorted(p.name for p in tmp_path.iterdir()) == ["out", "part.nc"]


def test_the_reference_that_was_written_is_checked_and_simulated_as_it_was_predicted(quick, tmp_path, capsys):
    assert main(command(tmp_path, "--method", "spline", "--json")) == 0
    result = json.loads(capsys.readouterr().out)
    sets = [part for pair in assignments(tmp_path) for part in ("--set", pair)]
    words = ["paper.yaml", "--reference", result["trajectory"], "--json", *sets]
    assert main(["check", *words]) == 0
    checked = json.loads(capsys.readouterr().out)
    assert [f["what"] for f in checked["findings"]] == [f["what"] for f in result["check"]["findings"]]
    assert main(["simulate", *words]) == 0
    simulated = json.loads(capsys.readouterr().out)
    whole = [row for row in result["features"]["spline"] if row["feature"] == "whole part"][0]
    rounding = 0.1  # [um] of the points of the program, whose figures are printed
    assert simulated["whole_part"]["max_normal_um"] == pytest.approx(whole["max_normal_um"], abs=rounding)
    assert np.isfinite(whole["max_wall_error_um"])


# --- The verdict as a part of ``compensate``: on by default, quick, long or left out ---


SHORT = ("path.length_mm=16", "stock.grid_step_um=40", "stock.max_mm=[16,12,0]")


def test_the_command_prints_the_verdict_with_its_seed(tmp_path, capsys):
    printed = [f"uncertainty.{name}={value}" for name, value in (("reference_inertia", 0.0), ("repeatability_um", 0.0))]
    sets = [part for pair in (*SHORT, *printed) for part in ("--set", pair)]
    words = ["compensate", "paper.yaml", "--method", "spline", "--out", str(tmp_path / "o"), "--verdict", "2", *sets]
    args = _parser(words).parse_args([*words, "--seed", "7"])
    answer = args.run(args)
    assert answer.print(as_json=False) == 0
    text = capsys.readouterr().out
    assert "2 simulated robots, seed 7: largest path deviation [um]" in text and "verdict: compensation helps" in text
    assert answer.print(as_json=True) == 0
    result = json.loads(capsys.readouterr().out)["verdict"]
    assert result["verdict"] == "helps" and result["samples"] == 2 and result["seed"] == 7
    assert len(result["compensated_um"]) == 3


@pytest.fixture
def compensate(tmp_path, capsys):
    """The command on a short cut: what it prints as JSON, and what it says beside it."""
    sets = [part for pair in SHORT for part in ("--set", pair)]

    def run(*words: str) -> tuple[dict, str]:
        assert main(["compensate", "paper.yaml", "--out", str(tmp_path / "o"), "--json", *sets, *words]) == 0
        printed = capsys.readouterr()
        return json.loads(printed.out), printed.err

    return run


def test_the_verdict_is_part_of_the_decision_unless_it_is_switched_off(compensate, monkeypatch):
    monkeypatch.setattr("kr270_milling.show.commands.compensate.PLANTS", 2)
    result, _ = compensate("--method", "spline")
    assert result["verdict"]["samples"] == 2 and "inverse" in result["verdict"]["methods_um"]
    assert result["recommended_method"] == result["verdict"]["recommended_method"]
    quick, _ = compensate("--quick", "--method", "spline")
    assert quick["verdict"]["samples"] == 8 and set(quick["verdict"]["methods_um"]) == {"none", "spline"}
    assert quick["recommended_method"] is None  # nothing was compared
    none, errors = compensate("--no-verdict")
    assert none["verdict"] is None and none["recommended_method"] is None
    assert errors.startswith("warning: decision: caution: ") and "would take too long" not in errors


def test_a_verdict_that_would_take_long_is_left_out_with_a_sentence_but_a_typed_number_runs(compensate, monkeypatch):
    monkeypatch.setattr("kr270_milling.decide.compensation.USUAL_BUDGET", 1e-3)
    monkeypatch.setattr("time.perf_counter", itertools.count(0.0, 100.0).__next__)  # 100 s from look to look
    result, errors = compensate("--method", "spline")
    assert result["verdict"] is None and "--verdict runs them" in errors
    result, _ = compensate("--method", "spline", "--verdict", "9")
    assert result["verdict"]["samples"] == 9 and result["verdict"]["note"] == ""


# --- from a CAM's file to the controller in two commands ---


PROGRAMS = Path(__file__).parents[2] / "path" / "programs"
#: coarse, so that a pocket takes seconds
COARSE = (
    "stock.grid_step_um=100", "stock.floor_tolerance_um=10", "exchange.micro_step_deg=6", "exchange.period_ms=2",
    "timing.controller_step_ms=50", "dynamics.reference_inertia=false", "dynamics.posture_spacing_mm=20",
    'program.spindle_on=["$OUT[1]=TRUE"]', 'program.spindle_off=["$OUT[1]=FALSE"]',
)  # fmt: skip
SETS = [word for pair in COARSE for word in ("--set", pair)]


def ran(capsys, *words) -> tuple[int, str]:
    code = main(list(map(str, words)))
    return code, capsys.readouterr().out


def drafted(capsys, directory: Path, name: str) -> Path:
    tool = ["--tool", "T1"] if name == "haas.nc" else []
    code, text = ran(capsys, "init", "--gcode", PROGRAMS / name, *tool)
    (directory / "my.yaml").write_text(text)
    assert code == 0
    return directory / "my.yaml"


@pytest.mark.parametrize("name", ["haas.nc", "sinumerik.mpf"])
def test_a_pocket_ends_in_a_program_a_report_and_a_decision(capsys, tmp_path, name):
    cell = drafted(capsys, tmp_path, name)
    code, text = ran(capsys, "compensate", cell, "--method", "mirror", "--no-verdict", "--json", "--out",
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
        robot = Robot(folder, f"{Path(name).stem.upper()}_{kind}")
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
    code, text = ran(capsys, "check", cell, "--json", *SETS)
    result = json.loads(text)
    assert code == 0 and result["may_be_run"] is True
    assert {row["word"]: row["count"] for row in result["read_over"]}["G43 H1"] == 1
    for finding in result["findings"]:
        assert set(finding) >= {"severity", "what", "where", "value", "limit", "unit", "advice", "count"}
        assert set(finding["where"]) == {"point", "line", "feature", "position_mm"}
        assert finding["severity"] in ("stop", "warning", "note")
