"""Motions of a robot program: which knots become points, how they are split into modules, how fast each is reached.

Numbers, frames and comments are written as a KR C4 reads them.
"""

from __future__ import annotations

import math
import re
import textwrap
import unicodedata
from collections import Counter
from collections.abc import Callable, Iterable, Sequence

import numpy as np

from kr270_milling.base.frames import Pose, abc_from_rotation
from kr270_milling.cell.sections import Program
from kr270_milling.path.trajectory import Trajectory, TrajectoryError

WIDEST = 100  #: characters of a comment line


def number(value: float, digits: int) -> str:
    """With so many decimals, and no minus before a zero."""
    text = f"{value:.{digits}f}"
    return text.removeprefix("-") if not text.strip("-0.") else text


def shortest(value: float, digits: int) -> str:
    """As ``number``, without zeros at the end."""
    text = number(value, digits)
    return text.rstrip("0").rstrip(".") if "." in text else text


def speed_text(value: float) -> str:
    """A speed [m/s] to 2 %; with more digits most segments of one feed would state a speed of their own."""
    enough = 0.025  # [m/s], from which on three decimals are
    return shortest(value, 3 + max(0, math.ceil(math.log10(enough / value)))) if value else "0"


def frame_row(pose: Pose) -> np.ndarray:
    """X, Y, Z [mm], A, B, C [deg], (..., 6)."""
    return np.concatenate([pose.position * 1e3, np.degrees(abc_from_rotation(pose.rotation))], axis=-1)


def frame_text(row: Sequence[float] | np.ndarray, text: Callable[[float, int], str] = number) -> str:
    """X, Y, Z [mm] to 0.1 um, A, B, C [deg] to 1e-5 or none; text: ``number`` or ``shortest``."""
    texts = [text(v, 4 if i < 3 else 5) for i, v in enumerate(row)]
    return ",".join(f"{name} {text}" for name, text in zip("XYZABC", texts, strict=False))


def position_text(row: Sequence[float], status: int, turn: int, external: Sequence[float]) -> str:
    """An E6POS; external: E1 to E6."""
    return f"{frame_text(row)},S {status},T {turn},{_external_text(external)}"


def axis_text(degrees: Sequence[float] | np.ndarray, external: Sequence[float]) -> str:
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
TURNED = 5e-5  #: [deg], a change of A, B or C that is written: 0.1 um at 0.1 m from the tip


def point_comments(points: np.ndarray, notes: tuple[np.ndarray, np.ndarray] | None, auxiliary: np.ndarray) -> list[str]:
    """Return the comment before each point, (p,): its number, line and feature; empty for most points.

    notes: lines and names of the features of the knots, (n,) each; None: not known.
    A comment is before the first point of a feature, and at the latest 10 points after a change of the line. The end of
    an arc, which is in the line of its auxiliary point, has none.
    """
    rare, often = 50, 10  # points from one comment to the next
    comments, noted, last = [], (0, ""), 0
    lines, features = (array[points].tolist() for array in notes) if notes else ([0] * len(points), [""] * len(points))
    for i, (k, line, feature) in enumerate(zip(points.tolist(), lines, features, strict=True)):
        other = line != noted[0]
        due = feature != noted[1] or i - last >= (often if other else rare) or (other and last == 0)
        if due and i and not auxiliary[i - 1]:
            text = (
                f"; XP{k + 1}"
                + f" line {line}" * bool(line)
                + f" ({printable_ascii(feature)[:WIDEST]})" * (feature != noted[1])
            )
            noted, last = (line, feature), i
            comments.append(text)
        else:
            comments.append("")
    return comments


def parts_of(count: int, splits: np.ndarray, most: float) -> list[tuple[int, int]]:
    """Ranges of ``count`` points after the first, [from, to), of at most ``most`` points.

    They end at splits, a mask (p,). Raises TrajectoryError where no split is near enough.
    """
    parts, start = [], 1
    while count - start > most:
        ends = start + np.flatnonzero(splits[start : start + int(most)])
        if not ends.size:
            reason = f"{most} points fit, and none of them is a stop above the stock, where a part could end"
            raise TrajectoryError(f"program.memory_mb is too small: {reason}")
        parts.append((start, int(ends[-1]) + 1))
        start = parts[-1][1]
    return [*parts, (start, count)] if start < count else parts


