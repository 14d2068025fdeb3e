"""Robot programs for a KR C4: the original and the compensated trajectory side by side, with the same point numbers.

NAME_ORG and NAME_CMP are a main module each (.src, .dat), which calls NAME_ORG_001, ... when the points exceed the line
limit. Point k is knot k-1 of both trajectories. SPLINE: SPL segments with their speed, one block from stop to stop;
the controller's own spline runs through the points and may differ from the trajectory between them. LIN: straight
lines, blended by C_DIS except where the tool stops. The robot also stops where one module ends and the next begins,
so modules end at stops where they can. A dwell is not written: the speed of the next move covers its time.
"""

from __future__ import annotations

import hashlib
import math
import re
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kr270_milling.base.frames import Pose, abc_from_rotation, rotation_from_quaternion
from kr270_milling.cell.program import Program
from kr270_milling.trajectory.files import write_files
from kr270_milling.trajectory.trajectory import Trajectory, TrajectoryError

__all__ = ["Cell", "write_krl", "trajectory_hash", "turn_bits", "status_bits"]

KINDS = {"ORG": "original trajectory", "CMP": "compensated trajectory"}
HEAD = ("&ACCESS RVP", "&REL 1", "&PARAM EDITMASK = *")
EXTERNAL = (";FOLD EXTERNAL DECLARATIONS", "EXT BAS (BAS_COMMAND :IN,REAL :IN)", ";ENDFOLD")
WIDEST = 100  #: characters of a comment line
RESERVED = 30  #: lines kept free for head and foot of a module
GAUSS = np.polynomial.legendre.leggauss(4)


@dataclass(frozen=True, eq=False)
class Cell:
    """What the controller must know of the cell beside the points."""

    tool: Pose  #: tool0 in $FLANGE, whose z points out of the flange ($TOOL)
    base: Pose  #: the workpiece frame on $ROBROOT ($BASE)
    status: int  #: S of the first point
    turn: int  #: T of the first point
    load_mass: float = 0.0  #: [kg], spindle and tool, for a comment
    load_centre: tuple[float, float, float] = (0.0, 0.0, 0.0)  #: [m], in $FLANGE
    revised_status: int | None = None  #: of the compensated program, where its first point differs in that
    revised_turn: int | None = None


def turn_bits(joints) -> int:
    """KUKA's T: bit i is 1 where joint i+1 [rad], (6,), is negative."""
    return sum(1 << i for i, angle in enumerate(np.asarray(joints, float).tolist()) if angle < 0)


def status_bits(joints, a1: float, a2: float, a3: float, d4: float) -> int:
    """KUKA's S of joint positions [rad], (6,), for the arm lengths [m] of the chain in use here.

    Bit 0: the wrist centre is behind axis 1; bit 1: the elbow is bent upwards (A3 above the stretched arm); bit 2: A5
    is negative (from -180 to 0 deg, or from 180 deg up).
    """
    _, q2, q3, _, q5, _ = np.asarray(joints, float).tolist()
    wrist = a1 + a2 * np.cos(q2) + d4 * np.cos(q2 + q3) + a3 * np.sin(q2 + q3)
    bent = q3 >= np.arctan2(a3, d4)
    flipped = -np.pi <= q5 < 0 or q5 >= np.pi
    return int(wrist < 0) + 2 * int(bent) + 4 * int(flipped)


def trajectory_hash(trajectory: Trajectory) -> str:
    """SHA-256 over the numbers of a trajectory."""
    digest = hashlib.sha256(trajectory.frame.encode())
    for array in (trajectory.time_ns, trajectory.position, trajectory.quaternion, trajectory.velocity):
        digest.update(b"-" if array is None else np.ascontiguousarray(array).astype(array.dtype.newbyteorder("<")))
    return digest.hexdigest()


