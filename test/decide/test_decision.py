"""Tolerance and decision: its levels, the same in every output of a run, and the table of programs."""

from __future__ import annotations

import json
import re
from types import SimpleNamespace

import decision_table
import numpy as np
import pytest
from decision_table import CASES, answer_of
from small_part import GCODE, assignments, small_part

from kr270_milling.base.errors import ConfigError, MillingError
from kr270_milling.base.record import find_file
from kr270_milling.cell.cell import read_cell
from kr270_milling.cell.jobs import simulate
from kr270_milling.cell.sections import Tolerances
from kr270_milling.cli import _parser, main
from kr270_milling.decide import compensation
from kr270_milling.decide.compensation import VerdictOrder
from kr270_milling.decide.decision import CAUTION, NO, YES, Decision
from kr270_milling.decide.exchange_share import exchange_share
from kr270_milling.decide.tolerance import SURFACE_ERROR, Judgement, judge_part
from kr270_milling.decide.verdict import HELPS, NO_METHOD, MethodComparison, Verdict, compare_methods
from kr270_milling.physics.compensation.compensator import Compensator


def part(**features):
    rows = tuple(SimpleNamespace(name=n, max_wall=w, max_floor=f) for n, (w, f) in features.items())
    walls, floors = ([getattr(row, key) for row in rows] for key in ("max_wall", "max_floor"))
    whole = SimpleNamespace(max_wall=np.nanmax(walls), max_floor=np.nanmax(floors))
    return SimpleNamespace(rows=rows, whole=whole)


def cell_with(**tolerances):
    return SimpleNamespace(part=Tolerances(**tolerances))


def test_the_error_that_is_farthest_beyond_its_own_tolerance_decides():
    found = judge_part(
        cell_with(tolerance=50e-6, floor_tolerance=10e-6, features=("pocket=30",)),
        part(slot=(49e-6, 9e-6), pocket=(40e-6, np.nan)),
    )
    assert not found.passes and found.feature == "pocket" and found.tolerance == pytest.approx(30e-6)
    assert found.words == "largest wall or floor error misses 30 um (40 um at pocket)"


def test_all_within_passes_and_without_a_tolerance_nothing_is_said():
    rows = part(slot=(49e-6, 9e-6))
    assert judge_part(cell_with(tolerance=50e-6), rows).passes is True
    found = judge_part(cell_with(), rows)
    assert found.passes is None and found.wall == 49e-6 and found.error == 49e-6


@pytest.mark.parametrize("text", ["pocket", "=30", "pocket=", "pocket=-1", "pocket=nan"])
def test_a_feature_tolerance_that_cannot_be_meant_is_refused(text):
    with pytest.raises(ConfigError, match="part.features"):
        read_cell(find_file("paper.yaml"), [f'part.features=["{text}"]'])


def words(directory, *more: str, sets=()) -> list[str]:
    pairs = assignments(directory, GCODE, "compensation.method=linear", *sets)
    return ["compensate", "paper.yaml", "--no-verdict", "--out", str(directory / "out"), *more,
            *(part for pair in pairs for part in ("--set", pair))]  # fmt: skip


def test_a_refused_path_gets_no_program_or_a_marked_one(tmp_path, capsys):
    refused = ["limits.spindle_torque_n_m=0.001"]
    assert main(words(tmp_path, "--json", sets=refused)) == 1
    found = json.loads(capsys.readouterr().out)
    assert (
        found["decision"] == "no"
        and found["may_be_run"] is False
        and not any(k.startswith("krl") for k in found["programs"])
    )
    assert not list((tmp_path / "out").rglob("*.src"))
    assert main(words(tmp_path, "--json", "--force", sets=refused)) == 1
    programs = sorted((tmp_path / "out").rglob("*.src"))
    assert programs and all(path.name.startswith("NOT_RELEASED") for path in programs)
    stop = next(f for f in json.loads(capsys.readouterr().out)["check"]["findings"] if f["severity"] == "stop")
    for path in programs:
        header = " ".join(line.removeprefix("; ") for line in path.read_text().splitlines())
        assert stop["sentence"] in header and "decision: no: the path must not be run" in header


