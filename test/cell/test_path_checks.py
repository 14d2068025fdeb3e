"""Tool paths that a cell refuses because their spindle, their tool axis or their moves cannot be meant."""

from __future__ import annotations

import numpy as np
import pytest
from small_part import GCODE, small_part

from kr270_milling.base.errors import InputError
from kr270_milling.base.record import find_file
from kr270_milling.cell.cell import read_cell

SLOT = "x_mm,y_mm,z_mm,a_deg,b_deg,c_deg,feed_mm_per_min\n" + "".join(
    f"{x},0,-0.5,{{a}},{{b}},{{c}},3000\n" for x in range(-14, 20, 2)
)


def table(directory, a=0.0, b=0.0, c=180.0):
    """The cell with a slot as a table; A, B, C [deg] turn tool0."""
    path = directory / "slot.csv"
    path.write_text(SLOT.format(a=a, b=b, c=c))
    return read_cell(find_file("paper.yaml"), [f"path.file={path}", "stock.max_mm=[40,14,0]"])


def test_a_cut_while_the_spindle_is_off_is_refused_with_its_line(tmp_path):
    cell = small_part(tmp_path, GCODE.replace("G1 Y10\n", "M5\nG1 Y10\n"))
    with pytest.raises(InputError, match="while the spindle is off") as caught:
        cell.target()
    assert caught.value.line == 8


def test_a_tool_that_turns_the_other_way_than_the_program_is_refused(tmp_path):
    cell = small_part(tmp_path, GCODE, "tool.rotation=counterclockwise")
    with pytest.raises(InputError, match="turns clockwise .* counterclockwise"):
        cell.target()


def test_a_program_without_a_spindle_leaves_it_to_the_cell(tmp_path):
    silent = GCODE.replace(" S8000 M3", "").replace("M5\n", "")
    assert len(small_part(tmp_path, silent, "tool.rotation=counterclockwise").target()) > 10


def test_a_program_of_rapid_moves_alone_is_refused(tmp_path):
    cell = small_part(tmp_path, "G21 G90\nG0 X-14 Y0 Z-0.5\nG0 X20\nM30\n")
    with pytest.raises(InputError, match="no cutting move"):
        cell.target()


@pytest.mark.parametrize(("turned", "tilt"), [(dict(c=210.0), 30), (dict(b=2.0), 2), (dict(c=0.0), 180)])
def test_a_tilted_tool_is_refused_with_its_tilt(tmp_path, turned, tilt):
    with pytest.raises(InputError, match=f"tilted by {tilt} deg") as caught:
        table(tmp_path, **turned).target()
    assert caught.value.line in (2, 3)


def test_a_tool_within_a_degree_and_turned_about_its_axis_is_taken(tmp_path):
    target = table(tmp_path, a=30.0, c=180.9).target()
    assert np.ptp(target.position[:, 0]) == pytest.approx(32e-3)
