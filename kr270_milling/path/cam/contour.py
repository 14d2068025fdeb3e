"""Contours that look ahead: rounded corners, and the path of the tool's centre beside a contour (G41, G42, RL, RR).

A program with such words is run twice: the first run records the moves, the second one runs what is planned for each.
The rule is that of LinuxCNC: the first move leads to the point beside its own end, an arc goes around an outside
corner, at an inside corner the tool stops where it touches both sides.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Sequence
from typing import NamedTuple

NEAR = 1e-9  #: [m], rounding of a place
STRAIGHT_ON = (
    0.05  #: [rad], a smaller turn is no corner and costs 0.13 % of the radius: LinuxCNC, TOLERANCE_CONCAVE_CORNER
)
FULL = 2 * math.pi
BACK = "the path turns back by almost half a turn before this move, into a corner that is narrower than the tool"
ROUNDING = 10e-6  #: [m] of the places of a program: a move back beside the last one by less is on the same line


class Stroke(NamedTuple):
    """A move in the xy plane as the program states it; places are x + i y [m] in its coordinates."""

    start: complex
    end: complex
    z: float  #: [m], at the end
    rapid: bool = False
    centre: complex | None = None  #: of an arc
    sense: int = 0  #: 1: an arc to the left, -1: to the right
    turns: int = 0  #: full ones before the arc
    side: int = 0  #: 1: the tool is to the left of the contour (G41), -1: to the right
    radius: float = 0.0  #: [m], of the tool; NaN: that of ``tool``
    tool: str = ""
    corner: tuple[str, float] | None = None  #: word and size [m] of what rounds the corner after the move

    @property
    def moves(self) -> bool:
        """Return whether the tool moves in the xy plane."""
        return self.centre is not None or self.end != self.start

    @property
    def curvature(self) -> float:
        """Return the curvature [1/m], positive to the left."""
        return 0.0 if self.centre is None else self.sense / abs(self.start - self.centre)

    def direction(self, place: complex) -> complex:
        """Return the direction of the move at a place of the stroke."""
        if self.centre is None:
            way = self.end - self.start
        else:
            way = 1j * self.sense * (place - self.centre)
        return way / abs(way)

    def beside(self, place: complex, side: int, radius: float) -> complex:
        """Return the centre of a tool that touches the stroke at a place."""
        return place + 1j * side * radius * self.direction(place)

    def length(self, start: complex, end: complex) -> float:
        """Return the way [m] from one place beside the stroke to another, in its direction."""
        if self.centre is None:
            return ((end - start) / self.direction(start)).real
        angle = cmath.phase((end - self.centre) / (start - self.centre)) * self.sense % FULL
        return (0.0 if angle > FULL - 1e-7 else angle) * abs(start - self.centre)

    @property
    def way(self) -> float:
        """Return the way [m] along the stroke in the xy plane."""
        if self.centre is None:
            return abs(self.end - self.start)
        circle = FULL * abs(self.start - self.centre)
        return (self.length(self.start, self.end) or circle) + self.turns * circle


def planned(strokes: Sequence[Stroke | None]) -> list[list[Stroke] | str | None]:
    """Return the moves of the tool for each stroke, or the sentence of a refusal; None: a move of another kind."""
    fit = "the tool does not fit into the corner before this move without a gouge; take a smaller tool"
    results: list[list[Stroke] | str | None] = [None if stroke is None else [] for stroke in strokes]
    rows = _rounded(strokes, results)
    shift = 0j  # of the tool from the contour
    last: Stroke | None = None  # with its offset
    begin = 0j  # place of the tool before ``last``
    tail: list[tuple[int, int]] = []  # places in the results of ``last`` and of moves along z after it
    for index, stroke in rows:
        result = results[index]
        if stroke is None or not isinstance(result, list):
            shift, last, tail = 0j, None, []
            continue
        side, radius, start = stroke.side, stroke.radius, stroke.start + shift
        if not side and not shift and not result and stroke.centre is None and stroke == strokes[index]:
            results[index], last, tail = None, None, []  # as the program states it
            continue
        before = strokes[index - 1] if index else None
        level = before is not None and before.z == stroke.z and stroke.rapid
        moves = stroke.moves or (shift and not side and level)
        if not moves and shift and not side:
            results[index] = "the first move after the compensation is along z, where controls differ; state X and Y"
        elif not moves:
            result.append(stroke._replace(start=start, end=start))
            tail.append((index, len(result) - 1))
        if not moves:
            continue
        if not side:
            if shift and stroke.centre is not None:
                results[index] = "the first move after the end of the compensation is an arc; write a straight one"
            shift, last = 0j, None
            result.append(stroke._replace(start=start))
            continue
        end = stroke.beside(stroke.end, side, radius)
        first = stroke.beside(stroke.start, side, radius)
        reason = ""
        if math.isnan(radius):
            name = stroke.tool or "TOOL"
            reason = f"the radius of the tool is not known; write its diameter in a comment, ({name} D=10)"
        elif stroke.centre is not None and side == stroke.sense and abs(stroke.end - stroke.centre) <= radius:
            size = 1e3 * abs(stroke.end - stroke.centre)
            reason = f"the radius of the arc, {size:.6g} mm, is not larger than the radius of the tool"
        elif last is None and stroke.centre is not None and radius:
            stroke = _entry(stroke, end)
            reason = "" if stroke.centre is not None else "no arc leads to the place beside the end of this first move"
            first = start
        elif last is None and stroke.centre is None and abs(stroke.end - stroke.start) <= radius:
            least = f"{1e3 * radius:g} mm"
            reason = f"the compensation begins with a straight move longer than the radius of the tool, {least}"
        elif last is not None and (last.side, last.radius) != (side, radius):
            reason = "the compensation changes without G40"
        elif last is not None and radius:
            turn = cmath.phase(stroke.direction(stroke.start) / last.direction(last.end))
            back = abs(turn) > math.pi - STRAIGHT_ON
            cusp = back and side * (last.curvature + stroke.curvature) < 0  # the tool is in between
            inside = side * turn > STRAIGHT_ON
            if back and inside and not cusp:  # LinuxCNC goes around it, through one side of the corner
                shorter = min(abs(move.end - move.start) for move in (last, stroke))
                reason, inside = (BACK if shorter * abs(math.sin(turn)) > ROUNDING else ""), False
            if cusp or inside:
                place = _meeting(last, stroke, side, radius, begin)
                start, reason = (first, fit) if place is None else (place, "")
                for k, n in tail if not reason else ():
                    row = results[k]
                    if isinstance(row, list):
                        row[n] = row[n]._replace(end=start, start=start if (k, n) > tail[0] else row[n].start)
            elif back or side * turn < -STRAIGHT_ON:
                around = Stroke(start, first, math.nan, stroke.rapid)
                if not stroke.rapid:
                    around = around._replace(centre=stroke.start, sense=-side)
                result.append(around)
                start = first
        if reason:
            results[index] = reason
            shift, last, tail = end - stroke.end, stroke, []
            begin = first
            continue
        tail = [(index, len(result))]
        result.append(stroke._replace(start=start, end=end))
        shift, last, begin = end - stroke.end, stroke, start
    return results


def _entry(stroke: Stroke, end: complex) -> Stroke:
    """Return an arc from the same place that ends beside its end in the same direction; without a centre: none does."""
    across, way = end - stroke.end, end - stroke.start
    towards = (across * way.conjugate()).real
    centre = end - across * abs(way) ** 2 / (2 * towards) if towards else None
    if centre is None or stroke.centre is None or ((centre - end) / (stroke.centre - stroke.end)).real <= 0:
        return stroke._replace(centre=None)
    return stroke._replace(centre=centre)


def _rounded(strokes: Sequence[Stroke | None], results: list) -> list[tuple[int, Stroke | None]]:
    """Return the strokes with their numbers, corners rounded or broken."""
    rows = list(enumerate(strokes))
    if not any(stroke and stroke.corner for stroke in strokes):
        return rows
    out: list[tuple[int, Stroke | None]] = []
    for index, stroke in rows:
        before = out[-1][1] if out else None
        if before is not None and before.corner:
            place = out[-1][0]
            cut = _corner(before, stroke) if stroke is not None else None
            if cut is None or stroke is None:
                results[place] = f"{before.corner[0]} does not fit between its move and the next one"
            else:
                out[-1] = place, before._replace(end=cut.start, corner=None)
                out.append((place, cut))
                stroke = stroke._replace(start=cut.end)
        out.append((index, stroke))
    if out and out[-1][1] is not None and out[-1][1].corner:
        results[out[-1][0]] = f"{out[-1][1].corner[0]} without a next move"
    return out


def _corner(one: Stroke, other: Stroke) -> Stroke | None:
    """Return the arc or chamfer between two strokes, None where it does not fit."""
    word, size = one.corner or ("", 0.0)
    if not (one.moves and other.moves and other.start == one.end and other.z == one.z) or one.rapid or other.rapid:
        return None
    place = one.end
    turn = cmath.phase(other.direction(place) / one.direction(place))
    side = 1 if turn > 0 else -1
    if not 1e-6 < abs(turn) < math.pi - 1e-6 or not size > 0:
        return None
    base = other._replace(corner=None, centre=None, sense=0, turns=0, z=one.z)
    if word in (",R", "RND"):
        centre = _meeting(one, other, side, size, one.beside(one.start, side, size))
        if centre is None:
            return None
        feet = [
            centre - 1j * side * size * stroke.direction(place)
            if stroke.centre is None
            else stroke.centre + (centre - stroke.centre) / abs(centre - stroke.centre) * abs(place - stroke.centre)
            for stroke in (one, other)
        ]
        return base._replace(start=feet[0], end=feet[1], centre=centre, sense=side)
    if one.centre is not None or other.centre is not None:
        return None
    size = size / (2 * math.cos(turn / 2)) if word == "CHF" else size  # CHF is the length of the chamfer
    if size > min(abs(one.end - one.start), abs(other.end - other.start)):
        return None
    return base._replace(start=place - size * one.direction(place), end=place + size * other.direction(place))


def _meeting(one: Stroke, other: Stroke, side: int, radius: float, begin: complex) -> complex | None:
    """Return the centre of a tool that touches two strokes that meet in an inside corner, None where it does not fit.

    begin: where the tool comes from. There may be two such places; the tool stops at the first one that it must not
    pass, the last on its way before the corner.
    """
    ends = one.beside(one.end, side, radius), other.beside(other.start, side, radius)
    last = other.beside(other.end, side, radius)
    room, way = one.length(begin, ends[0]), other.length(ends[1], last)
    if other.centre is not None and (other.turns or abs(ends[1] - last) < NEAR):
        way = FULL * abs(last - other.centre)
    if one.centre is not None and abs(begin - ends[0]) < NEAR:
        room = FULL * abs(ends[0] - one.centre)
    places = []
    for place in _common(one, other, ends):
        back, ahead = one.length(place, ends[0]), other.length(ends[1], place)
        if -NEAR <= back <= room + NEAR and -NEAR <= ahead <= way + NEAR:
            places.append((back, place))
    return min(places, key=lambda row: row[0])[1] if places else None


def _common(one: Stroke, other: Stroke, ends: tuple[complex, complex]) -> list[complex]:
    """Return the common points of the lines or circles beside two strokes."""
    (a, b), lines = ends, [stroke.centre is None for stroke in (one, other)]
    if all(lines):
        u, v = one.direction(one.end), other.direction(other.start)
        across = (v.conjugate() * u).imag
        return [a + u * ((b - a) * v.conjugate()).imag / across] if across else []
    if not any(lines):
        c, d, r, s = one.centre or 0j, other.centre or 0j, 0.0, 0.0
        r, s, between = abs(a - c), abs(b - d), abs(d - c)
        if not between:
            return []
        along = (r**2 - s**2 + between**2) / (2 * between)
        foot, u = c + along * (d - c) / between, (d - c) / between
        half = r**2 - along**2
    else:
        line, (place, other_place), arc = (one, ends, other) if lines[0] else (other, ends[::-1], one)
        u, centre = line.direction(line.start), arc.centre or 0j
        along = ((centre - place) / u).real
        foot = place + u * along
        half = abs(other_place - centre) ** 2 - abs(foot - centre) ** 2
        u = u / 1j
    if half < 0:
        return []
    return [foot + 1j * u * math.sqrt(half), foot - 1j * u * math.sqrt(half)]
