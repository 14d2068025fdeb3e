"""Robot programs for a KR C4: the original and the compensated trajectory side by side, with the same points.

NAME_ORG and NAME_CMP are a main module each (.src, .dat), which calls NAME_ORG_001, ... when the points exceed the line
limit. XP of a comment is the number of the next point: XPk is knot k-1 of both trajectories. SPLINE: SPL segments with
their speed, one block from stop to stop; between the points the motion is that of ``path.controller_motion``. LIN:
straight lines and arcs (CIRC), blended by C_DIS except where the tool stops. The robot also stops where one module ends
and the next begins, so modules end at stops where they can. A dwell is not written: the speed of the next move covers
its time.

The main module goes from home to the safe height above the first point, down to it, along the path, up and home; the
spindle's and the coolant's own commands come from ``program``. Programs of more bytes than ``program.memory`` are parts
that do so one after the other, each in its folder: P1 has NAME_ORG_P1, which goes from the first point of the part to
its last. A part ends where the tool stops above the stock. NAME_ORG then calls the parts.
"""

from __future__ import annotations

import functools
import hashlib
import math
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import jinja2
import numpy as np

from kr270_milling.base.files import write_files
from kr270_milling.base.frames import Pose, lifted, rotation_from_quaternion, tool_axis
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
    parts_of,
    point_comments,
    point_speeds,
    position_text,
)
from kr270_milling.decide.programs.points import fixed_knots, program_points
from kr270_milling.path.trajectory import Trajectory, TrajectoryError

KINDS = {"ORG": "original trajectory", "CMP": "compensated trajectory"}
HEAD = ("&ACCESS RVP", "&REL 1", "&PARAM EDITMASK = *")
EXTERNAL = (";FOLD EXTERNAL DECLARATIONS", "EXT BAS (BAS_COMMAND :IN,REAL :IN)", ";ENDFOLD")


@dataclass(frozen=True, eq=False)
class Setup:
    """What a program needs beside the points; the date is a text, so that the same input gives the same files."""

    tool: Pose  #: tcp in $FLANGE, whose z points out of the flange ($TOOL)
    base: Pose  #: the workpiece frame on $ROBROOT ($BASE)
    #: E6POS to which a PTP from home leads, at the safe height above a knot of a trajectory: position in $BASE [m],
    #: (3,), S and T
    approach: Callable[[Trajectory, int], tuple[np.ndarray, int, int]]
    top: float  #: [m], top of the stock in the workpiece frame
    load_mass: float = 0.0  #: [kg], spindle and tool
    load_centre: tuple[float, float, float] = (0.0, 0.0, 0.0)  #: [m], in $FLANGE
    spindle: str = ""  #: its speed and rotation in words, for an operator who starts it
    acceleration: float = 0.0  #: acceleration of the time law [m/s2]; 0: the times of the points come from elsewhere
    jerk: float = 0.0  #: jerk of the time law [m/s3]
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


@functools.lru_cache(maxsize=2)  # both programs state it, of parts each module
def trajectory_hash(trajectory: Trajectory) -> str:
    """SHA-256 over the numbers of a trajectory."""
    digest = hashlib.sha256(trajectory.frame.encode())
    for array in (trajectory.time_ns, trajectory.position, trajectory.quaternion, trajectory.velocity):
        digest.update(b"-" if array is None else np.ascontiguousarray(array, array.dtype.newbyteorder("<")).data)
    return digest.hexdigest()


def write_krl(directory, *contents, **more) -> tuple[list[Path], np.ndarray, list[tuple[int, int]]]:
    """Write the files of ``program_files``, or none; return the paths, the knots that are points, and the parts."""
    files, (points, *_), ends = program_files(*contents, **more)
    paths = {Path(directory, name): lines for name, lines in files.items()}
    write_files({path: (line + "\n" for line in lines) for path, lines in paths.items()}, newline="\r\n")
    return list(paths), points, ends


