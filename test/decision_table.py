"""Programs and cells with the answer that ``check`` must give, dangerous and sound ones; ``before``: that of 0.2.0.

The coarse grid makes 0.2.0 see most rapid moves; ``program_table.ISSUE`` has those that 0.2.0 released.

``python decision_table.py`` in this folder prints the table with the answers of the present version.
"""

from __future__ import annotations

import math
import pathlib
import tempfile
from dataclasses import dataclass

from program_table import Row, dangerous, random_sound, sound
from small_part import small_part

from kr270_milling.base.errors import MillingError
from kr270_milling.decide.check import Checked, check

__all__ = ["CASES", "Case", "answer", "answer_of"]

START = "G21 G90 S8000 M3\nG0 X-14 Y0 Z2\n"
SLOT = START + "G0 Z-0.5\nG1 X26 F4000\nG0 Z5\nM30\n"  # the stock: x 0 to 40, y -14 to 40, z -10 to 0; cutter 20 mm
DOWN = "G21 G90 S8000 M3\nG0 X20 Y0 Z2\nG1 Z-0.5 F500\nG1 X26 F4000\nG0 Z2\nM30\n"
HOLES = "G21 G90 S8000 M3\nG0 X10 Y0 Z5\nG81 X10 Y0 Z-3 R1 F400\nX12 Y20\nG80\nG0 Z20\nM30\n"
APT = "UNITS/MM\nCUTTER/{}\nSPINDL/8000,RPM,CLW\nRAPID\nGOTO/-14,0,2\nRAPID\nGOTO/-14,0,-0.5\nFEDRAT/4000,MMPM\n" \
      "GOTO/26,0,-0.5\nRAPID\nGOTO/26,0,5\nFINI\n"  # fmt: skip
CSV = "x_mm,y_mm,z_mm,feed_mm_per_min\n-14,0,-0.5,4000\n26,0,-0.5,4000\n"
COARSE = ("stock.grid_step_um=200", "timing.rapid_feed_m_per_min=6")
LINEAR = ("cutting.law=linear_edge", "cutting.linear_edge.tangential_cutting_n_per_mm2={}",
          "cutting.linear_edge.tangential_edge_n_per_mm=17.9", "cutting.linear_edge.radial_cutting_n_per_mm2=180.96",
          "cutting.linear_edge.radial_edge_n_per_mm=20.42")  # fmt: skip
#: a tool mode whose limit depth in the slot is 0.15 mm (soft) and 1.5 mm (ten times stiffer)
MODE = "tool.modes=[{{direction: [0.0, 1.0, 0.0], frequency_hz: 980.0, damping_ratio: 0.025, mass_kg: {}}}]"


@dataclass(frozen=True)
class Case:
    """A program in a cell; ``stop``: the finding that forbids it, "refused" for an error, "" for a sound program."""

    name: str
    program: str
    settings: tuple[str, ...] = ()
    stop: str = ""
    warning: str = ""  #: that a sound program must get
    before: str = "released"  #: the answer of version 0.2.0: "released", "stopped" or "refused"
    suffix: str = ".nc"
    lines: tuple = (None,)  #: of the program, one of which the finding names
    value: float | None = None  #: of the finding, in its unit
    limit: float | None = None
    words: str = ""  #: in the sentence of the finding


def comment(text: str) -> str:
    """The slot with a comment on its tool."""
    return SLOT.replace("G0 X-14", f"(T1 {text})\nT1 M6\nS8000 M3\nG0 X-14", 1)


def law(k_tc: float) -> tuple[str, ...]:
    return tuple(text.format(k_tc) for text in LINEAR)


def _of_row(row: Row) -> Case:
    """A row about rapid moves."""
    stop = "rapid in material" if row.volume_mm3 else ""
    missed = not stop or row.name.startswith("wall")
    return Case(row.name, row.program, row.settings, stop, before="released" if missed else "stopped")


