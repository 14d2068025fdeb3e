"""A plan of load tests for those who make them: a table to fill in, and a KRL program that drives there."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from kr270_milling.identification.candidates import LOADS, Candidates
from kr270_milling.identification.measurements import write_measurements
from kr270_milling.programs.krl import EXTERNAL, HEAD

__all__ = ["blind_spots", "in_order", "krl_lines", "load_text", "write_plan"]

MODULE = "LOADTEST"
SPEED = 10  #: [%] of the axis speeds
BLIND = 0.5  #: relative standard deviation from which a compliance is as good as unknown


def blind_spots(relative: np.ndarray) -> list[str]:
    """What the tests of a plan cannot tell, from the standard deviations of the factors, (6,), in words."""
    lost = [f"joint {j}" for j in np.flatnonzero(relative > BLIND) + 1]
    if not lost:
        return []
    cure = "a horizontal pull turns joint 1, a --point off axis 6 joint 6, and more tests tell what matters less there"
    return [f"{', '.join(lost)}: these tests tell next to nothing of it; {cure}"]


def in_order(plan: Candidates) -> Candidates:
    """One kind of load after the other, in each the nearest posture next: loads are changed seldom, ways are short."""
    order: list[int] = []
    for kind in np.unique(plan.kind):
        left = np.flatnonzero(plan.kind == kind).tolist()
        here = plan.tests.q[order[-1]] if order else plan.tests.q[left].mean(0)
        while left:
            nearest = min(left, key=lambda row: float(np.abs(plan.tests.q[row] - here).max()))
            left.remove(nearest)
            order.append(nearest)
            here = plan.tests.q[nearest]
    return plan.take(np.array(order))


def load_text(plan: Candidates, row: int) -> str:
    """What is to be done, for people."""
    x, y, z = plan.tests.wrench[row, :3].tolist()
    size = f"{np.linalg.norm([x, y, z]):.0f} N"
    if plan.kind[row] == 0:
        return f"{LOADS[0]} {size}"
    return f"{LOADS[int(plan.kind[row])]} {size} toward {np.degrees(np.arctan2(y, x)):.1f} deg"


def krl_lines(plan: Candidates, notes: list[str]) -> tuple[list[str], list[str]]:
    """Lines of the .src and the .dat file: at each posture it halts twice, without and with the load."""
    head = [
        *(f"; {note}" for note in notes),
        "; VERIFY IN T1: THE WAYS ARE NOT CHECKED FOR COLLISION",
    ]
    src = [*HEAD, f"DEF {MODULE}( )", *head, "BAS(#INITMOV,0)", f"BAS(#VEL_PTP,{SPEED})"]
    for row, q in enumerate(np.degrees(plan.tests.q).tolist()):
        axes = ",".join(f"A{i} {angle:.4f}" for i, angle in enumerate(q, 1))
        src += [f"; test {row + 1}: {load_text(plan, row)}", f"PTP {{{axes}}}"]
        src += ["HALT ; measure the reflector without the load", "HALT ; put the load on, measure, take it off"]
    return [*src, "END"], [*HEAD, f"DEFDAT {MODULE}", *head, *EXTERNAL, "ENDDAT"]


def write_plan(directory, plan: Candidates, notes: list[str]) -> list[Path]:
    """plan.csv, as ``identify compliance`` reads it when the last columns are filled in, and the program."""
    place = Path(directory)
    files = [place / "plan.csv", place / f"{MODULE}.src", place / f"{MODULE}.dat"]
    remarks = [f"test {row + 1}: {load_text(plan, row)}" for row in range(len(plan.tests))]
    write_measurements(files[0], plan.tests, notes, remarks)
    for path, lines in zip(files[1:], krl_lines(plan, notes), strict=True):
        path.write_bytes("".join(f"{line}\r\n" for line in lines).encode("ascii", "replace"))
    return files
