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
    found = json.loads(capsys.readouterr().out)["verdict"]
    assert found["verdict"] == "helps" and found["samples"] == 2 and found["seed"] == 7
    assert len(found["compensated_mm"]) == 3


@pytest.fixture
def compensate(tmp_path, capsys):
    """The command on a short cut: what it prints as JSON, and what it says beside it."""
    sets = [part for pair in SHORT for part in ("--set", pair)]

    def run(*words: str) -> tuple[dict, str]:
        assert main(["compensate", "paper.yaml", "--out", str(tmp_path / "o"), "--json", *sets, *words]) == 0
        told = capsys.readouterr()
        return json.loads(told.out), told.err

    return run


def test_the_verdict_is_part_of_the_decision_unless_nobody_wants_it(compensate, monkeypatch):
    monkeypatch.setattr("kr270_milling.show.commands.compensate.PLANTS", 2)
    found, _ = compensate("--method", "spline")
    assert found["verdict"]["samples"] == 2 and "inverse" in found["verdict"]["methods"]
    assert found["recommended_method"] == found["verdict"]["recommended_method"]
    quick, _ = compensate("--quick", "--method", "spline")
    assert quick["verdict"]["samples"] == 8 and set(quick["verdict"]["methods"]) == {"none", "spline"}
    assert quick["recommended_method"] is None  # nothing was compared
    none, told = compensate("--no-verdict")
    assert none["verdict"] is None and none["recommended_method"] is None
    assert told.startswith("warning: decision: caution: ") and "would take too long" not in told


def test_a_verdict_that_would_take_long_is_left_out_and_that_is_said(compensate, monkeypatch):
    monkeypatch.setattr("kr270_milling.decide.compensation.USUAL_BUDGET", 1e-3)
    found, told = compensate("--method", "spline")
    assert found["verdict"] is None and "--verdict runs them" in told