DANGEROUS = (
    *map(_of_row, dangerous(20.0)),
    Case("rapid move through the middle of a slot", SLOT.replace("X26 F4000", "X12 F4000\nG0 X20\nG1 X26"),
         (), "rapid in material", before="stopped"),
    Case("rapid move in a drilled hole, below its bottom", HOLES.replace("G0 Z20", "G0 Z-3.5\nG0 Z20"),
         (), "rapid in material", before="stopped"),
    Case("a spindle of 300 kg", SLOT, ("mount.mass_kg=300",), "payload"),
    Case("a program for a cutter of 10 mm", comment("D=10 flat end mill"), (), "tool diameter"),
    Case("a program for a cutter of 1 inch", comment("1 inch end mill"), (), "tool diameter"),
    Case("a ball-end mill by its comment", comment("D=20 ball end mill"), (), "tool shape"),
    Case("a ball-end mill by its corner", comment("D=20. CR=10. - ZMIN=-0.5"), (), "tool shape"),
    Case("a bull-nose mill", comment("D=20. CR=2. - ZMIN=-0.5 - bullnose end mill"), (), "tool shape"),
    Case("a chamfer mill", comment("D=20. - chamfer mill"), (), "tool shape"),
    Case("a ball-end mill of APT", APT.format("20,10"), (), "tool shape", suffix=".apt"),
    Case("a force coefficient a thousand times too small", SLOT, law(0.6), "force coefficient"),
    Case("a force coefficient ten times too large", SLOT, law(6004.6), "force coefficient"),
    Case("a feature beside the stock",
         SLOT.replace("G0 Z5", "G0 Z5\n(far slot)\nG0 X-60 Y80\nG1 Z-0.5 F500\nX60\nG0 Z5"),
         (), "outside the stock"),
    Case("below the bottom of the stock", SLOT, ("stock.min_mm=[0,-14,-0.3]",), "below the stock", before="stopped",
         lines=(3, 4), value=0.2, limit=0.0),
    Case("a hole through the bottom of the stock", HOLES.replace("Z-3", "Z-11"), (), "below the stock",
         before="stopped"),
    Case("inches for millimetres", SLOT.replace("G21", "G20"), (), "below the stock", before="stopped",
         lines=(3, 4), value=0.5 * 25.4 - 10),
    Case("through a fixture", SLOT, ("workpiece.fixtures_mm=[30,-5,-10,60,5,-0.2]",), "in the fixture",
         before="stopped",
         lines=(4,), value=0.3, words="fixture 1"),
    Case("deeper than the flutes", SLOT, ("tool.flute_length_mm=0.4",), "depth of cut", before="stopped",
         lines=(4,), value=0.5, limit=0.4),
    Case("a plunge with a cutter that cannot", DOWN, ("tool.centre_cutting=false",), "plunge", before="stopped",
         lines=(3, 4), value=0.5, limit=0.0),
    Case("more feed per tooth than the cutter takes", SLOT, ("tool.max_feed_per_tooth_mm=0.1",), "feed per tooth",
         before="stopped",
         value=4000 / 8000 / 4, limit=0.1),
    Case("faster than the cutter takes", SLOT, ("tool.max_cutting_speed_m_per_min=400",), "cutting speed",
         before="stopped",
         value=math.pi * 0.02 * 8000, limit=400),
    Case("more torque than the spindle gives", SLOT, ("limits.spindle_torque_n_m=0.5",), "spindle torque",
         before="stopped",
         lines=(4,), limit=0.5),
    Case("more power than the spindle gives", SLOT, ("limits.spindle_power_kw=0.1",), "spindle power",
         before="stopped"),
    Case("a slot above the limit depth of the tool", SLOT, (MODE.format(0.037),), "chatter"),
    Case("a narrow cut above the limit depth of the tool",
         SLOT.replace("Z-0.5", "Z-8").replace("Y0", "Y-23.95"), (MODE.format(0.01), "stock.grid_step_um=20"),
         "chatter"),
    Case("out of reach", SLOT.replace("X26", "X26\nG1 Y2500"), (), "reach", before="stopped",
         lines=(5, 6), words="out of reach at points"),
    Case("an arm that hangs down", SLOT, ("arm.joint_compliance_urad_per_n_m=[900,900,900,900,900,900]",),
         "joint deflection", before="stopped",
         words="joint 2"),
    Case("another spindle speed than the cell's", SLOT.replace("S8000", "S9000"), (), "refused", before="refused"),
    Case("another sense of rotation", SLOT.replace("M3", "M4"), (), "refused", before="refused"),
    Case("a cut while the spindle is off", SLOT.replace("G1 X26 F4000", "G1 X10 F4000\nM5\nX26"), (), "refused",
         before="refused"),
    Case("a wrong datum", SLOT.replace("Y0", "Y500"), (), "refused", before="refused"),
)  # fmt: skip