def program_files(
    program: Program,
    setup: Setup,
    original: Trajectory,
    revised: Trajectory,
    notes: tuple[np.ndarray, np.ndarray] | None = None,
    feeds: np.ndarray | None = None,
) -> tuple[dict[str, list[str]], tuple[np.ndarray, np.ndarray, np.ndarray], list[tuple[int, int]]]:
    """Return the lines of all modules of both programs by name, the layout, and the parts: first and last knot of each.

    Layout: the knots that are points (p,), the auxiliary ones among them (p,), and the knots of stops (n,).
    notes: of ``notes_of``; feeds: of ``fixed_knots``; None: not known. Raises TrajectoryError for trajectories of
    different knots, and for more points than the modules or the memory can hold.
    """
    if not np.array_equal(original.time_ns, revised.time_ns) or original.frame != revised.frame:
        raise TrajectoryError("the original and the revised trajectory must share their knots and frame")
    runs = {"ORG": original, "CMP": revised}
    fixed, stops = fixed_knots(original.standing, feeds), original.standing.copy()
    frame_lines = 25  # of a module beside template and motions: heading, first and last lines
    most = program.line_limit - frame_lines - sum(map(len, _head_and_foot(program, setup, "XP1")))
    if most < 20:
        raise TrajectoryError(f"program.line_limit of {program.line_limit} lines has no room beside the heading")
    fitting: float = math.inf
    parts: list[tuple[int, int]] = []
    known: np.ndarray | None = None
    while True:
        if not parts:
            points, auxiliary = program_points(program, original, revised, fixed | stops, stops, known)
            known = points
            comments, rests = point_comments(points, notes, auxiliary), stops[points]
            above = np.all([run.position[points, 2] >= setup.top for run in runs.values()], axis=0)
            parts = parts_of(len(points), original.standing[points] & above, fitting)
        modules = [modules_of(program, part, rests, auxiliary, comments, most) for part in parts]
        inner = points[[end - 1 for own in modules for _, end in own][:-1]]
        if program.motion == "SPLINE" and not stops[inner].all():
            stops[inner], parts = True, []  # the spline of a module ends at its last point
            continue
        if sum(map(len, modules)) > 999:
            raise TrajectoryError(f"{len(points)} points need more than 999 modules of {program.line_limit} lines")
        ends = [(int(points[start - 1]), int(points[end - 1])) for start, end in parts]
        files: dict[str, list[str]] = {}
        size = 0
        moves: list[list[list[str]]] = []
        for kind, run in runs.items():
            if run is not original or not moves:  # where nothing is revised, both programs have the same motions
                rows, speed = _rows(run, points), point_speeds(program, run, points, auxiliary, feeds)
                of_points = rows, speed, rests, auxiliary
                moves = [
                    [motion_lines(program, comments[a:b], *(row[a:b] for row in of_points)) for a, b in own]
                    for own in modules
                ]
            for part in _sources(program, setup, kind, run, moves, ends):
                size = max(size, sum(len(line) + 2 for lines in part.values() for line in lines))
                files |= part
        if size <= program.memory:
            break
        fitting = int(0.95 * program.memory / size * max(end - start for start, end in parts))
        parts = parts_of(len(points), original.standing[points] & above, fitting)
    return files, (points, auxiliary, stops), ends


def _sources(
    program: Program, setup: Setup, kind: str, run: Trajectory, moves: list[list[list[str]]], ends: list
) -> Iterator[dict[str, list[str]]]:
    """Name of a file -> its lines, for each part of a program; moves: lines of each module of each part."""
    name, heading, number = f"{program.name}_{kind}", setup.heading(program, kind, run), 0

    def source(module: str, lines: list[str]) -> dict[str, list[str]]:
        return {f"{module}.src": [*HEAD, f"DEF {Path(module).name}( )", *heading, *lines, "END"]}

    for n, (own, (first, last)) in enumerate(zip(moves, ends, strict=True), 1):
        folder, main = ("", name) if len(moves) == 1 else (f"P{n}/", f"{name}_P{n}")
        lines = own[0]
        files: dict[str, list[str]] = {}
        if len(own) > 1:
            names = [f"{name}_{number + k:03d}" for k in range(1, len(own) + 1)]
            lines, number = [f"{module}( )" for module in names], number + len(own)
            for module, module_lines in zip(names, own, strict=True):
                files |= source(folder + module, module_lines)
        head, foot = _head_and_foot(program, setup, f"XP{first + 1}")
        data = [*HEAD, f"DEFDAT {main}", *heading, *EXTERNAL, *_places(program, setup, run, first, last), "ENDDAT"]
        yield source(folder + main, [*head, *lines, *foot]) | {f"{folder}{main}.dat": data} | files
    if len(moves) > 1:
        yield source(name, [f"{name}_P{n}( )" for n in range(1, len(moves) + 1)])


def _rows(run: Trajectory, knots: Sequence[int] | np.ndarray) -> np.ndarray:
    """X, Y, Z [mm], A, B, C [deg] of p knots, (p, 6)."""
    return frame_row(Pose(run.position[knots], rotation_from_quaternion(run.quaternion[knots])))


def _places(program: Program, setup: Setup, run: Trajectory, first: int, last: int) -> list[str]:
    """Home, approach, first point and retract of a part of a trajectory from one knot to another."""
    start, retract = _rows(run, [first, last])
    axis = tool_axis(run.quaternion[last])
    retract[:3] = 1e3 * lifted(run.position[last], axis, setup.top + program.safe_height)
    position, status, turn = setup.approach(run, first)
    above = [*(1e3 * position), *start[3:]]
    home = [f"DECL E6AXIS {program.home}={{{axis_text(np.degrees(program.home_angles), setup.external)}}}"]
    return [
        *(home if program.home_angles.size else []),
        f"DECL E6POS XAPPROACH={{{position_text(above, status, turn, setup.external)}}}",
        f"DECL FRAME XP{first + 1}={{{frame_text(start)}}}",
        f"DECL FRAME XRETRACT={{{frame_text(retract)}}}",
    ]


def _head_and_foot(program: Program, setup: Setup, start: str) -> list[list[str]]:
    """Everything before the first motion along the path, which begins at ``start``, and after the last motion."""
    x, y, z = (number(1e3 * v, 3) for v in setup.load_centre)
    text = filled(
        "main.txt",
        program=program,
        number=number,
        load=f"$LOAD={{M {number(setup.load_mass, 3)},CM {{X {x},Y {y},Z {z},A 0.0,B 0.0,C 0.0}}}}",
        tool=f"{{{frame_text(frame_row(setup.tool))}}}",
        base=f"{{{frame_text(frame_row(setup.base))}}}",
        spindle=setup.spindle,
        start=start,
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


@functools.cache
def _template(name: str) -> jinja2.Template:
    text = Path(__file__).with_name(name).read_text(encoding="utf-8")
    return jinja2.Template(
        text, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True
    )


def filled(template: str, **values) -> str:
    """The text of a template of this folder."""
    return _template(template).render(**values)
