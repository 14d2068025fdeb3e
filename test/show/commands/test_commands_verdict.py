"""The verdict as a part of ``compensate``: on by default, quick, long or left out."""

from __future__ import annotations

import json

import pytest

from kr270_milling.cli import _parser, main

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