def write_krl(
    directory, program: Program, cell: Cell, original: Trajectory, revised: Trajectory, version: str, date: str,
    source_hash: str = "", findings: Sequence[str] = (),
) -> list[Path]:  # fmt: skip
    """Write all modules of both programs, or none; returns their paths.

    version, date (as text, so that the same input gives the same files) and source_hash (of the recording or the tool
    path) stand in the header of each file, and so do the findings of the check.
    """
    if not np.array_equal(original.time_ns, revised.time_ns) or original.frame != revised.frame:
        raise TrajectoryError("the original and the revised trajectory must share their knots and frame")
    for text in (version, date, source_hash):
        if not re.fullmatch(r"[ -~]{0,100}", text):
            raise TrajectoryError(f"{text[:100]!r} cannot stand in the header of a program")
    points = _kept(program, original, revised)
    pieces = _pieces(program, points, _stops(original))
    files: dict[Path, list[str]] = {}
    for kind, run in (("ORG", original), ("CMP", revised)):
        modules = _modules(program, cell, kind, run, points, pieces)
        note = [f"; {KINDS[kind]}, points 1 to {len(run)}, {program.motion}",
                "; SIMULATION RESULT: VERIFY IN T1 WITH REDUCED OVERRIDE BEFORE MILLING",
                f"; kr270_milling {version}, {date}", f"; sha256 of this trajectory {trajectory_hash(run)}",
                f"; sha256 of its source {source_hash or 'not given'}"]  # fmt: skip
        note += [f"; {line}" for text in findings for line in textwrap.wrap(_ascii(text), WIDEST)]
        for name, (src, dat) in modules.items():
            files[Path(directory) / f"{name}.src"] = [*HEAD, f"DEF {name}( )", *note, *src, "END"]
            files[Path(directory) / f"{name}.dat"] = [*HEAD, f"DEFDAT {name}", *note, *EXTERNAL, *dat, "ENDDAT"]
    write_files({path: (line + "\n" for line in lines) for path, lines in files.items()}, newline="\r\n")
    return list(files)


def _ascii(text: str) -> str:
    """What a controller's editor shows of a text."""
    return text.encode("ascii", "replace").decode()


def _kept(program: Program, original: Trajectory, revised: Trajectory) -> np.ndarray:
    """Knots that become points, (p,): far enough from the one before in both; the first, the stops and the last."""
    stops, spacing = _stops(original), program.point_spacing
    rows = np.stack([original.position, revised.position], axis=1).tolist()
    last, kept = len(rows) - 1, [0]

    def near(k: int) -> bool:
        return any(math.dist(new, old) < spacing for new, old in zip(rows[k], rows[kept[-1]], strict=True))

    for k in range(1, last + 1):
        if stops[k] or k == last:  # a corner must not move to the knot before it
            while len(kept) > 1 and near(k):
                kept.pop()
            if k == last or not near(k):
                kept.append(k)
        elif not near(k):
            kept.append(k)
    return np.array(kept)


def _stops(run: Trajectory) -> np.ndarray:
    """(n,) True where the tool stands still at a knot."""
    return np.zeros(len(run), bool) if run.velocity is None else ~run.velocity.any(axis=1)


def _pieces(program: Program, points: np.ndarray, stops: np.ndarray) -> list[tuple[int, int]]:
    """Ranges of points after the first, [from, to), one for each module; they end at a stop if one is near."""
    most = program.line_limit - RESERVED
    pieces, start, lines = [], 1, 0
    for i in range(1, len(points)):
        stop = bool(stops[points[i]])
        lines += 2 if program.motion == "LIN" else 1 + 2 * stop
        if lines > most - 4 or (stop and lines > 0.75 * most):
            pieces.append((start, i + 1))
            start, lines = i + 1, 0
    if start < len(points):
        pieces.append((start, len(points)))
    if len(pieces) > 999:
        raise TrajectoryError(f"{len(points)} points need more than 999 modules of {program.line_limit} lines")
    if len(pieces) > 1 and len(pieces) + RESERVED > program.line_limit:
        reason = f"{len(points)} points need {len(pieces)} modules, more than a main module of"
        raise TrajectoryError(f"{reason} {program.line_limit} lines can call; raise program.line_limit")
    return pieces


