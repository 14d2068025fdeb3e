"""Motions of a robot program: which knots become points, how they are split into modules, how fast each is reached.

Numbers, frames and comments are written as a KR C4 reads them.
"""

from __future__ import annotations

import re
import textwrap
import unicodedata
from collections import Counter
from collections.abc import Callable, Iterable, Sequence

import numpy as np

from kr270_milling.base.frames import Pose, abc_from_rotation
from kr270_milling.cell.sections import Program
from kr270_milling.path.trajectory import Trajectory, TrajectoryError

__all__ = [
    "WIDEST",
    "axis_text",
    "comments",
    "frame_row",
    "frame_text",
    "knot_notes",
    "modules_of",
    "motion_lines",
    "number",
    "point_speeds",
    "position_text",
    "printable_ascii",
    "shortest",
]

WIDEST = 100  #: characters of a comment line


def number(value: float, digits: int) -> str:
    """With so many decimals, and no minus before a zero."""
    text = f"{value:.{digits}f}"
    return text.removeprefix("-") if not text.strip("-0.") else text


def shortest(value: float, digits: int) -> str:
    """As ``number``, without zeros at the end."""
    text = number(value, digits)
    return text.rstrip("0").rstrip(".") if "." in text else text


def frame_row(pose: Pose) -> np.ndarray:
    """X, Y, Z [mm], A, B, C [deg], (..., 6)."""
    return np.concatenate([pose.position * 1e3, np.degrees(abc_from_rotation(pose.rotation))], axis=-1)


def frame_text(row: Sequence[float] | np.ndarray, text: Callable[[float, int], str] = number) -> str:
    """X, Y, Z [mm] to 0.1 um, A, B, C [deg] to 1e-5; text: ``number`` or ``shortest``."""
    texts = [text(v, 4 if i < 3 else 5) for i, v in enumerate(row)]
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


def knot_notes(lines: Sequence[int] | np.ndarray, features: Sequence[str]) -> list[str]:
    """Return line and feature of each knot as a comment, (n,); empty for line 0."""
    names = {feature: printable_ascii(feature)[:WIDEST] for feature in set(features)}
    named = {feature: f" ({name})" if name else "" for feature, name in names.items()}
    return [f"; line {n}{named[feature]}" if n else "" for n, feature in zip(lines, features, strict=True)]


def _note(notes: Sequence[str], k: int, before: int) -> list[str]:
    """The comment before point k, where it is not that of the point before."""
    return [notes[k]] if notes[k] and notes[k] != notes[before] else []


def modules_of(program: Program, points: np.ndarray, stops: np.ndarray, notes: Sequence[str], most: int) -> list:
    """Ranges of points after the first, [from, to), one for each module of ``most`` lines; they end at stops if near.

    Raises TrajectoryError for more points than the modules of a main module can hold.
    """
    pieces, start, lines = [], 1, 0
    for i in range(1, len(points)):
        stop = bool(stops[points[i]])
        lines += 2 if program.motion == "LIN" else 1 + 2 * stop
        lines += len(_note(notes, points[i], points[i - 1]))
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


def motion_lines(
    program: Program, points: np.ndarray, piece, speed, stops, notes: Sequence[str], digits: int = 3
) -> list[str]:
    """SPLINE blocks from stop to stop, or LIN motions blended by C_DIS, over the points of one module."""
    lines: list[str] = []
    feeds = [f"$VEL.CP={shortest(value, digits)}" for value in speed[slice(*piece)]]
    rests = stops[points[slice(*piece)]].copy()
    rests[-1] = True
    begin, usual = 0, ""
    for i, (feed, rest) in enumerate(zip(feeds, rests, strict=True)):
        k = int(points[piece[0] + i])
        comment = _note(notes, k, points[piece[0] + i - 1])
        if program.motion == "LIN":
            blend = "" if rest or not program.blend_distance else " C_DIS"
            lines += [*comment, *[feed] * (feed != usual), f"LIN XP{k + 1}{blend}"]
            usual = feed
            continue
        if i == begin:  # of a block, whose segments have its usual speed where they state none
            usual = Counter(feeds[i : i + int(np.argmax(rests[i:])) + 1]).most_common(1)[0][0]
            lines.append(f"SPLINE WITH {usual}")
        lines += [*comment, f"SPL XP{k + 1}" + f" WITH {feed}" * (feed != usual), *["ENDSPLINE"] * bool(rest)]
        begin = i + 1 if rest else begin
    return lines


def point_speeds(program: Program, run: Trajectory, points: np.ndarray, feeds: np.ndarray | None = None) -> np.ndarray:
    """Largest speed [m/s], (p,), on the way to each point, of the mean speeds between knots; 0 for the first.

    The controller plans its own ramps up to that speed. feeds: of ``fixed_knots``; where the feed changes on the way,
    the lower one holds.
    """
    step = np.diff(run.time_ns)
    if program.motion == "LIN" or run.velocity is None:
        length = np.linalg.norm(np.diff(run.position, axis=0), axis=1)
    else:
        places = run.time_ns[:-1, None] + np.rint((1 + GAUSS[0]) / 2 * step[:, None]).astype(np.int64)
        length = run.feed(places) @ (GAUSS[1] / 2) * step * 1e-9
    fastest = np.maximum.reduceat(length / (1e-9 * step), points[:-1])
    if feeds is not None:
        change = feeds[1:] != feeds[:-1]
        lower = np.where(change, np.fmin(feeds[1:], feeds[:-1]), np.inf)
        lower[np.isnan(feeds[1:] + feeds[:-1])] = np.inf
        fastest = np.minimum(fastest, np.minimum.reduceat(lower, points[:-1]))
    slowest = 1e-3  # [m/s], the step of the speeds that are written
    return np.concatenate([[0.0], np.maximum(fastest, slowest)])
