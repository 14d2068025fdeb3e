"""One pocket as seven posts write it: the same path, the same features, and what the programs say beside it."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from kr270_milling.path.cam.gcode.reader import read_gcode
from kr270_milling.path.source_program import ProgramError

PROGRAMS = Path(__file__).parent / "programs"
ONE_TOOL = ("fusion_haas.nc", "fusion_grbl.nc", "freecad_linuxcnc.ngc", "mastercam_fanuc.nc", "linuxcnc.ngc",
            "sinumerik.mpf")  # fmt: skip
ALL = (*ONE_TOOL, "haas.nc")
TOOL = {"haas.nc": "T1"}
#: [mm], lengths of the pocket: down from 15, four circles of radius 4, of which three descend by 1; two rings; up again
CIRCLES = 3 * math.hypot(8 * math.pi, 1) + 8 * math.pi
RINGS = 4 + 5 + 16 + 10 + 16 + 5 + 6 + 8 + 24 + 16 + 24 + 8 + 4 * math.pi
LENGTH = 13 + CIRCLES + RINGS + math.pi / 2 + 15


def read(name: str):
    return read_gcode(PROGRAMS / name, tool=TOOL.get(name, ""))


def cutting_points(path) -> np.ndarray:
    """Points at equal distances along the path from the first cut on, (400, 3), mm."""
    ends = np.cumsum(path.block_length)
    first, last = ends[np.flatnonzero(~path.rapid)[0] - 1], ends[np.flatnonzero(~path.rapid)[-1]]
    return 1e3 * path.on_path(np.linspace(first, last, 400)[1:-1])[0]


@pytest.mark.parametrize("name", ALL)
def test_every_dialect_gives_the_same_path(name):
    path, reference = read(name), read("fusion_haas.nc")
    np.testing.assert_allclose(cutting_points(path), cutting_points(reference), atol=2e-3)  # chords of 2 um
    assert 1e3 * path.length == pytest.approx(LENGTH, abs=0.01)
    np.testing.assert_allclose(path.program.feeds, [0.005, 0.8 / 60], rtol=1e-6)


@pytest.mark.parametrize("name", ALL)
def test_the_path_comes_from_above_and_ends_above(name):
    path = read(name)
    np.testing.assert_allclose(1e3 * path.position[[0, 1]], [[4, 0, 15], [4, 0, 2]], atol=1e-5)
    assert 1e3 * path.position[-1, 2] == pytest.approx(15, abs=1e-5)
    assert path.rapid[-1] and 1e3 * path.position[~path.rapid, 2].min() == pytest.approx(-1, abs=1e-5)


@pytest.mark.parametrize("name", ALL)
def test_operation_comments_name_the_features(name):
    features = [feature.lower() for feature in read(name).features]
    assert features == ["", "2d pocket1", "2d pocket1 finish"]


@pytest.mark.parametrize("name", ALL)
def test_speed_offset_and_tool_are_those_of_the_program(name):
    program = read(name).program
    assert [round(speed * 30 / math.pi) for speed in program.spindle_speeds] == [5000]
    assert program.work_offset == ("" if name == "linuxcnc.ngc" else "G54")
    assert program.tool == ("MILL_10" if name == "sinumerik.mpf" else "T1")


@pytest.mark.parametrize("name", [name for name in ALL if name not in ("linuxcnc.ngc", "sinumerik.mpf")])
def test_the_diameter_of_the_tool_is_read_from_the_comments(name):
    assert read(name).program.current.diameter == pytest.approx(0.010)


@pytest.mark.parametrize("name", ["fusion_haas.nc", "freecad_linuxcnc.ngc", "haas.nc"])
def test_teeth_are_read_from_the_comments(name):
    assert read(name).program.current.teeth == 4


def test_what_moves_nothing_is_summed_up():
    program = read("fusion_haas.nc").program
    assert program.summary == "read over: 2 G53 Z, 1 M8, 1 G43 H1, 1 M9, 1 G53 X Y"
    assert {r.word: r.count for r in read("sinumerik.mpf").program.read_over}["CYCLE832"] == 1


def test_a_program_with_several_tools_is_refused_with_their_list():
    with pytest.raises(
        ProgramError, match=r"2 tools: T1 \(end mill, 10 mm\) from line 11, T2 \(drill, 6 mm\)"
    ) as caught:
        read_gcode(PROGRAMS / "haas.nc")
    assert "path.tool" in str(caught.value) and caught.value.line == 43


def test_a_tool_that_does_not_cut_is_refused_with_those_that_do():
    with pytest.raises(ProgramError, match="does not cut with T5; it does with T1 .*, T2"):
        read_gcode(PROGRAMS / "haas.nc", tool="T5")


def test_the_holes_of_the_other_tool_are_drilled_at_their_places():
    path = read_gcode(PROGRAMS / "haas.nc", tool="2")
    bottoms = 1e3 * path.position[~path.rapid]
    deepest = bottoms[bottoms[:, 2] < -4.5]
    np.testing.assert_allclose(deepest, [[20, 15, -5], [-20, 15, -5], [-20, -15, -6], [-20, -15, -8], [20, -15, -6],
                                         [20, -15, -8]], atol=1e-9)  # fmt: skip
    assert path.features == ("", "DRILL HOLES")
    between = path.position[(path.position[:, 0] < 0) & (path.position[:, 1] > 0)]
    assert 1e3 * between[-1, 2] == pytest.approx(15)  # G98: back to where the cycle was called


def test_a_refusal_carries_the_tools_of_a_program_that_cannot_be_run():
    with pytest.raises(ProgramError) as caught:
        read_gcode(PROGRAMS / "haas.nc")
    program = caught.value.program
    assert [(tool.name, tool.teeth) for tool in program.tools] == [("T1", 4), ("T2", 0)]
    assert program.title == "POCKET PLATE" and [r.word for r in program.refused] == ["T2"]