def _modules(program: Program, cell: Cell, kind: str, run: Trajectory, points: np.ndarray, pieces) -> dict:
    """Name -> lines of .src and of .dat."""
    main = f"{program.name}_{kind}"
    abc = np.degrees(abc_from_rotation(rotation_from_quaternion(run.quaternion)))
    rows = np.hstack([run.position * 1e3, abc]) + 0.0
    speed, stops = _speeds(program, run, points), _stops(run)
    status, turn = cell.status, cell.turn
    if kind == "CMP":  # an axis that starts at zero may be negative in one program only
        status = status if cell.revised_status is None else cell.revised_status
        turn = turn if cell.revised_turn is None else cell.revised_turn
    first = f"DECL E6POS XP1={{{_frame(rows[0])},S {status},T {turn},{_external()}}}"
    src, dat, modules = _preamble(program, cell), [first], {}
    for number, (start, stop) in enumerate(pieces, 1):
        numbers = points[start:stop]
        moves = _moves(program, numbers, speed[start:stop], stops[numbers])
        frames = [f"DECL FRAME XP{k + 1}={{{_frame(rows[k])}}}" for k in numbers.tolist()]
        if len(pieces) == 1:
            src, dat = src + moves, dat + frames
        else:
            name = f"{main}_{number:03d}"
            src = [*src, f"{name}( )"]
            modules[name] = (moves, frames)
    return {main: (src, dat)} | modules


def _preamble(program: Program, cell: Cell) -> list[str]:
    x, y, z = (1e3 * v for v in cell.load_centre)
    return [
        f"; set on the controller: $LOAD={{M {cell.load_mass:.3f},CM {{X {x:.3f},Y {y:.3f},Z {z:.3f},"
        "A 0.0,B 0.0,C 0.0}}",
        "; $BASE is that of a robot whose $ROBROOT is zero in $WORLD; on a pedestal or a rail set it by hand",
        "BAS(#INITMOV,0)",
        f"$TOOL={{{_frame(_row(cell.tool))}}}",
        f"$BASE={{{_frame(_row(cell.base))}}}",
        "$IPO_MODE=#BASE",
        "$ORI_TYPE=#VAR",
        "$ADVANCE=3",
        f"$APO.CDIS={1e3 * program.blend_distance:.4f}",
        f"BAS(#VEL_PTP,{program.approach_speed_percent})",
        "PTP XP1",
    ]


def _moves(program: Program, numbers: np.ndarray, speed: np.ndarray, stops: np.ndarray) -> list[str]:
    lines: list[str] = []
    last = len(numbers) - 1
    for i, (k, v, stop) in enumerate(zip(numbers.tolist(), speed.tolist(), stops.tolist(), strict=True)):
        ends = stop or i == last
        if program.motion == "LIN":
            lines += [f"$VEL.CP={v:.9f}", f"LIN XP{k + 1}" + ("" if ends or not program.blend_distance else " C_DIS")]
            continue
        if i == 0 or stops[i - 1]:
            lines.append("SPLINE")
        lines.append(f"SPL XP{k + 1} WITH $VEL.CP={v:.9f}")
        if ends:
            lines.append("ENDSPLINE")
    return lines


def _speeds(program: Program, run: Trajectory, points: np.ndarray) -> np.ndarray:
    """Mean speed [m/s], (p,), along the motion that leads to each point; 0 for the first."""
    step = np.diff(run.time_ns)
    if program.motion == "LIN" or run.velocity is None:
        position = run.position[points]
        length = np.linalg.norm(np.diff(position, axis=0), axis=1)
    else:
        places = run.time_ns[:-1, None] + np.rint((1 + GAUSS[0]) / 2 * step[:, None]).astype(np.int64)
        way = np.concatenate([[0.0], np.cumsum(run.feed(places) @ (GAUSS[1] / 2) * step * 1e-9)])
        length = np.diff(way[points])
    return np.concatenate([[0.0], np.maximum(length / np.diff(run.time[points]), 1e-6)])


def _row(pose: Pose) -> np.ndarray:
    return np.concatenate([pose.position * 1e3, np.degrees(abc_from_rotation(pose.rotation))]) + 0.0


def _frame(row: np.ndarray) -> str:
    """X, Y, Z [mm] to 0.1 um, A, B, C [deg] to 1e-5."""
    x, y, z, a, b, c = row.tolist()
    return f"X {x:.4f},Y {y:.4f},Z {z:.4f},A {a:.5f},B {b:.5f},C {c:.5f}"


def _external() -> str:
    return ",".join(f"E{i} 0.0" for i in range(1, 7))