SOUND = (
    *map(_of_row, sound(20.0)),
    *(_of_row(random_sound(seed)) for seed in (1, 4, 5, 8)),
    Case("a slot", SLOT),
    Case("back at rapid through its own slot", SLOT.replace("G0 Z5", "G0 X-14\nG0 Z5")),
    Case("a face in two lanes", START + "G0 Z-0.5\nG1 X54 F4000\nG0 Y15\nG1 X-14\nG0 Z5\nM30\n"),
    Case("the same wall twice", START + "G0 Z-0.5\nG1 X54 F4000\nX-14\nG0 Z5\nM30\n"),
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
    Case("a reground cutter", comment("D=20 flat end mill"), ("tool.diameter_mm=19.8",), warning="tool diameter"),
    Case("a flat mill with CR=0", comment("D=20. CR=0. - ZMIN=-0.5 - flat end mill")),
    Case("a ball-end mill that is declared flat", comment("D=20 ball end mill"), ("tool.type=flat",)),
    Case("a flat mill of APT", APT.format("20,0"), suffix=".apt"),
    Case("a table of points", CSV, suffix=".csv"),
    Case("a program that never starts the spindle", SLOT.replace(" S8000 M3", ""), warning="spindle off"),
    Case("a published force coefficient", SLOT, law(600.46)),
    Case("a slot below the limit depth of the tool", SLOT, (MODE.format(3.7),)),
    Case("a narrow cut below the limit depth of the tool",
         SLOT.replace("Y0", "Y-23.95"), (MODE.format(3.7), "stock.grid_step_um=20")),
    Case("inches", SLOT.replace("G21", "G20").replace("X-14", "X-0.55").replace("X26 F4000", "X1 F157")
         .replace("Z-0.5", "Z-0.02").replace("Z5", "Z0.2").replace("Z2", "Z0.08")),
    Case("flutes, chip and speed just within the cutter's data", SLOT,
         ("tool.flute_length_mm=0.51", "tool.max_feed_per_tooth_mm=0.126", "tool.max_cutting_speed_m_per_min=503")),
)  # fmt: skip

CASES = (*DANGEROUS, *SOUND)


def answer(case: Case, directory) -> Checked | MillingError:
    """The findings of the case, or the error that refuses it."""
    try:
        cell = small_part(directory, case.program, *COARSE, *case.settings)
        if case.suffix != ".nc":
            path = pathlib.Path(directory, f"part{case.suffix}")
            path.write_text(case.program)
            cell = cell.replace(path=cell.path.replace(file=str(path)))
        return check(cell)
    except MillingError as error:
        return error


def answer_of(result: Checked | MillingError) -> str:
    """One of the words "released", "stopped" and "refused"."""
    if isinstance(result, MillingError):
        return "refused"
    return "released" if result.may_be_run else "stopped"


def main() -> None:
    print("| case | must be | 0.2.0 | now | findings |\n|---|---|---|---|---|")
    for case in CASES:
        with tempfile.TemporaryDirectory() as directory:
            result = answer(case, directory)
        findings = [] if isinstance(result, MillingError) else [f.what for f in result.findings if f.severity != "note"]
        wanted = "stopped" if case.stop else "released"
        print(f"| {case.name} | {wanted} | {case.before} | {answer_of(result)} | {', '.join(findings)} |", flush=True)


if __name__ == "__main__":
    main()
