"""Tolerance and decision: its levels, the same in every output of a run, and the method that ``best`` writes."""

from __future__ import annotations

import re
from types import SimpleNamespace

import numpy as np
import pytest
from hostile import printed, settings
from small_part import GCODE, assignments, small_part

from kr270_milling.base.errors import ConfigError
from kr270_milling.base.record import find_file
from kr270_milling.cell.cell import read_cell
from kr270_milling.cell.jobs import simulate
from kr270_milling.cell.sections import Tolerances
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
    return SimpleNamespace(rows=rows, whole=SimpleNamespace(max_wall=np.nanmax(walls), max_floor=np.nanmax(floors)))


def test_the_error_that_is_farthest_beyond_its_own_tolerance_decides():
    def judged(rows, **tolerances):
        return judge_part(SimpleNamespace(part=Tolerances(**tolerances)), rows)

    limits = {"tolerance": 50e-6, "floor_tolerance": 10e-6, "features": ("pocket=30",)}
    result = judged(part(slot=(49e-6, 9e-6), pocket=(40e-6, np.nan)), **limits)
    assert not result.passes and result.feature == "pocket" and result.tolerance == pytest.approx(30e-6)
    assert result.words == "largest wall or floor error misses 30 um (40 um at pocket)"
    assert judged(part(slot=(49e-6, 9e-6)), tolerance=50e-6).passes is True
    result = judged(part(slot=(49e-6, 9e-6)))  # no tolerance
    assert result.passes is None and result.wall == 49e-6 and result.error == 49e-6


@pytest.mark.parametrize("text", ["pocket", "=30", "pocket=", "pocket=-1", "pocket=nan"])
def test_a_feature_tolerance_that_cannot_be_meant_is_refused(text):
    with pytest.raises(ConfigError, match="part.features"):
        read_cell(find_file("paper.yaml"), [f'part.features=["{text}"]'])


# --- The three levels, and the method that ``best`` writes ---
MOVING = ("dynamics.reference_inertia=true", "dynamics.damping_ratio=0.04", "dynamics.mass_model=rigid")
UM = 1e-6


def judgement(error: float, tolerance: float) -> Judgement:
    passes = error <= tolerance if tolerance else None
    return Judgement(error, error, passes, error, tolerance, "pocket", SURFACE_ERROR)


def plants(*errors: float, tolerance: float = 100 * UM) -> Verdict:
    rows = UM * np.array(errors)
    return Verdict(HELPS, "", 2 * rows, rows, 1, {}, SURFACE_ERROR, rows / tolerance if tolerance else None)


def decision(error: float = 5 * UM, tolerance: float = 100 * UM, **more) -> Decision:
    return Decision(judgement(120 * UM, tolerance), judgement(error, tolerance), "inverse", **more)


MEETS = "largest wall or floor error meets 100 um on the model (5 um)"


@pytest.mark.parametrize(("result", "level", "sentence"), [
    (decision(verdict=plants(*[50] * 9, 300)), YES, f"{MEETS} and in 9 of 10 simulated robots (median 50 um)"),
    (decision(verdict=plants(*[50] * 9, *[118] * 19)), CAUTION,
     f"{MEETS} and in 9 of 28 simulated robots (median 118 um); reduce the uncertainty: identify compliances"),
    (decision(verdict=plants(*[50] * 8, np.nan, np.nan)), CAUTION, f"{MEETS} and in 8 of 10"),  # two plants failed
    (decision(130 * UM, verdict=plants(*[50] * 10)), NO, "misses 100 um on the model (130 um at pocket)"),
    (decision(stops=("axis 5 leaves its range", "another"), verdict=plants(*[50] * 10)), NO,
     "the path must not be run: axis 5 leaves its range, and 1 more"),
    (decision(), CAUTION, "no verdict of simulated robots"),
    (decision(tolerance=0.0, verdict=plants(50, 60, tolerance=0.0)), CAUTION,
     "is 5 um on the model, median 55 um in 2 simulated robots; no tolerance is given: set part.tolerance_um"),
])  # fmt: skip
def test_stop_model_and_nine_of_ten_plants_decide_and_the_sentence_has_the_reason(result, level, sentence):
    assert (result.level, result.exit_code) == (level, level == NO) and sentence in result.sentence
    assert result.may_be_run == ("must not be run" not in sentence)


def test_a_method_is_recommended_only_where_methods_were_compared():
    assert decision(verdict=plants(50)).recommended_method is None
    assert decision().method_text == "method: inverse, as set"
    compared = decision(comparison=MethodComparison("inverse", "inverse, because", {}))
    assert compared.recommended_method == "inverse" and compared.method_text == "recommended method: inverse, because"