def test_the_decision_of_a_tool_path_has_walls_and_floors(tmp_path, capsys):
    assert small_part(tmp_path).part.of() == (0.0, 0.0)
    assert main(words(tmp_path, "--json", sets=["part.wall_tolerance_um=1"])) == 1
    found = json.loads(capsys.readouterr().out)
    before = found["as_programmed"]
    assert before["passes_tolerance"] is False and before["wall_um"] > 1 and before["floor_um"] >= 0
    assert found["recommended_method"] is None and found["method"] == "linear"


# --- The three levels of the decision, the same in every output of one run, and the method that ``best`` writes ---
MOVING = ("dynamics.reference_inertia=true", "dynamics.damping_ratio=0.04", "dynamics.mass_model=rigid")
UM = 1e-6


def judgement(error: float, tolerance: float = 100 * UM) -> Judgement:
    passes = error <= tolerance if tolerance else None
    return Judgement(error, error, passes, error, tolerance, "pocket", SURFACE_ERROR)


def plants(*errors: float, tolerance: float = 100 * UM) -> Verdict:
    rows = UM * np.array(errors)
    return Verdict(HELPS, "", 2 * rows, rows, 1, {}, SURFACE_ERROR, rows / tolerance if tolerance else None)


def decision(error: float = 5 * UM, tolerance: float = 100 * UM, **more) -> Decision:
    return Decision(judgement(120 * UM, tolerance), judgement(error, tolerance), "inverse", **more)


def test_nine_of_ten_plants_are_enough_for_a_yes():
    found = decision(verdict=plants(*[50] * 9, 300))
    assert found.level == YES and found.exit_code == 0
    assert found.sentence == (
        "largest wall or floor error meets 100 um on the model (5 um) and in 9 of 10 simulated robots (median 50 um)"
    )


def test_fewer_plants_are_a_caution_with_the_way_out():
    found = decision(verdict=plants(*[50] * 9, *[118] * 19))
    assert found.level == CAUTION and found.exit_code == 0 and found.may_be_run
    assert found.sentence == (
        "largest wall or floor error meets 100 um on the model (5 um) and in 9 of 28 simulated robots (median 118 um); "
        "reduce the uncertainty: identify compliances"
    )


def test_a_failed_plant_does_not_meet_the_tolerance():
    assert decision(verdict=plants(*[50] * 8, np.nan, np.nan)).level == CAUTION


def test_a_stop_or_a_model_that_misses_is_a_no_whatever_the_plants():
    missed = decision(130 * UM, verdict=plants(*[50] * 10))
    assert missed.level == NO and missed.exit_code == 1 and missed.may_be_run
    assert "misses 100 um on the model (130 um at pocket)" in missed.sentence
    stopped = decision(stops=("axis 5 leaves its range", "another"), verdict=plants(*[50] * 10))
    assert stopped.level == NO and stopped.exit_code == 1 and not stopped.may_be_run
    assert stopped.sentence.startswith("the path must not be run: axis 5 leaves its range, and 1 more")


def test_what_is_missing_is_named():
    assert "no verdict of simulated robots" in decision().sentence and decision().level == CAUTION
    open_ended = decision(tolerance=0.0, verdict=plants(50, 60, tolerance=0.0))
    assert open_ended.level == CAUTION and "set part.tolerance_um" in open_ended.sentence
    assert "is 5 um on the model, median 55 um in 2 simulated robots" in open_ended.sentence


def test_a_method_is_recommended_only_where_methods_were_compared():
    assert decision(verdict=plants(50)).recommended_method is None
    assert decision().method_text == "method: inverse, as set"
    compared = decision(comparison=MethodComparison("inverse", "inverse, because", {}))
    assert compared.recommended_method == "inverse" and compared.method_text == "recommended method: inverse, because"


