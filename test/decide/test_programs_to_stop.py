"""No dangerous program or cell is released, no sound one is stopped; the volume that rapid moves remove is exact.

Each row of CASES has the finding of ``check``. The programs about rapid moves start with the top of the stock at z = 0;
their volumes are closed forms, with the radius R of the cutter, the length l of the rapid move and the depth d.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pytest
from cuttings import SET_ALUMINIUM
from small_part import small_part

from kr270_milling.base.errors import MillingError
from kr270_milling.base.record import find_file
from kr270_milling.cell.cell import Cell, read_cell
from kr270_milling.cell.jobs import simulate
from kr270_milling.decide.check import check
from kr270_milling.decide.check_cut import engagement, rapid_violations

START = "G21 G90 S8000 M3\nG0 X-14 Y0 Z2\n"
SLOT = START + "G0 Z-0.5\nG1 X26 F4000\nG0 Z5\nM30\n"  # the stock: x 0 to 40, y -14 to 40, z -10 to 0; cutter 20 mm
DOWN = "G21 G90 S8000 M3\nG0 X20 Y0 Z2\nG1 Z-0.5 F500\nG1 X26 F4000\nG0 Z2\nM30\n"
HOLES = "G21 G90 S8000 M3\nG0 X10 Y0 Z5\nG81 X10 Y0 Z-3 R1 F400\nX12 Y20\nG80\nG0 Z20\nM30\n"
EDGE = ("G21 G90 S8000 M3\nG0 X-14 Y-26 Z2\nG0 Z-10.5\nG0 X-11 Y-25\nG0 Z2\nG0 X-14 Y0\nG0 Z-0.5\nG1 X26 F4000\n"
        "G0 Z5\nM30\n")  # fmt: skip
APT = "UNITS/MM\nCUTTER/{}\nSPINDL/8000,RPM,CLW\nRAPID\nGOTO/-14,0,2\nRAPID\nGOTO/-14,0,-0.5\nFEDRAT/4000,MMPM\n" \
      "GOTO/26,0,-0.5\nRAPID\nGOTO/26,0,5\nFINI\n"  # fmt: skip
CSV = "x_mm,y_mm,z_mm,feed_mm_per_min\n-14,0,-0.5,4000\n26,0,-0.5,4000\n"
COARSE = ("stock.grid_step_um=200", "timing.rapid_feed_m_per_min=6")
#: a narrow cut with a tool mode
NARROW = SLOT.replace("Y0", "Y-23.95")
MODE = "tool.modes=[{{direction: [0.0, 1.0, 0.0], frequency_hz: 980.0, damping_ratio: 0.025, mass_kg: {}}}]"


@dataclass(frozen=True)
class Case:
    """A program in a cell, and the finding about it: "refused" for an error, "" for a sound program."""

    name: str
    program: str  #: "": the paper's straight cut
    settings: tuple[str, ...] = ()
    finding: str = ""
    severity: str = "stop"
    suffix: str = ".nc"
    lines: tuple = (None,)  #: of the program, one of which the finding names
    value: float | None = None  #: of the finding, in its unit
    limit: float | None = None
    words: str = ""  #: in the sentence of the finding


def comment(text: str) -> str:
    """The slot with a comment on its tool, in line 2."""
    return SLOT.replace("G0 X-14", f"(T1 {text})\nT1 M6\nS8000 M3\nG0 X-14", 1)


def law(k_tc: float) -> tuple[str, ...]:
    return *SET_ALUMINIUM, f"cutting.linear_edge.tangential_cutting_n_per_mm2={k_tc}"


def warning(name: str, program: str, settings: tuple[str, ...], finding: str, **more) -> Case:
    return Case(name, program, settings, finding, "warning", **more)


CASES = (
    Case("rapid move in a drilled hole, below its bottom", HOLES.replace("G0 Z20", "G0 Z-3.5\nG0 Z20"),
         (), "rapid in material"),
    Case("a spindle of 300 kg", SLOT, ("mount.mass_kg=300",), "payload"),
    Case("a program for a cutter of 10 mm", comment("D=10 flat end mill"), (), "tool diameter", lines=(3,)),
    Case("a program for a cutter of 1 inch", comment("1 inch end mill"), (), "tool diameter"),
    Case("a ball-end mill by its comment", comment("D=20 ball end mill"), (), "tool shape", lines=(3,)),
    Case("a ball-end mill by its corner", comment("D=20. CR=10. - ZMIN=-0.5"), (), "tool shape"),
    Case("a bull-nose mill", comment("D=20. CR=2. - ZMIN=-0.5 - bullnose end mill"), (), "tool shape"),
    Case("a chamfer mill", comment("D=20. - chamfer mill"), (), "tool shape"),
    Case("a ball-end mill of APT", APT.format("20,10"), (), "tool shape", suffix=".apt"),
    Case("a force coefficient a thousand times too small", SLOT, law(0.6), "force coefficient",
         value=0.6, limit=0.3 * 243.77),  # the least of config/materials.csv
    Case("a force coefficient ten times too large", SLOT, law(6004.6), "force coefficient",
         value=6004.6, limit=3.0 * 1319.41),  # the largest
    Case("a feature beside the stock",
         SLOT.replace("G0 Z5", "G0 Z5\n(far slot)\nG0 X-60 Y80\nG1 Z-0.5 F500\nX60\nG0 Z5"),
         (), "outside the stock"),
    Case("a path beside the stock", "", ("path.start_mm=[-1000,0]",), "stock missed", value=0.0),
    Case("inches for millimetres", SLOT.replace("G21", "G20"), (), "below the stock",
         lines=(3, 4), value=0.5 * 25.4 - 10),
    Case("through a fixture", SLOT, ("workpiece.fixtures_mm=[30,-5,-10,60,5,-0.2]",), "in the fixture",
         lines=(4,), value=0.3, words="fixture 1"),
    Case("rapid move into a fixture", SLOT, ("workpiece.fixtures_mm=[-30,-5,-10,-10,5,1]",), "in the fixture",
         lines=(3, 4), value=1.5),
    Case("deeper than the flutes", SLOT, ("tool.flute_length_mm=0.4",), "depth of cut",
         lines=(4,), value=0.5, limit=0.4),
    Case("a plunge with a cutter that cannot", DOWN, ("tool.centre_cutting=false",), "plunge",
         lines=(3, 4), value=0.5, limit=0.0),
    Case("more feed per tooth than the cutter takes", SLOT, ("tool.max_feed_per_tooth_mm=0.1",), "feed per tooth",
         value=4000 / 8000 / 4, limit=0.1),
    Case("faster than the cutter takes", SLOT, ("tool.max_cutting_speed_m_per_min=400",), "cutting speed",
         value=math.pi * 0.02 * 8000, limit=400),
    Case("a narrow cut above the limit depth of the tool", NARROW.replace("Z-0.5", "Z-8"),
         (MODE.format(0.01), "stock.grid_step_um=20"), "chatter"),
    Case("deflection beyond the linear model", SLOT,
         ("cutting.fractional.stiffness_n_per_m=5e10", "dynamics.gravity=false"), "deflection", limit=50.0),
    Case("out of reach", SLOT.replace("X26", "X26\nG1 Y2500"), (), "reach", lines=(5, 6),
         words="out of reach at points"),
    Case("a joint beyond its range", SLOT.replace("X26 F4000", "X26 F4000\nG1 X400 Z1500"), (), "joint limit",
         lines=(5, 6), limit=155.0, words="axis 3"),
    Case("a wrist that is stretched", SLOT, ("start_joints_deg=[90,-50,120,180,1,180]",), "singularity",
         lines=(2, 3, 4), words="wrist"),
    Case("an arm that hangs down", SLOT, ("arm.joint_compliance_urad_per_n_m=[900,900,900,900,900,900]",),
         "joint deflection", words="joint 2"),
    Case("another spindle speed than the cell's", SLOT.replace("S8000", "S9000"), (), "refused"),
    Case("a wrong datum", SLOT.replace("Y0", "Y500"), (), "refused"),

    warning("a reground cutter", comment("D=20 flat end mill"), ("tool.diameter_mm=19.8",), "tool diameter"),
    warning("a program that never starts the spindle", SLOT.replace(" S8000 M3", ""), (), "spindle off"),
    warning("a path that is beside the stock mostly", SLOT.replace("X26 F4000", "X26 F4000\nY160"), (),
            "stock too small", limit=50),
    warning("a feed in the wrong unit", SLOT.replace("F4000", "F170000"), (), "feed per tooth",
            value=170 / 8 / 4, limit=5.0),
    warning("a tool smaller than the grid", SLOT, ("tool.diameter_mm=0.9",), "tool and grid",
            value=0.2, limit=0.0225),
    warning("a workpiece in another room", SLOT, ("workpiece.xyz_mm=[0,-16331.9,485.7]",), "envelope", value=16.3319),
    warning("compliances a thousand times too large", SLOT,
            ("arm.joint_compliance_urad_per_n_m=[700,300,400,900,900,2000]",), "compliance", value=700, limit=100),
    warning("compliances a thousand times too small", SLOT,
            ("arm.joint_compliance_urad_per_n_m=[7e-4,3e-4,4e-4,3e-3,3e-3,2e-3]",), "compliance",
            value=7e-4, limit=0.01),
    warning("grams for kilograms", SLOT, ("arm.link_mass_kg=[336800,259.4,85.2,54.5,36.3,18.2]",), "mass",
            value=336800),
    warning("a posture outside the limits", SLOT, ("start_joints_deg=[90,-50,170,180,25,180]",), "posture",
            value=170, limit=155),
    warning("radians for degrees", SLOT, ("start_joints_deg=[1.5708,-0.8727,2.0944,3.1416,0.4363,3.1416]",),
            "posture", words="radians"),

    Case("the paper's straight cut", ""),
    Case("beside the stock, below its bottom", EDGE),
    Case("a plunge of a cutter that can", DOWN),
    Case("two holes", HOLES),
    Case("two holes by pecks", HOLES.replace("G81", "G83").replace("R1", "R1 Q1")),
    Case("a slot and a hole", SLOT.replace("G0 Z5", "G0 Z5\nG81 X20 Y25 Z-2 R1 F400\nG80")),
    Case("a ramp", "G21 G90 S8000 M3\nG0 X5 Y0 Z2\nG1 Z0.2 F2000\nG1 X25 Z-0.8\nG1 X5\nG0 Z5\nM30\n",
         ("tool.centre_cutting=false",)),
    Case("a helix", "G21 G90 S8000 M3\nG0 X20 Y0 Z1\nG3 X20 Y0 Z-0.5 I-8 J0 F2000\nG3 X20 Y0 I-8 J0\nG0 Z5\nM30\n",
         ("tool.centre_cutting=false",)),
    Case("into a sacrificial plate", SLOT, ("stock.min_mm=[0,-14,-0.3]", "limits.below_stock_mm=0.25")),
    Case("over a clamp", SLOT, ("workpiece.fixtures_mm=[-30,-5,-30,-10,5,-0.6]",)),
    Case("the payload of the arm", SLOT, ("mount.mass_kg=270",)),
    Case("the cutter of the comment", comment("D=20 flat end mill")),
    Case("a flat mill with CR=0", comment("D=20. CR=0. - ZMIN=-0.5 - flat end mill")),
    Case("a ball-end mill that is declared flat", comment("D=20 ball end mill"), ("tool.type=flat",)),
    Case("a flat mill of APT", APT.format("20,0"), suffix=".apt"),
    Case("a table of points", CSV, suffix=".csv"),
    Case("a published force coefficient", SLOT, law(600.46)),
    Case("a narrow cut below the limit depth of the tool", NARROW, (MODE.format(3.7), "stock.grid_step_um=20")),
    Case("inches", SLOT.replace("G21", "G20").replace("X-14", "X-0.55").replace("X26 F4000", "X1 F157")
         .replace("Z-0.5", "Z-0.02").replace("Z5", "Z0.2").replace("Z2", "Z0.08")),
    Case("flutes, chip and speed just within the cutter's data", SLOT,
         ("tool.flute_length_mm=0.51", "tool.max_feed_per_tooth_mm=0.126", "tool.max_cutting_speed_m_per_min=503")),
)  # fmt: skip


def cell_of_case(case: Case, directory) -> Cell:
    if not case.program:
        return read_cell(find_file("paper.yaml"), case.settings)
    cell = small_part(directory, case.program, *COARSE, *case.settings)
    path = directory / f"part{case.suffix}"
    path.write_text(case.program)
    return cell.replace(path=cell.path.replace(file=str(path)))


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_a_dangerous_case_has_its_finding_and_a_sound_case_is_released(tmp_path, case):
    if case.finding == "refused":
        with pytest.raises(MillingError):
            check(cell_of_case(case, tmp_path))
        return
    checked = check(cell_of_case(case, tmp_path))
    text = "\n".join(checked.lines())
    if not case.finding:
        warnings = {f.what for f in checked.findings if f.severity == "warning"}
        assert checked.may_be_run and not warnings - {"tool and grid"}, text  # the grid of the table is coarse
        return
    assert checked.may_be_run == (not checked.count("stop"))
    named = [f for f in checked.findings if (f.what, f.severity) == (case.finding, case.severity)]
    finding = next(f for f in named if case.words in f.sentence)
    assert finding.sentence in text and finding.advice in text and finding.advice.endswith((".", ")."))
    assert case.lines == (None,) or finding.where.line in case.lines
    assert finding.where.line is None or f"(line {finding.where.line})" in finding.text
    assert case.value is None or finding.value == pytest.approx(case.value, rel=1e-3, abs=1e-9)
    assert case.limit is None or finding.limit == pytest.approx(case.limit, rel=1e-6)


def test_drilling_is_reported_without_a_force_and_without_a_deviation(tmp_path):
    cases = {case.name: case for case in CASES}
    checked = check(cell_of_case(cases["two holes"], tmp_path))
    (finding,) = [f for f in checked.findings if f.what == "drilling"]
    assert "drilling: force not modelled (2 holes)" in finding.text and finding.where.line == 3
    assert checked.ran.result.removed_volume > 0.0
    assert np.abs(checked.ran.result.wrench).max() < 1e-9 and checked.ran.result.torque.max() < 1e-9  # rounding
    both = simulate(cell_of_case(cases["a slot and a hole"], tmp_path)).result
    force = np.abs(both.wrench).max(axis=1)
    assert force.max() > 10.0 and force[both.actual[:, 1] > 0.02].max() < 1e-9


# --- Rapid moves through material ---
DIAMETERS_MM = (2.0, 20.0, 50.0)
BELOW = ("G0 X0 Y0 Z5", "G1 Z-1 F1200")


def contacts_of(directory, diameter: float, lines) -> tuple[list, list[int]]:
    """The rapid moves through material along the programmed path, and their lines of the program.

    A stock of 8 by 6 diameters [mm] with the origin in the middle of its top; the first of ``lines`` has number 3.
    """
    x, y = 4.0 * diameter, 3.0 * diameter
    program = "\n".join(("G21 G90 G17", "S8000 M3", *lines, "G0 Z5", "M30", ""))
    stock = f"stock.min_mm=[{-x},{-y},-25]", f"stock.max_mm=[{x},{y},0]"
    cell = small_part(directory, program, *stock, f"tool.diameter_mm={diameter}", "timing.rapid_feed_m_per_min=6")
    contacts = rapid_violations(cell.target(), engagement(cell, cell.limits.rapid_contact))
    return contacts, [int(cell.fed_path.toolpath.line[one.block]) for one in contacts]


def dangerous(d: float) -> dict[str, tuple]:
    """Name -> lines of the program, removed volume [mm3], numbers of lines that are stops, largest depth [mm].

    Of short rapid moves that follow each other, a few at the ends need not be a contact: they have no numbers.
    """
    r, pi = d / 2.0, math.pi
    turn = [2.0 * pi * k / 48 for k in range(1, 97)]
    helix = [f"G0 X{r / 2 * math.cos(a):.5f} Y{r / 2 * math.sin(a):.5f} Z{-min(a / (2.0 * pi), 1.0):.5f}" for a in turn]
    chords = [f"G0 X{x:.6f}" for x in np.linspace(0.0, r, 101)[1:]]
    wall = (f"G0 X{-11 * r} Y0 Z5", "G0 Z-1", f"G1 X{11 * r} F1200", "Y0.1", f"G0 X{-11 * r}")
    return {
        "slot in short chords": ((*BELOW, *chords), d * r, (), 1.0),
        "corner": ((*BELOW, f"G0 X{3 * r}", f"G0 Y{d}"), 5.0 * d * r - r**2 + pi * r**2 / 4.0, (5, 6), 1.0),
        "diagonal": ((*BELOW, f"G0 X{d} Y{d}"), d * math.sqrt(2) * d, (5,), 1.0),
        "helix": ((f"G0 X{r / 2} Y0 Z5", "G1 Z0 F1200", *helix), pi * (1.5 * r) ** 2, (), 1.0),
        "vertical": (("G0 X0 Y0 Z5", "G0 Z-0.5", f"G1 X{r} F1200"), pi * r**2 / 2.0, (4,), 0.5),
        "start in material": (("G0 X0 Y0 Z-0.5", f"G1 X{r} F1200"), pi * r**2 / 2.0, (3,), 0.5),
        "too low above the stock": ((*BELOW, "G0 Z-0.1", f"G0 X{2 * d}"), 0.1 * d * 2.0 * d, (6,), 0.1),
        "wall, 0.1 mm deep": (wall, 0.1 * 8.0 * d, (7,), 1.0),
    }


def sound(d: float) -> dict[str, tuple[str, ...]]:
    """Name -> lines of a program whose rapid moves touch no material."""
    r = d / 2.0
    return {
        "along a wall": (f"G0 X{-11 * r} Y0 Z5", "G0 Z-1", f"G1 X{11 * r} F1200", f"G1 Y{r}", f"G1 X{-11 * r}",
                         f"G0 X{11 * r}"),
        "across a pocket": (*BELOW, f"G1 X{r}", f"G1 Y{r}", "G1 X0", "G1 Y0", f"G0 X{r} Y{r}"),
        "round an arc and back": (*BELOW, f"G2 X{2 * d} Y0 I{d} J0", f"G3 X0 Y0 I{-d} J0"),
        "up a steep ramp": (BELOW[0], "G1 Z0 F1200", f"G1 X{r} Z{-r}", f"G0 X{r / 2} Z{-r / 2}"),
        "down into a hole": (BELOW[0], "G1 Z-1 F600", "G0 Z2", "G0 Z-0.9", "G1 Z-2"),
    }  # fmt: skip


DANGEROUS = {f"{name}, {d:g} mm": (d, *row) for d in DIAMETERS_MM for name, row in dangerous(d).items()}
SOUND = {f"{name}, {d:g} mm": (d, lines) for d in DIAMETERS_MM for name, lines in sound(d).items()}
BACK = SLOT.replace("G0 Z5", "G0 Z-0.4\nG0 X-14\nG0 Z5")
THROUGH = SLOT.replace("X26 F4000", "X12 F4000\nG0 X20\nG1 X26")
SHORT = ("timing.rapid_feed_m_per_min=4", "stock.grid_step_um=100")


@pytest.mark.parametrize("name", DANGEROUS)
def test_every_rapid_move_through_material_is_a_stop_with_its_volume(tmp_path, name):
    diameter, lines, volume, stops, depth = DANGEROUS[name]
    contacts, numbers = contacts_of(tmp_path, diameter, lines)
    assert {one.severity for one in contacts} == {"stop"} and numbers == list(stops or numbers)
    assert 1e3 * max(one.value for one in contacts) == pytest.approx(depth, rel=1e-6)
    assert sum(one.amounts["volume_mm3"] for one in contacts) == pytest.approx(volume, rel=0.02)


@pytest.mark.parametrize("name", SOUND)
def test_a_rapid_move_in_the_air_is_no_contact(tmp_path, name):
    assert contacts_of(tmp_path, *SOUND[name]) == ([], [])


@pytest.mark.parametrize("factor", [1e-3, 10.0], ids=["rigid", "10 times softer"])
@pytest.mark.parametrize(("program", "answer"), [(THROUGH, 2.0 * 10.0 * 8.0 * 0.5), (BACK, 0.0)])
def test_the_answer_does_not_depend_on_the_stiffness_of_the_arm(tmp_path, factor, program, answer):
    compliance = 1e6 * factor * read_cell(find_file("paper.yaml")).arm.joint_compliance
    soft = (*SHORT, f"arm.joint_compliance_urad_per_n_m={compliance.tolist()}", "dynamics.gravity=false")
    cell = small_part(tmp_path, program, *soft)
    target = cell.target()
    for reference in (None, target.with_position(target.position + [0.0, 5e-5, 0.0], target.velocity)):
        checked = check(cell, reference)
        assert checked.rapid_volume_mm3 == pytest.approx(answer, rel=0.02), checked.lines()
        stops = [f for f in checked.findings if f.what == "rapid in material"]
        assert [(f.severity, f.where.line) for f in stops] == [("stop", 5)] * bool(answer)


def test_a_corrected_path_that_lowers_a_rapid_move_into_the_floor_is_a_stop(tmp_path):
    cell = small_part(tmp_path, BACK, *SHORT)
    target, fed = cell.target(), cell.timed_path
    back = fed.toolpath.line[fed.block] == 6
    lower = np.where(back, -0.6e-3, 0.0)[:, None] * [0.0, 0.0, 1.0]
    checked = check(cell, target.with_position(target.position + lower, target.velocity))
    stops = [f for f in checked.findings if f.what == "rapid in material"]
    assert stops and stops[0].where.line in (5, 6, 7) and checked.rapid_volume_mm3 > 0.0, checked.lines()
