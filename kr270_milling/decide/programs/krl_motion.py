"""Motions of a robot program: which knots become points, how they are split into modules, how fast each is reached.

Numbers, frames and comments are written as a KR C4 reads them.
"""

from __future__ import annotations

import re
import textwrap
import unicodedata
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from kr270_milling.base.frames import Pose, abc_from_rotation
from kr270_milling.cell.sections import Program
from kr270_milling.path.trajectory import Trajectory, TrajectoryError

__all__ = [
    "WIDEST",
    "Source",
    "axis_text",
    "comments",
    "frame_row",
    "frame_text",
    "modules_of",
    "motion_lines",
    "number",
    "point_speeds",
    "position_text",
    "printable_ascii",
]

WIDEST = 100  #: characters of a comment line


def number(value: float, digits: int) -> str:
    """With so many decimals, and no minus before a zero."""
    text = f"{value:.{digits}f}"
    return text.removeprefix("-") if not text.strip("-0.") else text


def frame_row(pose: Pose) -> np.ndarray:
    """X, Y, Z [mm], A, B, C [deg], (..., 6)."""
    return np.concatenate([pose.position * 1e3, np.degrees(abc_from_rotation(pose.rotation))], axis=-1)


def frame_text(row: Sequence[float] | np.ndarray) -> str:
    """X, Y, Z [mm] to 0.1 um, A, B, C [deg] to 1e-5."""
    texts = [number(v, 4 if i < 3 else 5) for i, v in enumerate(row)]
    return ",".join(f"{name} {text}" for name, text in zip("XYZABC", texts, strict=True))


def position_text(row: Sequence[float], status: int, turn: int, external: Sequence[float]) -> str:
    """An E6POS; external: E1 to E6."""
    return f"{frame_text(row)},S {status},T {turn},{_external_text(external)}"


def axis_text(degrees: Sequence[float], external: Sequence[float]) -> str:
    """An E6AXIS; external: E1 to E6."""
    return ",".join(f"A{i} {number(v, 4)}" for i, v in enumerate(degrees, 1)) + f",{_external_text(external)}"


def _external_text(values: Sequence[float]) -> str:
    return ",".join(f"E{i} {float(value)}" for i, value in enumerate(values, 1))


def printable_ascii(text: str) -> str:
    """Return printable ASCII: letters without their accents, ? for all other signs, one space for each white space."""
    letters = (sign for sign in unicodedata.normalize("NFKD", text) if not unicodedata.combining(sign))
    return re.sub(r"[^ -~]+", "", re.sub(r"\s+", " ", "".join(letters)).encode("ascii", "replace").decode())


def comments(texts: Iterable[str]) -> list[str]:
    """Each text as comment lines that a controller's editor shows."""
    return [f"; {line}" for text in texts for line in textwrap.wrap(printable_ascii(text), WIDEST)]


GAUSS = np.polynomial.legendre.leggauss(4)


@dataclass(frozen=True, eq=False)
class Source:
    """Sources of the n knots."""

    line: np.ndarray  #: in the file of the tool path, (n,), 0: none
    feature: tuple[str, ...]  #: feature of the part, (n,), "": none

    def comment(self, k: int, before: int) -> list[str]:
        """The comment before point k, where line or feature are not those of the point before."""
        if (self.line[k], self.feature[k]) == (self.line[before], self.feature[before]) or not self.line[k]:
            return []
        name = printable_ascii(self.feature[k])[:WIDEST]
        return [f"; line {self.line[k]}" + f" ({name})" * bool(name)]


def modules_of(program: Program, points: np.ndarray, stops: np.ndarray, source: Source, most: int) -> list:
    """Ranges of points after the first, [from, to), one for each module of ``most`` lines; they end at stops if near.

    Raises TrajectoryError for more points than the modules of a main module can hold.
    """
    pieces, start, lines = [], 1, 0
    for i in range(1, len(points)):
        stop = bool(stops[points[i]])
        lines += 2 if program.motion == "LIN" else 1 + 2 * stop
        lines += len(source.comment(points[i], points[i - 1]))
        if lines > most - 4 or (stop and lines > 0.75 * most):
            pieces.append((start, i + 1))
            start, lines = i + 1, 0
    if start < len(points):
        pieces.append((start, len(points)))
    if len(pieces) > 999:
        raise TrajectoryError(f"{len(points)} points need more than 999 modules of {program.line_limit} lines")
    if len(pieces) > 1 and len(pieces) > most:
        reason = f"{len(points)} points need {len(pieces)} modules, more than a main module of"
        raise TrajectoryError(f"{reason} {program.line_limit} lines can call; raise program.line_limit")
    return pieces


def motion_lines(program: Program, points: np.ndarray, piece, speed, stops, source: Source) -> list[str]:
    """SPLINE blocks from stop to stop, or LIN motions blended by C_DIS, over the points of one module."""
    lines: list[str] = []
    first, end = piece
    rests = True
    for i in range(first, end):
        k, starts, rests = int(points[i]), rests, bool(stops[points[i]]) or i == end - 1
        feed, comment = f"$VEL.CP={number(speed[i], 3)}", source.comment(k, points[i - 1])
        if program.motion == "LIN":
            blend = "" if rests or not program.blend_distance else " C_DIS"
            lines += [*comment, feed, f"LIN XP{k + 1}{blend}"]
        else:
            lines += [*["SPLINE"] * starts, *comment, f"SPL XP{k + 1} WITH {feed}", *["ENDSPLINE"] * rests]
    return lines


def point_speeds(program: Program, run: Trajectory, points: np.ndarray) -> np.ndarray:
    """Largest speed [m/s], (p,), on the way to each point, of the mean speeds between knots; 0 for the first.

    The controller plans its own ramps up to that speed.
    """
    step = np.diff(run.time_ns)
    if program.motion == "LIN" or run.velocity is None:
        length = np.linalg.norm(np.diff(run.position, axis=0), axis=1)
    else:
        places = run.time_ns[:-1, None] + np.rint((1 + GAUSS[0]) / 2 * step[:, None]).astype(np.int64)
        length = run.feed(places) @ (GAUSS[1] / 2) * step * 1e-9
    fastest = np.maximum.reduceat(length / (1e-9 * step), points[:-1])
    slowest = 1e-3  # [m/s], the step of the speeds that are written
    return np.concatenate([[0.0], np.maximum(fastest, slowest)])
