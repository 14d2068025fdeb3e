"""What a program does before and behind the path: home, safe height, spindle, coolant, tool and base."""

from __future__ import annotations

import re

import numpy as np
import pytest
from krl_robot import NUMBER, Robot
from test_trajectory_krl import swaying, write

from kr270_milling.base.errors import ParameterError
from kr270_milling.cell.sections import Program

#: a cell's own commands, run up, home declared, tool and base of the controller's tables
OWN = Program(
    spindle_on=("$OUT[1]=TRUE",), spindle_off=("$OUT[1]=FALSE",), coolant_on=("$OUT[2]=TRUE",),
    coolant_off=("$OUT[2]=FALSE",), spindle_run_up=4.0, home_angles=np.radians([0, -90, 90, 0, 0, 0]), set_load=True,
)  # fmt: skip


@pytest.mark.parametrize("motion", ["LIN", "SPLINE"])
@pytest.mark.parametrize("limit", [1400, 130])
def test_the_program_starts_and_ends_at_home_with_the_spindle_on_in_between(tmp_path, motion, limit):
    write(tmp_path, OWN.replace(motion=motion, line_limit=limit), *swaying(200))
    steps = [line for line in Robot(tmp_path, "MILLING_CMP").steps if not line.startswith((";", "&"))]
    moves = [line for line in steps if line.startswith(("PTP", "LIN", "SPL "))]
    assert moves[:3] == ["PTP XHOME", "PTP XAPPROACH", "LIN XP1"] and moves[-2:] == ["LIN XRETRACT", "PTP XHOME"]
    order = [steps.index(line) for line in ("PTP XHOME", "$OUT[1]=TRUE", "WAIT SEC 4.0", "$OUT[2]=TRUE",
                                            "PTP XAPPROACH", "LIN XP1", "LIN XRETRACT", "$OUT[1]=FALSE")]  # fmt: skip
    assert order == sorted(order) and steps.index("$OUT[2]=FALSE") > steps.index("LIN XRETRACT")
    assert "$LOAD={M 12.000" in (tmp_path / "MILLING_CMP.src").read_text()


def test_approach_and_retract_are_at_the_safe_height_above_first_and_last_point(tmp_path):
    pair = swaying(20)
    write(tmp_path, OWN, *pair)
    text = (tmp_path / "MILLING_CMP.dat").read_text()
    for name, k in (("XAPPROACH", 0), ("XRETRACT", -1)):
        place = re.search(rf"{name}={{X ({NUMBER}),Y ({NUMBER}),Z ({NUMBER})", text).groups()
        expected = [*pair[1].position[k, :2] * 1e3, 50.0]
        assert [float(v) for v in place] == pytest.approx(expected, abs=1e-4)
    assert "DECL E6AXIS XHOME={A1 0.0000,A2 -90.0000,A3 90.0000,A4 0.0000,A5 0.0000,A6 0.0000," in text


def test_tool_and_base_of_the_controllers_tables(tmp_path):
    write(tmp_path, Program(tool_number=3, base_number=12), *swaying(20))
    text = (tmp_path / "MILLING_ORG.src").read_text()
    assert "$TOOL=TOOL_DATA[3]\n" in text and "; TOOL_DATA[3] must be {X 0.0000,Y 0.0000,Z 250.0000" in text
    assert "$BASE=BASE_DATA[12]\n" in text


@pytest.mark.parametrize("wrong", [dict(spindle_on=("A\nB",)), dict(home="x"), dict(home_angles=[1.0]),
                                   dict(coolant_off=("\u00e4",))])  # fmt: skip
def test_what_no_controller_reads_is_refused(wrong):
    with pytest.raises(ParameterError):
        Program(**wrong)
