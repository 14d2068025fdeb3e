"""A plan of load tests as sentences, JSON, tables, measurement table and KRL program."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from kr270_milling.base.column import TextTable
from kr270_milling.decide.programs.krl import EXTERNAL, HEAD
from kr270_milling.show.report.identification.compliance import BASE_Z
from kr270_milling.studies.identification.measurements import write_measurements
from kr270_milling.studies.identification.plan import Candidates, Design

__all__ = ["blind_spots", "load_text", "plan_as_dict", "plan_tables", "write_plan"]

LOADS = ("hang", "pull outward", "pull sideways", "pull between both")  #: kind of a candidate -> text
MODULE = "LOADTEST"
JOINTS = 6  #: further sought numbers are those of the base
SPEED = 10  #: [%] of the axis speeds


def plan_as_dict(plan: Candidates, designs: Mapping[str, Design], chosen: Design, names: Sequence[str]) -> dict:
    """Return a plan for JSON; designs: by name, for comparison; chosen: the design of the plan; names: of the sought
    numbers, (p,)."""
    return {
        "blind_spots": blind_spots(chosen.relative, names),
        "sought": list(names),
        "designs": [
            {
                "name": name,
                "error_um": 1e6 * d.pose_error,
                "relative": d.relative.tolist(),
                "determinant": d.determinant,
            }
            for name, d in designs.items()
        ],
        "tests": [
            {"joints_deg": np.degrees(q).tolist(), "wrench": w.tolist(), "load": load_text(plan, i)}
            for i, (q, w) in enumerate(zip(plan.tests.q, plan.tests.wrench, strict=True))
        ],
    }


def plan_tables(plan: Candidates, designs: Mapping[str, Design]) -> list[TextTable]:
    """Return the comparison of the designs and of the tests."""
    rows = [
        [name, f"{1e6 * d.pose_error:.3f}", f"{100 * d.relative.max():.1f}", f"{100 * d.determinant:.2f}"]
        for name, d in designs.items()
    ]
    title = f"{len(plan.tests)} load tests: standard deviation of the displacement by 100 N at the cell's posture"
    tests = [[load_text(plan, i), " ".join(f"{a:7.2f}" for a in np.degrees(q))] for i, q in enumerate(plan.tests.q)]
    return [
        TextTable(title, ["choice", "error there [um]", "worst compliance [%]", "mean [%]"], rows),
        TextTable("The tests, in the order of the program", ["load", "A1 to A6 [deg]"], tests),
    ]


def blind_spots(relative: np.ndarray, names: Sequence[str]) -> list[str]:
    """Return sentences about the numbers that a plan cannot identify.

    relative: standard deviations of the factors, (p,); names: of the sought numbers, (p,).
    """
    # relative standard deviation from which a compliance is practically unknown
    unseen = [name for name, deviation in zip(names, relative, strict=True) if deviation > 0.5]
    cure = "a horizontal pull turns joint 1, a --point off axis 6 turns joint 6, more tests help joints of small effect"
    texts = [f"{', '.join(unseen)}: these tests hardly identify the compliance; {cure}"] if unseen else []
    return texts + [BASE_Z] * (len(names) > JOINTS)


def load_text(plan: Candidates, row: int) -> str:
    """Return the instruction for the load of a test."""
    x, y, z = plan.tests.wrench[row, :3].tolist()
    kind = int(plan.kind[row])
    toward = f" toward {np.degrees(np.arctan2(y, x)):.1f} deg" if kind else ""
    return f"{LOADS[kind]} {np.linalg.norm([x, y, z]):.0f} N{toward}"


def write_plan(directory, plan: Candidates, notes: list[str]) -> list[Path]:
    """Write plan.csv, the input of ``identify compliance`` without its results, and a KRL program.

    The program moves to the postures and halts twice at each, without and with the load.
    """
    place = Path(directory)
    head = [*(f"; {note}" for note in notes), "; VERIFY IN T1: THE MOTIONS ARE NOT CHECKED FOR COLLISION"]
    remarks = [f"test {row + 1}: {load_text(plan, row)}" for row in range(len(plan.tests))]
    write_measurements(place / "plan.csv", plan.tests, notes, remarks)
    source = [*HEAD, f"DEF {MODULE}( )", *head, "BAS(#INITMOV,0)", f"BAS(#VEL_PTP,{SPEED})"]
    for remark, q in zip(remarks, np.degrees(plan.tests.q).tolist(), strict=True):
        axes = ",".join(f"A{i} {angle:.4f}" for i, angle in enumerate(q, 1))
        source += [f"; {remark}", f"PTP {{{axes}}}"]
        source += ["HALT ; measure the reflector without the load", "HALT ; put the load on, measure, take it off"]
    program = {".src": [*source, "END"], ".dat": [*HEAD, f"DEFDAT {MODULE}", *head, *EXTERNAL, "ENDDAT"]}
    for suffix, lines in program.items():
        text = "".join(f"{line}\r\n" for line in lines)
        (place / f"{MODULE}{suffix}").write_bytes(text.encode("ascii", "replace"))
    return [place / "plan.csv", *(place / f"{MODULE}{suffix}" for suffix in program)]
