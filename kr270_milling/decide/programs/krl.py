"""Robot programs for a KR C4: the original and the compensated trajectory side by side, with the same point numbers.

NAME_ORG and NAME_CMP are a main module each (.src, .dat), which calls NAME_ORG_001, ... when the points exceed the line
limit. Point k is knot k-1 of both trajectories. SPLINE: SPL segments with their speed, one block from stop to stop;
between the points the motion is that of ``path.controller_motion``. LIN: straight
lines, blended by C_DIS except where the tool stops. The robot also stops where one module ends and the next begins,
so modules end at stops where they can. A dwell is not written: the speed of the next move covers its time.

The main module goes from home to the safe height above the first point, down to it, along the path, up and home; the
spindle's and the coolant's own commands come from ``program``.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import jinja2
import numpy as np

from kr270_milling.base.files import write_files
from kr270_milling.base.frames import Pose, rotation_from_quaternion
from kr270_milling.base.version import __version__
from kr270_milling.cell.sections import Program
from kr270_milling.decide.programs.krl_motion import (
    axis_text,
    comments,
    frame_row,
    frame_text,
    modules_of,
    motion_lines,
    number,
    point_speeds,
    position_text,
    shortest,
)
from kr270_milling.decide.programs.points import fixed_knots, point_numbers
from kr270_milling.path.trajectory import Trajectory, TrajectoryError

__all__ = ["Setup", "filled", "time_statements", "trajectory_hash", "write_krl"]

KINDS = {"ORG": "original trajectory", "CMP": "compensated trajectory"}
HEAD = ("&ACCESS RVP", "&REL 1", "&PARAM EDITMASK = *")
EXTERNAL = (";FOLD EXTERNAL DECLARATIONS", "EXT BAS (BAS_COMMAND :IN,REAL :IN)", ";ENDFOLD")


@dataclass(frozen=True, eq=False)
class Setup:
    """What a program needs beside the points; the date is a text, so that the same input gives the same files."""

    tool: Pose  #: tcp in $FLANGE, whose z points out of the flange ($TOOL)
    base: Pose  #: the workpiece frame on $ROBROOT ($BASE)
    #: E6POS of the original and of the compensated program to which a PTP from home leads, at the safe height above the
    #: first point: position in $BASE [m], (3,), S and T
    approaches: Sequence[tuple[np.ndarray, int, int]]
    safe_z: float  #: [m], height of the retract in the workpiece frame
    load_mass: float = 0.0  #: [kg], spindle and tool
    load_centre: tuple[float, float, float] = (0.0, 0.0, 0.0)  #: [m], in $FLANGE
    spindle: str = ""  #: its speed and rotation in words, for an operator who starts it
    acceleration: float = 0.0  #: acceleration of the time law [m/s2]; 0: the times of the points come from elsewhere
    jerk: float = 0.0  #: jerk of the time law [m/s3]
    speed_digits: int = 3  #: decimals of the speeds [m/s]
    external: tuple[float, ...] = (0.0,) * 6  #: E1 to E6, as the program of the path has them during its cuts
    date: str = ""
    source_hash: str = ""  #: SHA-256 of the recording or the tool path
    method: str = ""  #: of the compensation
    decision: str = ""  #: its level; the manifest has sentence, findings and time law

    def __post_init__(self):
        for text in (self.date, self.source_hash, self.method, self.decision):
            if not re.fullmatch(r"[ -~]{0,100}", text):
                raise TrajectoryError(f"{text[:100]!r} is not allowed in the header of a program")

    def heading(self, program: Program, kind: str, run: Trajectory) -> list[str]:
        """Return the five comment lines of the header of every file."""
        decision = f"decision {self.decision}: see MANIFEST.txt" if self.decision else "see MANIFEST.txt"
        return comments(
            [
                f"{KINDS[kind]}, points 1 to {len(run)}, {program.motion}"
                + (f", method {self.method}" * (kind == "CMP")),
                "SIMULATION RESULT: VERIFY IN T1 WITH REDUCED OVERRIDE BEFORE MILLING",
                f"kr270_milling {__version__}, {self.date}, {decision}",
                f"sha256 of this trajectory {trajectory_hash(run)}",
                f"sha256 of its source {self.source_hash or 'not given'}",
            ]
        )


def trajectory_hash(trajectory: Trajectory) -> str:
    """SHA-256 over the numbers of a trajectory."""
    digest = hashlib.sha256(trajectory.frame.encode())
    for array in (trajectory.time_ns, trajectory.position, trajectory.quaternion, trajectory.velocity):
        digest.update(b"-" if array is None else np.ascontiguousarray(array, array.dtype.newbyteorder("<")).tobytes())
    return digest.hexdigest()


def write_krl(
    directory,
    program: Program,
    setup: Setup,
    original: Trajectory,
    revised: Trajectory,
    notes: Sequence[str] = (),
    feeds: np.ndarray | None = None,
) -> list[Path]:
    """Write all modules of both programs, or none; returns their paths.

    notes: of ``knot_notes``; feeds: of ``fixed_knots``; None: not known.
    Raises TrajectoryError for trajectories of different knots,
    and for more points than the modules can hold.
    """
    if not np.array_equal(original.time_ns, revised.time_ns) or original.frame != revised.frame:
        raise TrajectoryError("the original and the revised trajectory must share their knots and frame")
    notes = notes or [""] * len(original)
    stops = original.standing
    points = point_numbers(program, original, revised, fixed_knots(stops, feeds))
    heads = {kind: setup.heading(program, kind, run) for kind, run in (("ORG", original), ("CMP", revised))}
    head, foot = _head_and_foot(program, setup)
    frame_lines = 20  # of a module beside heading, templates and motions
    most = program.line_limit - frame_lines - max(map(len, heads.values())) - len(head) - len(foot)
    if most < 20:
        raise TrajectoryError(f"program.line_limit of {program.line_limit} lines has no room beside the heading")
    pieces = modules_of(program, points, stops, notes, most)
    files: dict[Path, list[str]] = {}
    for kind, run in (("ORG", original), ("CMP", revised)):
        speed = point_speeds(program, run, points, feeds)
        moves = [motion_lines(program, points, piece, speed, stops, notes, setup.speed_digits) for piece in pieces]
        frames = [_frames(run, points[slice(*piece)]) for piece in pieces]
        modules = _modules(f"{program.name}_{kind}", moves, frames, [head, foot, _places(program, setup, kind, run)])
        for name, (src, dat) in modules.items():
            files[Path(directory) / f"{name}.src"] = [*HEAD, f"DEF {name}( )", *heads[kind], *src, "END"]
            files[Path(directory) / f"{name}.dat"] = [*HEAD, f"DEFDAT {name}", *heads[kind], *EXTERNAL, *dat, "ENDDAT"]
    write_files({path: (line + "\n" for line in lines) for path, lines in files.items()}, newline="\r\n")
    return list(files)


def _modules(main: str, moves: list, frames: list, main_parts: list) -> dict[str, tuple[list[str], list[str]]]:
    """Name -> lines of .src and of .dat; a single piece is in the main module itself."""
    head, foot, places = main_parts
    if len(moves) == 1:
        return {main: ([*head, *moves[0], *foot], [*places, *frames[0]])}
    names = [f"{main}_{n:03d}" for n in range(1, len(moves) + 1)]
    calls = [f"{name}( )" for name in names]
    return {main: ([*head, *calls, *foot], places)} | dict(zip(names, zip(moves, frames, strict=True), strict=True))


def _rows(run: Trajectory) -> np.ndarray:
    """X, Y, Z [mm], A, B, C [deg] of the knots, (n, 6)."""
    return frame_row(Pose(run.position, rotation_from_quaternion(run.quaternion)))


def _frames(run: Trajectory, numbers: np.ndarray) -> list[str]:
    rows = _rows(run)
    return [f"DECL FRAME XP{k + 1}={{{frame_text(rows[k], shortest)}}}" for k in numbers.tolist()]


def _places(program: Program, setup: Setup, kind: str, run: Trajectory) -> list[str]:
    """Home, approach, first point and retract."""
    first, retract = _rows(run)[[0, -1]]
    retract[2] = max(retract[2], 1e3 * setup.safe_z)
    position, status, turn = setup.approaches[list(KINDS).index(kind)]
    above = [*(1e3 * position), *first[3:]]
    home = [f"DECL E6AXIS {program.home}={{{axis_text(np.degrees(program.home_angles), setup.external)}}}"]
    return [
        *(home if program.home_angles.size else []),
        f"DECL E6POS XAPPROACH={{{position_text(above, status, turn, setup.external)}}}",
        f"DECL FRAME XP1={{{frame_text(first)}}}",
        f"DECL FRAME XRETRACT={{{frame_text(retract)}}}",
    ]


def _head_and_foot(program: Program, setup: Setup) -> list[list[str]]:
    """Everything before the first motion along the path, and everything after the last one."""
    x, y, z = (number(1e3 * v, 3) for v in setup.load_centre)
    text = filled(
        "main.txt",
        program=program,
        number=number,
        load=f"$LOAD={{M {number(setup.load_mass, 3)},CM {{X {x},Y {y},Z {z},A 0.0,B 0.0,C 0.0}}}}",
        tool=f"{{{frame_text(frame_row(setup.tool))}}}",
        base=f"{{{frame_text(frame_row(setup.base))}}}",
        spindle=setup.spindle,
        approach_feed=number(max(program.approach_feed, 1e-3), 3),
        limits=time_statements(program, setup),
    )
    return [part.splitlines() for part in text.split("\u00b6\n")]


def time_statements(program: Program, setup: Setup) -> list[str]:
    """The limits of the controller on which the times of the points rest: m/s2, m/s3 of spline motions, deg/s, deg/s2.

    BAS(#INITMOV,0) sets them to those of the machine data, so that they follow it.
    """
    if program.time_law == "none" or not setup.acceleration:
        return []
    jerk = program.time_law == "jerk" and program.motion == "SPLINE"
    turn, turned = np.degrees([program.turn_speed, program.turn_acceleration])
    values = {"$ACC.CP": setup.acceleration} | ({"$JERK.CP": setup.jerk} if jerk else {})
    values |= {"$VEL.ORI1": turn, "$VEL.ORI2": turn, "$ACC.ORI1": turned, "$ACC.ORI2": turned}
    return [f"{name}={number(value, 4)}" for name, value in values.items()]


def filled(template: str, **values) -> str:
    """The text of a template of this folder."""
    text = Path(__file__).with_name(template).read_text(encoding="utf-8")
    return jinja2.Template(
        text, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True
    ).render(**values)
