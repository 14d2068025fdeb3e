"""Cells and paths that are wrong, each with the finding that it must give, and everyday programs that may be run."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pytest
from small_part import small_part

from kr270_milling.base.errors import MillingError
from kr270_milling.base.record import find_file
from kr270_milling.cell.cell import read_cell
from kr270_milling.decide.check import check

START = "G21 G90 S8000 M3\nG0 X-14 Y0 Z2\n"
SLOT = START + "G0 Z-0.5\nG1 X26 F4000\nG0 Z5\nM30\n"  # the stock: x 0 to 40, y -14 to 40, z -10 to 0; cutter 20 mm
DOWN = "G21 G90 S8000 M3\nG0 X20 Y0 Z2\nG1 Z-0.5 F500\nG1 X26 F4000\nG0 Z2\nM30\n"
FIRM = "dynamics.modes=[{frequency_hz: 60, damping_ratio: 0.02, shape: [0.0, 0.2, 0.0, 0.0, 0.0, 0.0]}]"
#: a light mode at the tooth frequency of a slow spindle, far above its limit depth
CHATTERS = (FIRM, "dynamics.reference_inertia=false", "stock.grid_step_um=20", "path.length_mm=20",
            "tool.spindle_speed_rpm=800", "path.feed_rate_m_per_min=0.4", "exchange.period_ms=0.625",
            "path.depth_of_cut_mm=9")  # fmt: skip


@dataclass(frozen=True)
class Wrong:
    """A program or settings, and the finding: line of the program, value and limit in its unit where they are known."""

    what: str
    program: str = SLOT
    settings: tuple[str, ...] = ()
    severity: str = "stop"
    lines: tuple = (None,)
    value: float | None = None
    limit: float | None = None
    words: str = ""
    moved: dict = field(default_factory=dict)  #: point -> shift [m] of a corrected trajectory


WRONG = {
    "rapid through material": Wrong(
        "rapid in material", SLOT.replace("G0 Z5", "G0 X26 Y34\nG0 Z5"), lines=(5,), value=0.5),
    "rapid along a wall, deeper than it springs back": Wrong(
        "rapid in material", SLOT.replace("G0 Z5", "G0 Z2\nG0 X26 Y0.4\nG0 Z-0.5\nG0 X0\nG0 Z5"), lines=(7, 8)),
    "below the stock's bottom": Wrong(
        "below the stock", settings=("stock.min_mm=[0,-14,-0.3]",), lines=(3, 4), value=0.2, limit=0.0),
    "inches for millimetres": Wrong(
        "below the stock", SLOT.replace("G21", "G20"), lines=(3, 4), value=0.5 * 25.4 - 10),
    "in the fixture": Wrong(
        "in the fixture", settings=("workpiece.fixtures_mm=[30,-5,-10,60,5,-0.2, 90,90,0,99,99,50]",), lines=(4,),
        value=0.3, words="fixture 1"),
    "rapid into the fixture": Wrong(
        "in the fixture", settings=("workpiece.fixtures_mm=[-30,-5,-10,-10,5,1]",), lines=(3, 4), value=1.5),
    "deeper than the flutes": Wrong(
        "depth of cut", settings=("tool.flute_length_mm=0.4",), lines=(4,), value=0.5, limit=0.4),
    "a plunge with a cutter that cannot": Wrong(
        "plunge", DOWN, ("tool.centre_cutting=false",), lines=(3, 4), value=0.5, limit=0.0),
    "more feed per tooth than the cutter takes": Wrong(
        "feed per tooth", settings=("tool.max_feed_per_tooth_mm=0.1",), value=4000 / 8000 / 4, limit=0.1),
    "faster than the cutter takes": Wrong(
        "cutting speed", settings=("tool.max_cutting_speed_m_per_min=400",), value=np.pi * 0.02 * 8000, limit=400),
    "chatter": Wrong("chatter", "", CHATTERS, value=9.0, words="above the stability limit"),
    "vibration that grows in the pass": Wrong("growing vibration", "", CHATTERS, limit=0.02),
    "deflection beyond the linear model": Wrong(
        "deflection", settings=("cutting.fractional.stiffness_n_per_m=5e10", "dynamics.gravity=false"), limit=50.0),
    "an arm that hangs down": Wrong(
        "joint deflection", settings=("arm.joint_compliance_urad_per_n_m=[900,900,900,900,900,900]",), words="joint 2"),
    "out of reach": Wrong("reach", SLOT.replace("X26", "X26\nG1 Y2500"), lines=(5, 6), words="out of reach at points"),
    "a joint beyond its range": Wrong(
        "joint limit", SLOT.replace("X26 F4000", "X26 F4000\nG1 X400 Z1500"), lines=(5, 6), limit=155.0,
        words="axis 3"),
    "a wrist that is stretched": Wrong(
        "singularity", settings=("start_joints_deg=[90,-50,120,180,1,180]",), lines=(2, 3, 4), words="wrist"),
    "an axis that must jump": Wrong("joint speed", moved={40: [0.0, 0.4, 0.0]}, lines=(3, 4), words="axis"),
    "a correction beyond its limit": Wrong("correction size", moved={40: [0.0, 2.5e-3, 0.0]}, value=2.5, limit=2.0),
    "more torque than the spindle has": Wrong(
        "spindle torque", settings=("limits.spindle_torque_n_m=0.5",), lines=(4,), limit=0.5),
    "a path beside the stock": Wrong("stock missed", "", ("path.start_mm=[-1000,0]",), value=0.0),
    "a feed in the wrong unit": Wrong(
        "feed per tooth", SLOT.replace("F4000", "F170000"), (), "warning", value=170 / 8 / 4, limit=5.0),
    "a tool smaller than the grid": Wrong(
        "tool and grid", SLOT, ("tool.diameter_mm=0.9",), "warning", value=0.05, limit=0.0225),
    "a workpiece in another room": Wrong(
        "envelope", settings=("workpiece.xyz_mm=[0,-16331.9,485.7]",), severity="warning", value=16.3319),
    "compliances a thousand times too large": Wrong(
        "compliance", settings=("arm.joint_compliance_urad_per_n_m=[700,300,400,900,900,2000]",), severity="warning",
        value=700, limit=100),
    "compliances a thousand times too small": Wrong(
        "compliance", settings=("arm.joint_compliance_urad_per_n_m=[7e-4,3e-4,4e-4,3e-3,3e-3,2e-3]",),
        severity="warning", value=7e-4, limit=0.01),
    "grams for kilograms": Wrong(
        "mass", settings=("arm.link_mass_kg=[336800,259.4,85.2,54.5,36.3,18.2]",), severity="warning", value=336800),
    "a posture outside the limits": Wrong(
        "posture", settings=("start_joints_deg=[90,-50,170,180,25,180]",), severity="warning", value=170, limit=155),
    "radians for degrees": Wrong(
        "posture", settings=("start_joints_deg=[1.5708,-0.8727,2.0944,3.1416,0.4363,3.1416]",), severity="warning",
        words="radians"),
}  # fmt: skip


@pytest.mark.parametrize("name", WRONG)
def test_what_is_wrong_is_found_at_its_place_with_its_value(tmp_path, name):
    wrong = WRONG[name]
    paper = find_file("paper.yaml")
    cell = small_part(tmp_path, wrong.program, *wrong.settings) if wrong.program else read_cell(paper, wrong.settings)
    checked = check(cell, _moved(cell, wrong.moved))
    found = [f for f in checked.findings if (f.what, f.severity) == (wrong.what, wrong.severity)]
    found = [f for f in found if wrong.words in f.sentence]
    assert len(found) == 1, checked.lines()
    (finding,) = found
    assert finding.advice.endswith((".", ").")) and finding.count >= 1
    assert wrong.moved or finding.where.line in wrong.lines or wrong.lines == (None,)
    assert wrong.value is None or finding.value == pytest.approx(wrong.value, rel=1e-3, abs=1e-9)
    assert wrong.limit is None or finding.limit == pytest.approx(wrong.limit, rel=1e-6)
    assert checked.may_be_run == (not checked.count("stop")) and (wrong.severity == "warning" or not checked.may_be_run)
    text = "\n".join(checked.lines())
    assert finding.sentence in text and finding.advice in text and (finding.where.line is None or "(line" in text)


def _moved(cell, shifts: dict):
    """The path with some points moved."""
    if not shifts:
        return None
    target = cell.target()
    position = target.position.copy()
    for point, shift in shifts.items():
        position[point] += shift
    return target.with_position(position, target.velocity)


EVERYDAY = {
    "a slot that ends in material and retracts": (SLOT,),
    "back at rapid through its own slot": (SLOT.replace("G0 Z5", "G0 X-14\nG0 Z5"),),
    "a face in two lanes": (START + "G0 Z-0.5\nG1 X54 F4000\nG0 Y15\nG1 X-14\nG0 Z5\nM30\n",),
    "the same wall twice": (START + "G0 Z-0.5\nG1 X54 F4000\nX-14\nG0 Z5\nM30\n",),
    "pecks that go back rapidly into their hole": (
        "G21 G90 S8000 M3\nG0 X10 Y0 Z5\nG83 X10 Y0 Z-3 R1 Q1 F400\nG80\nG0 Z20\nM30\n",),
    "a plunge of a cutter that can": (DOWN,),
    "a ramp without an edge in the middle": (
        "G21 G90 S8000 M3\nG0 X5 Y0 Z2\nG1 Z0.2 F2000\nG1 X25 Z-0.8\nG1 X5\nG0 Z5\nM30\n", "tool.centre_cutting=false"),
    "a helix without an edge in the middle": (
        "G21 G90 S8000 M3\nG0 X20 Y0 Z1\nG3 X20 Y0 Z-0.5 I-8 J0 F2000\nG3 X20 Y0 I-8 J0\nG0 Z5\nM30\n",
        "tool.centre_cutting=false"),
    "a cut on the edge below the bottom of the stock beside it": (
        "G21 G90 S8000 M3\nG0 X-14 Y-26 Z2\nG0 Z-10.5\nG0 X-11 Y-25\nG0 Z2\nG0 X-14 Y0\nG0 Z-0.5\nG1 X26 F4000\n"
        "G0 Z5\nM30\n",),
    "through the stock into a sacrificial plate": (SLOT, "stock.min_mm=[0,-14,-0.3]", "limits.below_stock_mm=0.25"),
    "a clamp that the tool passes over": (SLOT, "workpiece.fixtures_mm=[-30,-5,-30,-10,5,-0.6]"),
    "flutes, chip and speed just within the cutter's data": (
        SLOT, "tool.flute_length_mm=0.51", "tool.max_feed_per_tooth_mm=0.126", "tool.max_cutting_speed_m_per_min=503"),
}  # fmt: skip


@pytest.mark.parametrize("name", EVERYDAY)
def test_everyday_work_may_be_run(tmp_path, name):
    checked = check(small_part(tmp_path, *EVERYDAY[name]))
    assert checked.may_be_run and not checked.count("warning"), checked.lines()


def test_there_are_twenty_wrong_ones_of_many_kinds():
    assert len(WRONG) >= 20 and len({wrong.what for wrong in WRONG.values()}) >= 20


@pytest.mark.parametrize(("program", "words"), [
    (SLOT.replace("S8000", "S9000"), "S9000 is not the tool.spindle_speed_rpm of the cell, 8000"),
    (SLOT.replace("M3", "M4"), "counterclockwise"),
    (SLOT.replace("Z-0.5", "Z0.5"), "never reaches the stock"),
])  # fmt: skip
def test_a_program_of_another_cell_is_refused(tmp_path, program, words):
    with pytest.raises(MillingError, match=words):
        check(small_part(tmp_path, program))
