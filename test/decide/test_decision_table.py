"""No dangerous program or cell of the table is released, no sound one is stopped."""

from __future__ import annotations

import numpy as np
import pytest
from decision_table import CASES, answer, answer_of

from kr270_milling.base.errors import MillingError
from kr270_milling.cli import main


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_a_dangerous_case_is_stopped_by_its_finding_and_a_sound_case_is_released(tmp_path, case):
    result = answer(case, tmp_path)
    if case.stop == "refused":
        assert isinstance(result, MillingError)
        return
    assert not isinstance(result, MillingError), result
    assert answer_of(result) == ("stopped" if case.stop else "released"), result.lines()
    assert not case.stop or case.stop in {f.what for f in result.findings if f.severity == "stop"}, result.lines()
    assert not case.warning or case.warning in {f.what for f in result.findings if f.severity == "warning"}


def test_the_table_has_sixty_cases_and_half_of_them_are_dangerous():
    dangerous = sum(bool(case.stop) for case in CASES)
    assert len(CASES) >= 60 and 0.4 < dangerous / len(CASES) < 0.6
    assert len({case.name for case in CASES}) == len(CASES)


@pytest.mark.parametrize("name", ["a program for a cutter of 10 mm", "a ball-end mill by its comment"])
def test_a_finding_about_the_tool_names_the_line_of_the_tool(tmp_path, name):
    case = next(case for case in CASES if case.name == name)
    (finding,) = [f for f in answer(case, tmp_path).findings if f.what == case.stop]
    assert finding.where.line == 1 + case.program[: case.program.index("T1 M6")].count("\n")
    assert finding.where.point is None and f"(line {finding.where.line})" in finding.text


def test_drilling_is_reported_without_a_force_and_without_a_deviation(tmp_path):
    cases = {case.name: case for case in CASES}
    result = answer(cases["two holes"], tmp_path)
    (finding,) = [f for f in result.findings if f.what == "drilling"]
    assert "drilling: force not modelled (2 holes)" in finding.text and finding.where.line == 3
    assert result.ran.result.removed_volume > 0.0
    assert np.abs(result.ran.result.wrench).max() < 1e-9 and result.ran.result.torque.max() < 1e-9  # rounding
    both = answer(cases["a slot and a hole"], tmp_path).ran.result
    force = np.abs(both.wrench).max(axis=1)
    assert force.max() > 10.0 and force[both.actual[:, 1] > 0.02].max() < 1e-9


def test_the_command_init_refuses_an_arm_file_that_does_not_exist(capsys):
    assert main(["init", "--robot", "no_such_arm"]) == 2
    assert "no_such_arm.yaml" in capsys.readouterr().err
