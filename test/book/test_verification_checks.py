"""The list of checks and how verdicts are given; each check itself is run here once."""

from __future__ import annotations

import json
import sys

import pytest

from kr270_milling import verification
from kr270_milling.base.errors import MillingError
from kr270_milling.cli import main
from kr270_milling.verification import checks
from kr270_milling.verification.checks import Check, Skipped, run

QUICK = [c for c in verification.CHECKS if not c.name.startswith("stability")]  # test_stability.py does those


def outcome(expected, got, tolerance, at_most=False):
    return run(Check("one", "nowhere", "m", at_most, lambda: (expected, got, tolerance)))


@pytest.mark.parametrize("one", QUICK, ids=lambda c: c.name)
def test_every_check_of_the_book_is_ok(one):
    found = run(one)
    assert found.verdict == "ok", (found.expected, found.got, found.tolerance, found.reason)


def test_every_check_names_its_source_and_has_a_name_of_its_own():
    names = [c.name for c in verification.CHECKS]
    assert len(set(names)) == len(names) > 60
    assert all(c.source for c in verification.CHECKS)


def test_a_number_out_of_its_tolerance_on_either_side_fails():
    assert outcome(1.0, 1.05, 0.1).verdict == outcome(1.0, 0.95, 0.1).verdict == "ok"
    assert outcome(1.0, 1.2, 0.1).verdict == outcome(1.0, 0.8, 0.1).verdict == "FAILED"


def test_a_bound_may_be_undercut_and_not_exceeded():
    assert outcome(1.0, -5.0, 0.0, True).verdict == outcome(1.0, 1.0, 0.0, True).verdict == "ok"
    assert outcome(1.0, 1.01, 0.0, True).verdict == "FAILED"


@pytest.mark.parametrize("at_most", [True, False])
@pytest.mark.parametrize("got", [float("nan"), float("inf"), float("-inf")])
def test_what_is_not_a_number_fails(got, at_most):
    assert outcome(1.0, got, 0.1, at_most).verdict == "FAILED"


def test_a_check_that_raises_has_failed_and_one_without_its_oracle_is_skipped():
    def wrong():
        raise MillingError("no stable equilibrium")

    def missing():
        raise Skipped("pinocchio is not installed")

    failed, skipped = (run(Check("one", "nowhere", "", False, f)) for f in (wrong, missing))
    assert failed.verdict == "FAILED" and failed.reason == "no stable equilibrium"
    assert skipped.verdict == "skipped" and "pinocchio" in skipped.reason


def test_without_pinocchio_its_checks_are_skipped_with_the_reason(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "pinocchio", None)
    assert main(["verify", "--only", "at 100 postures", "--markdown"]) == 0
    shown = capsys.readouterr().out
    assert shown.count("skipped: pinocchio is not installed") == 3
    assert "3 checks: 0 ok, 0 FAILED, 3 skipped" in shown


def test_the_command_prints_json_and_ends_with_0(capsys):
    assert main(["verify", "--only", "BEAM", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert len(found["checks"]) == 3 and found["failed"] == 0
    keys = {"name", "expected", "at_most", "source", "got", "tolerance", "unit", "verdict", "reason"}
    assert all(set(entry) == keys and entry["verdict"] == "ok" for entry in found["checks"])


def test_the_command_ends_with_1_if_one_check_fails(monkeypatch, capsys):
    wrong = Check("a wrong one", "nowhere", "N", True, lambda: (1.0, 2.0, 0.5))
    monkeypatch.setattr(checks, "CHECKS", [wrong, *verification.CHECKS])
    assert main(["verify", "--only", "wrong"]) == 1
    shown = capsys.readouterr().out
    assert "FAILED" in shown and "<= 1 N" in shown and "1 checks: 0 ok, 1 FAILED, 0 skipped" in shown


def test_an_unknown_name_is_told_with_the_names_there_are(capsys):
    assert main(["verify", "--only", "perpetuum mobile"]) == 2
    assert "no check's name contains 'perpetuum mobile'" in capsys.readouterr().err
