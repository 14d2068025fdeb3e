"""Names of operations and descriptions of tools, as posts write them into comments."""

from __future__ import annotations

import pytest

from kr270_milling.path.cam.comments import described_tool, operation_name
from kr270_milling.path.cam.readers import read_toolpath

MM, INCH = 1e-3, 0.0254


@pytest.mark.parametrize(
    ("comment", "unit", "name", "diameter", "teeth", "kind"),
    [
        ("T1  D=6.35 CR=0 - ZMIN=-12.7 - flat end mill", MM, "T1", 6.35e-3, 0, "flat end mill"),
        ("T26 D=0.25 CR=0. - ZMIN=-0.025 - face mill", INCH, "T26", 6.35e-3, 0, "face mill"),
        ("T3 D=5. CR=0. TAPER=118deg - ZMIN=-7. - drill", MM, "T3", 5e-3, 0, "drill"),
        ("T1 | 1/2 FLAT ENDMILL | H1 | D1 | TOOL DIA. - .5", INCH, "T1", 12.7e-3, 0, "flat endmill"),
        ("1/2 FLAT ENDMILL TOOL - 1 DIA. OFF. - 41 LEN. - 1 DIA. - .5", INCH, "T1", 12.7e-3, 0, "flat endmill"),
        ("Tool 5: Spot Drill 3 Flutes, Diam = 5mm, Len = 20.00mm", MM, "T5", 5e-3, 3, "spot drill"),
        ('T01 = 1/2" END MILL  03-0086', INCH, "T1", 12.7e-3, 0, "end mill"),
        ('T04 1/2" Endmill, Square, 3 Flute, 1.75" LOC', INCH, "T4", 12.7e-3, 3, "endmill"),
        ("T10 = 1-1/2 IN FACE MILL 5 FLUTES", INCH, "T10", 38.1e-3, 5, "face mill"),
        ("TOOL #1 0.5 DIA FLAT END MILL 3 FLUTE", INCH, "T1", 12.7e-3, 3, "flat end mill"),
        ("T2 10MM END MILL Z=4", MM, "T2", 10e-3, 4, "end mill"),
    ],
)
def test_a_tool_is_described_by_its_comment(comment, unit, name, diameter, teeth, kind):
    tool = described_tool(comment, unit)
    assert (tool.name, tool.teeth, tool.description) == (name, teeth, kind)
    assert tool.diameter == pytest.approx(diameter)


@pytest.mark.parametrize("comment", ["STOCK 6061AL DX 3.50IN DY 2.50IN", "2D Pocket1", "DATE=21-11-26", "", "WCS G54"])
def test_other_comments_describe_no_tool(comment):
    assert described_tool(comment, MM) is None


@pytest.mark.parametrize(
    ("comment", "name", "announced"),
    [
        ("2D Pocket1", "2D Pocket1", False),
        ("OUTLINE - 2D CONTOUR 4", "OUTLINE - 2D CONTOUR 4", False),
        ("2D Adaptive1 (2)", "2D Adaptive1 (2)", False),
        ("Begin operation: Profile+1", "Profile+1", True),
        ("Operation 13 of 13 : Drill2", "Drill2", True),
        ("Toolpath:- Pocket 1", "Pocket 1", True),
    ],
)
def test_an_operation_is_named(comment, name, announced):
    assert operation_name(comment) == (name, announced)


@pytest.mark.parametrize(
    "comment",
    ["Exported by FreeCAD", "Post Processor: linuxcnc_post", "T1 D=10. CR=0. - ZMIN=-1. - flat end mill",
     "MSG, CHANGE TOOL", "When using Fusion 360 for Personal Use, the feedrate of", "Finish operation: x",
     "Compensated Tool Path. Diameter: 10.0", "moves, which can increase machining time. Unrestricted rapid", "1001",
     "10 mm carbide, 4 flutes", "begin toolchange"],
)  # fmt: skip
def test_what_a_post_says_of_itself_is_no_operation(comment):
    assert operation_name(comment) == ("", False)


@pytest.mark.parametrize("comment", ["HELICAL RAMP", "LEAD IN", "lead-out", "Ramp", "DEPTH 2", "PASS 3", "PLUNGE"])
def test_what_happens_inside_an_operation_is_no_operation(comment):
    assert operation_name(comment) == ("", False)


@pytest.mark.parametrize(
    ("change", "names"), [("T2 M6\nS6000 M3\n", ("POCKET 1", "POCKET 2")), ("S6000 M3\n", ("BOTTOM", "POCKET 2"))]
)
def test_a_comment_on_the_way_to_the_first_cut_is_inside_the_operation(tmp_path, change, names):
    """In a program with tools; a program without tools may be written by hand, with a comment anywhere."""
    program = (
        f"G21 G90\n(POCKET 1)\n{change}G0 X0 Y0 Z5\n(BOTTOM)\nG1 Z-1 F500\nX10\nG0 Z5\n"
        "(POCKET 2)\nG0 X20\nG1 Z-1\nX30\nG0 Z5\nM30\n"
    )
    (tmp_path / "part.nc").write_text(program)
    assert read_toolpath(tmp_path / "part.nc").program.operations == names