def run(directory, capsys, *words: str):
    """Run ``compensate`` once: its exit code, what it prints for a reader, its JSON, its programs and their headers."""
    sets = settings(*assignments(directory, GCODE, *MOVING))
    code, text, result, _ = printed(capsys, "compensate", "paper.yaml", "--out", str(directory / "out"), *sets, *words)
    programs = list((directory / "out").rglob("*.src"))
    headers = [" ".join(re.findall(r"^; (.*)$", path.read_text(), re.MULTILINE)) for path in programs]
    return code, text, result, programs, headers


def test_a_refused_path_gets_no_program_or_a_marked_one(tmp_path, capsys):
    words = ["--no-verdict", "--method", "linear", "--set", "limits.spindle_torque_n_m=0.001"]
    _, _, _, programs, _ = run(tmp_path, capsys, *words)
    assert not programs
    code, _, result, programs, headers = run(tmp_path, capsys, *words, "--force")
    assert (code, result["decision"], result["may_be_run"]) == (1, "no", False)
    assert programs and all(path.name.startswith("NOT_RELEASED") for path in programs)
    stop = next(f for f in result["check"]["findings"] if f["severity"] == "stop")
    for header in headers:
        assert stop["sentence"] in header and "decision: no: the path must not be run" in header


@pytest.mark.parametrize(("tolerance", "level"), [("600", YES), ("0.2", NO)])
def test_decision_and_chatter_are_the_same_in_every_output_of_a_run(tmp_path, capsys, tolerance, level):
    words = ["--method", "best", "--quick", "--force", "--set", f"part.tolerance_um={tolerance}"]
    code, text, result, programs, headers = run(tmp_path, capsys, *words)
    assert code == (level == NO) and result["decision"] == level and result["may_be_run"] is True
    line, chatter = f"decision: {level}: {result['sentence']}", result["check"]["stability"]["text"]
    assert chatter.startswith("stability: arm: stable") and text.splitlines()[0] == line
    manifest = (tmp_path / "out" / "MANIFEST.txt").read_text()
    assert line in manifest.splitlines() and chatter in manifest and chatter in text
    report = (tmp_path / "out" / "report.html").read_text()
    assert f'<span class="label">decision</span><strong>{level}</strong>' in report
    assert result["sentence"].replace(" um", " µm") in report and chatter.removeprefix("stability: ") in report
    method = result["recommended_method"]  # the method that is recommended is the one that is written
    assert method == result["method"] == "inverse" and f"recommended method: {method}, because" in text
    assert "exchange: largest correction of a predicted pose is" in text
    assert len(headers) == 2 and all(line in header and chatter in header for header in headers)
    assert any(f"method {method}" in header for header in headers)
    for path in programs:
        assert path.name.startswith("NOT_RELEASED") == (level == NO) and f"krl_spline_{method}_" in path.parent.name


def test_best_writes_the_path_as_programmed_where_no_method_helps(tmp_path, monkeypatch):
    cell = small_part(tmp_path, GCODE, "compensation.method=best")
    monkeypatch.setattr(compensation, "compare_methods", lambda *_: MethodComparison(NO_METHOD, "none, because", {}))
    done = compensation.compensate(cell)
    assert done.revised.name == "none" and done.revised.reference is done.original.reference
    assert done.decision.method == done.decision.recommended_method == "none"


def test_best_takes_learned_only_with_a_tracker_and_its_verdict_runs_no_other_method(tmp_path):
    cell = small_part(tmp_path, GCODE, *MOVING, "compensation.method=best")
    original = simulate(cell)
    result = compare_methods(cell, original)
    assert result.best == "inverse" and set(result.deviations) == {"none", "linear", "spline", "mirror", "inverse"}
    assert result.deviations["inverse"] == min(result.deviations.values())
    tracked = cell.replace(compensation=cell.compensation.replace(tracker=True))
    assert compare_methods(tracked, original).best == "learned"
    for one, method in ((cell, "inverse"), (tracked, "learned")):  # a node that runs compares nothing
        assert Compensator(one.compensation, one.target()).method == method
    judged = cell.replace(part=cell.part.replace(tolerance=100 * UM))
    result = compensation.compensate(judged, verdict=VerdictOrder(1, asked_for=True)).decision
    assert list(result.verdict.methods) == ["inverse"]  # it runs no other method
    assert result.verdict.quantity == result.compensated.quantity


def test_an_exchange_that_is_too_coarse_is_a_stop(tmp_path):
    cell = small_part(tmp_path, GCODE)
    ran = simulate(cell)
    share = exchange_share(cell, ran)
    feed_per_tooth = cell.feed_rate / (cell.tool.spindle_speed / (2 * np.pi) * cell.tool.teeth)
    assert share.share == pytest.approx(ran.result.correction.max() / feed_per_tooth) and not share.violations()
    strict = cell.replace(exchange=cell.exchange.replace(stop_correction=0.5 * share.share))
    done = compensation.compensate(strict, "linear")
    assert done.decision.level == NO and "largest correction of a predicted pose" in done.decision.sentence
