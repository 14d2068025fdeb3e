"""The command compensate: what it writes and prints, and that unusable input leaves nothing behind."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest
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
    assert "every 12 ms" in manifest and "joint_a1_deg to joint_a6_deg" in manifest and "T1, 10 %" in manifest
    assert [p.name for p in tmp_path.iterdir() if p.name.startswith(".")] == []


def test_json_has_the_features_before_and_after_and_all_paths(quick, tmp_path, capsys):
    assert main(command(tmp_path, "--method", "linear", "--json")) == 0
    result = json.loads(capsys.readouterr().out)
    rows = {name: {row["feature"]: row for row in table} for name, table in result["features"].items()}
    assert set(rows) == {"original", "linear"} and {"leg", "arc", "whole part"} <= set(rows["original"])
    before, after = (rows[name]["whole part"]["max_normal_um"] for name in ("original", "linear"))
    assert after < 0.3 * before
    assert result["check"]["may_be_run"] and result["limited"] == [] and result["verdict"] is None
    assert result["chord_error_mm"] == pytest.approx(0.01, rel=0.02)  # 0.8 mm chords of a circle of 8 mm radius
    paths = [p for kind in result["programs"].values() for p in kind]
    paths += [result[key] for key in ("trajectory", "report", "part")]
    assert all((tmp_path / "out").joinpath(p).is_file() for p in paths)


def test_a_straight_cut_keeps_its_contract_and_gets_programs(tmp_path, capsys):
    words = ["compensate", "paper.yaml", "--method", "spline", "--out", str(tmp_path / "out"), "--json", "--no-verdict"]
    words += ["--set", "path.length_mm=20", "--set", "stock.grid_step_um=40", "--set", "stock.max_mm=[20,12,0]"]
    assert main(words) == 0
    result = json.loads(capsys.readouterr().out)
    keys = {"method", "trajectory", "points", "static_deviation_mm", "max_deviation_mm", "low_frequency_hz", "original"}
    assert (
        keys <= set(result)
        and set(result["programs"]) == {"krl_spline", "rsi", "joints", "manifest"}
        and "report" not in result
    )
    assert result["max_deviation_mm"] < 0.1 * result["original"]["max_deviation_mm"]


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


def test_the_method_linear_is_run_by_lin_motions(quick, tmp_path):
    assert main(command(tmp_path)) == 0
    (folder,) = (tmp_path / "out").glob("krl*")
    assert re.fullmatch(r"krl_lin_linear_\d{8}_[0-9a-f]{8}", folder.name)


def test_programs_of_different_trajectories_never_share_a_folder(quick, tmp_path):
    for method in ("spline", "linear", "spline"):
        assert main(command(tmp_path, "--method", method, "--krl", "SPLINE")) == 0
    assert len(list((tmp_path / "out").glob("krl_spline_*"))) == 2


def test_repeating_lists_the_errors_of_its_passes(quick, tmp_path, capsys):
    assert main(command(tmp_path, "--json", "--method", "mirror", sets=["compensation.repeat=true"])) == 0
    errors = json.loads(capsys.readouterr().out)["remaining_errors_mm"]
    assert len(errors) > 2 and min(errors) < 0.5 * errors[0]


BAD = {
    "an empty file": ("", 1, "empty"),
    "a file cut off in a number": (HEAD + "G1 X12 F40", 3, "cut off"),
    "an arc that does not close": (HEAD + "G1 X12 F4000\nG2 X20 Y18 I8 J3\nM30\n", 4, "does not close"),
    "zero feed": (HEAD + "G1 X12 F0\nM30\n", 3, "zero feed"),
    "a point out of reach": (HEAD + "G1 X12 F4000\nG1 Y2500\nM30\n", 4, r"point \d+ of the path: the wrist centre"),
    "a joint beyond its range": (HEAD + "G1 X12 F4000\nG1 X400 Z1500\nM30\n", 4, r"point \d+ of the path: joint"),
    "a missed stock": (HEAD + "G0 Z2\nG1 X12 F4000\nM30\n", 4, "never reaches the stock"),
    "inches instead of millimetres": ("G20 S8000 M3\nG0 X-14 Y9 Z0\nG1 X12 F150\nM30\n", 3, "unit"),
    "another spindle speed": (HEAD.replace("8000", "9000") + "G1 X12 F4000\nM30\n", 3, "spindle speed"),
    "points that never move": (HEAD + "G1 X-14 Y0 Z-0.5 F4000\n" * 2000 + "M30\n", 2, "never moves"),
    "a number that is none": (HEAD + "G1 XNaN F4000\nM30\n", 3, "XNAN"),
    "UTF-16": ((HEAD + "M30\n").encode("utf-16"), 1, "UTF-16"),
    "Latin-1": ((HEAD + "(Gr\xf6\xdfe)\nM30\n").encode("latin-1"), 3, "UTF-8"),
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


def test_a_csv_of_points_with_nan_is_refused_with_its_line(tmp_path, capsys):
    (tmp_path / "part.csv").write_text("x_mm,y_mm,z_mm,feed_mm_per_min\n-14,0,-0.5,4000\n12,nan,-0.5,4000\n")
    words = command(tmp_path, sets=[f"path.file={tmp_path / 'part.csv'}"])
    assert main(words) == 2 and "part.csv, line 3: the column y_mm is not finite" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


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


@pytest.mark.parametrize("words", [["--verdict", "0"], ["--verdict", "-3"], ["--seed", "x"], ["--krl", "PTP"]])
def test_options_out_of_range_are_refused(tmp_path, words, capsys):
    with pytest.raises(SystemExit) as error:
        main(command(tmp_path, *words))
    assert error.value.code == 2 and words[0] in capsys.readouterr().err


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
    assert simulated["whole_part"]["max_normal_um"] == pytest.approx(whole["max_normal_um"], rel=1e-9)
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
    assert len(result["compensated_mm"]) == 3


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
    assert result["verdict"]["samples"] == 2 and "inverse" in result["verdict"]["methods"]
    assert result["recommended_method"] == result["verdict"]["recommended_method"]
    quick, _ = compensate("--quick", "--method", "spline")
    assert quick["verdict"]["samples"] == 8 and set(quick["verdict"]["methods"]) == {"none", "spline"}
    assert quick["recommended_method"] is None  # nothing was compared
    none, errors = compensate("--no-verdict")
    assert none["verdict"] is None and none["recommended_method"] is None
    assert errors.startswith("warning: decision: caution: ") and "would take too long" not in errors


def test_a_verdict_that_would_take_long_is_left_out_with_a_sentence(compensate, monkeypatch):
    monkeypatch.setattr("kr270_milling.decide.compensation.USUAL_BUDGET", 1e-3)
    result, errors = compensate("--method", "spline")
    assert result["verdict"] is None and "--verdict runs them" in errors