def modules_of(
    program: Program,
    part: tuple[int, int],
    rests: np.ndarray,
    auxiliary: np.ndarray,
    comments: Sequence[str],
    most: int,
) -> list[tuple[int, int]]:
    """Ranges of the points of a part, [from, to), one for each module of ``most`` lines; they end at stops if near.

    rests, auxiliary: masks (p,) of points. Raises TrajectoryError for more points than the modules of a main module can
    hold.
    """
    pieces: list[tuple[int, int]] = []
    cost = np.where(rests, 4, 1) if program.motion == "SPLINE" else np.full(len(rests), 2)
    cost += np.array(list(map(bool, comments)))
    start, last = part
    while start < last:
        lines = np.cumsum(cost[start : min(last, start + most)])
        lines = lines[lines <= most - 4]
        end = start + len(lines)
        free = ~auxiliary[start:end]  # an auxiliary point stays with its end
        near = np.flatnonzero(free & rests[start:end] & (lines > 0.75 * most))
        if near.size or end < last:  # a stop elsewhere needs further points for the tolerance
            end = start + 1 + int((near if near.size else np.flatnonzero(free & (lines <= 0.9 * most))[::-1])[0])
        pieces.append((start, end))
        start = end
    if len(pieces) > 1 and len(pieces) > most:
        reason = f"{last} points need {len(pieces)} modules, more than a main module of"
        raise TrajectoryError(f"{reason} {program.line_limit} lines can call; raise program.line_limit")
    return pieces


def motion_lines(
    program: Program,
    comments: Sequence[str],
    rows: np.ndarray,
    speed: np.ndarray,
    rests: np.ndarray,
    auxiliary: np.ndarray,
) -> list[str]:
    """SPLINE blocks from stop to stop, or LIN and CIRC motions blended by C_DIS, over the points of one module.

    rows (q, 6): X, Y, Z [mm], A, B, C [deg]. A, B, C are written where they change, at the first point and behind a
    comment, where an operator may enter: a place keeps what it leaves out from the place before. Public programs that
    run on KR C2 and KR C4 are written so (javakuka.com).
    """
    lines: list[str] = []
    feeds = [f"$VEL.CP={speed_text(value)}" for value in speed.tolist()]
    rests = rests.copy()
    rests[-1] = True
    spline = program.motion == "SPLINE"
    begins, usual, turned, motion = True, "", np.full(3, np.inf), "LIN "
    for i, (feed, rest) in enumerate(zip(feeds, rests.tolist(), strict=True)):
        if begins or not spline:  # a block has its usual speed, which its segments need not state
            block = feeds[i : i + int(np.argmax(rests[i:])) + 1] if spline else [feed]
            most = Counter(block).most_common(1)[0][0]
            lines += [most] * (most != usual) + ["SPLINE"] * spline
            usual = most
        turns = bool(comments[i]) or np.abs(rows[i, 3:] - turned).max() > TURNED
        lines += [comments[i]] * bool(comments[i])
        if auxiliary[i]:  # its A, B, C do not count
            motion = f"CIRC {{{frame_text(rows[i, :3], shortest)}}},"
            turned = np.full(3, np.inf) if turns else turned
            continue
        turned = rows[i, 3:] if turns else turned
        place = f"{{{frame_text(rows[i, : 6 if turns else 3], shortest)}}}"
        if spline:
            lines += [f"SPL {place}" + f" WITH {feed}" * (feed != usual), *["ENDSPLINE"] * rest]
        else:
            lines.append(motion + place + " C_DIS" * (not rest and program.blend_distance > 0.0))
            motion = "LIN "
        begins = rest
    return lines


def point_speeds(
    program: Program, run: Trajectory, points: np.ndarray, auxiliary: np.ndarray, feeds: np.ndarray | None = None
) -> np.ndarray:
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
    slowest = 1e-6  # [m/s]
    speed = np.concatenate([[0.0], np.maximum(fastest, slowest)])
    middle = np.flatnonzero(auxiliary)  # both halves of an arc have one speed
    speed[middle] = speed[middle + 1] = np.maximum(speed[middle], speed[middle + 1])
    return speed