@pytest.fixture
def answer(tmp_path, capsys):
    """Run ``compensate`` once; return what the run printed and wrote."""

    def run(*sets: str):
        pairs = assignments(tmp_path, GCODE, *MOVING, *sets)
        words = ["compensate", "paper.yaml", "--method", "best", "--quick", "--force", "--out", str(tmp_path / "out")]
        words += [part for pair in pairs for part in ("--set", pair)]
        found = _parser(words).parse_args(words)
        found = found.run(found)
        code = found.print(as_json=False)
        terminal = capsys.readouterr().out
        assert found.print(as_json=True) == code
        result = json.loads(capsys.readouterr().out)
        (folder,) = (tmp_path / "out").glob("krl_*")
        headers = [" ".join(re.findall(r"^; (.*)$", path.read_text(), re.MULTILINE)) for path in folder.iterdir()]
        manifest = (tmp_path / "out" / "MANIFEST.txt").read_text()
        report = (tmp_path / "out" / "report.html").read_text()
        return SimpleNamespace(
            code=code, terminal=terminal, json=result, folder=folder, headers=headers, manifest=manifest, report=report
        )

    return run


@pytest.mark.parametrize(
    ("sets", "level", "code"),
    [
        (["part.tolerance_um=600"], YES, 0),
        (["part.tolerance_um=40"], CAUTION, 0),
        (["part.tolerance_um=0.2"], NO, 1),
        (["part.tolerance_um=600", "limits.spindle_power_kw=0.01"], NO, 1),
    ],
)
def test_the_decision_is_the_same_in_every_output_of_a_run(answer, sets, level, code):
    found = answer(*sets)
    assert found.code == code and found.json["decision"] == level
    line = f"decision: {level}: {found.json['sentence']}"
    assert found.terminal.splitlines()[0] == line and line in found.manifest.splitlines()
    assert all(line in header for header in found.headers)
    tone = {YES: "good", CAUTION: "caution", NO: "bad"}[level]
    sentence = found.json["sentence"].replace(" um", " µm")
    assert f'<div class="tile {tone}"><span class="label">decision</span><strong>{level}</strong>' in found.report
    assert f"<span>{sentence}</span>" in found.report
    assert found.json["may_be_run"] is (len(sets) == 1)
    assert any(path.name.startswith("NOT_RELEASED") for path in found.folder.iterdir()) is (level == NO)
    # the method that is recommended is the one that is written
    method = found.json["recommended_method"]
    assert method == found.json["method"] == "inverse" and f"method {method}" in found.headers[0] + found.headers[-1]
    assert f"krl_spline_{method}_" in found.folder.name and f"recommended method: {method}, because" in found.terminal
    assert "exchange: largest correction of a predicted pose is" in found.terminal


def test_best_writes_the_path_as_programmed_where_no_method_helps(tmp_path, monkeypatch):
    cell = small_part(tmp_path, GCODE, "compensation.method=best")
    monkeypatch.setattr(compensation, "compare_methods", lambda *_: MethodComparison(NO_METHOD, "none, because", {}))
    done = compensation.compensate(cell)
    assert done.revised.name == "none" and done.revised.reference is done.original.reference
    assert done.decision.method == done.decision.recommended_method == "none"


def test_best_takes_learned_only_with_a_tracker(tmp_path):
    cell = small_part(tmp_path, GCODE, *MOVING, "compensation.method=best")
    original = simulate(cell)
    found = compare_methods(cell, original)
    assert found.best == "inverse" and set(found.deviations) == {"none", "linear", "spline", "mirror", "inverse"}
    assert found.deviations["inverse"] == min(found.deviations.values())
    tracked = cell.replace(compensation=cell.compensation.replace(tracker=True))
    assert compare_methods(tracked, original).best == "learned"
    for one, method in ((cell, "inverse"), (tracked, "learned")):  # a node that runs compares nothing
        assert Compensator(one.compensation, one.target()).method == method


def test_learned_says_that_it_needs_a_tracker(tmp_path):
    done = compensation.compensate(small_part(tmp_path, GCODE, "compensation.max_passes=1"), "learned")
    assert any("needs a tracker" in line for line in done.lines())
    assert done.decision.recommended_method is None


def test_the_verdict_of_best_runs_no_other_method(tmp_path):
    cell = small_part(tmp_path, GCODE, *MOVING, "compensation.method=best", "part.tolerance_um=100")
    found = compensation.compensate(cell, verdict=VerdictOrder(1, asked_for=True)).decision
    assert list(found.verdict.methods) == ["inverse"] and found.verdict.quantity == found.compensated.quantity


def test_an_exchange_that_is_too_coarse_is_a_stop(tmp_path):
    cell = small_part(tmp_path, GCODE)
    ran = simulate(cell)
    share = exchange_share(cell, ran)
    feed_per_tooth = cell.feed_rate / (cell.tool.spindle_speed / (2 * np.pi) * cell.tool.teeth)
    assert share.share == pytest.approx(ran.result.correction.max() / feed_per_tooth) and not share.violations()
    strict = cell.replace(exchange=cell.exchange.replace(stop_correction=0.5 * share.share))
    done = compensation.compensate(strict, "linear")
    assert done.decision.level == NO and "largest correction of a predicted pose" in done.decision.sentence


# --- No dangerous program or cell of the table is released, no sound one is stopped ---
@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_a_dangerous_case_is_stopped_by_its_finding_and_a_sound_case_is_released(tmp_path, case):
    result = decision_table.answer(case, tmp_path)
    if case.stop == "refused":
        assert isinstance(result, MillingError)
        return
    assert not isinstance(result, MillingError), result
    assert answer_of(result) == ("stopped" if case.stop else "released"), result.lines()
    warnings = {f.what for f in result.findings if f.severity == "warning"}
    if not case.stop:
        assert warnings - {"tool and grid"} == {case.warning} - {""}, result.lines()  # the grid of the table is coarse
        return
    stops = [f for f in result.findings if (f.what, f.severity) == (case.stop, "stop") and case.words in f.sentence]
    assert stops and all(f.sentence in "\n".join(result.lines()) for f in stops), result.lines()
    assert case.lines == (None,) or stops[0].where.line in case.lines
    assert case.value is None or stops[0].value == pytest.approx(case.value, rel=1e-3, abs=1e-9)
    assert case.limit is None or stops[0].limit == pytest.approx(case.limit, rel=1e-6)


def test_the_table_has_sixty_cases_and_half_of_them_are_dangerous():
    dangerous = sum(bool(case.stop) for case in CASES)
    assert len(CASES) >= 60 and 0.4 < dangerous / len(CASES) < 0.6
    assert len({case.name for case in CASES}) == len(CASES)


@pytest.mark.parametrize("name", ["a program for a cutter of 10 mm", "a ball-end mill by its comment"])
def test_a_finding_about_the_tool_names_the_line_of_the_tool(tmp_path, name):
    case = next(case for case in CASES if case.name == name)
    (finding,) = [f for f in decision_table.answer(case, tmp_path).findings if f.what == case.stop]
    assert finding.where.line == 1 + case.program[: case.program.index("T1 M6")].count("\n")
    assert finding.where.point is None and f"(line {finding.where.line})" in finding.text


def test_drilling_is_reported_without_a_force_and_without_a_deviation(tmp_path):
    cases = {case.name: case for case in CASES}
    result = decision_table.answer(cases["two holes"], tmp_path)
    (finding,) = [f for f in result.findings if f.what == "drilling"]
    assert "drilling: force not modelled (2 holes)" in finding.text and finding.where.line == 3
    assert result.ran.result.removed_volume > 0.0
    assert np.abs(result.ran.result.wrench).max() < 1e-9 and result.ran.result.torque.max() < 1e-9  # rounding
    both = decision_table.answer(cases["a slot and a hole"], tmp_path).ran.result
    force = np.abs(both.wrench).max(axis=1)
    assert force.max() > 10.0 and force[both.actual[:, 1] > 0.02].max() < 1e-9


def test_the_command_init_refuses_an_arm_file_that_does_not_exist(capsys):
    assert main(["init", "--robot", "no_such_arm"]) == 2
    assert "no_such_arm.yaml" in capsys.readouterr().err
