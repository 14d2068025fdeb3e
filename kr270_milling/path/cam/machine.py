"""The modal state of a milling machine, for every language of programs: the place of the tool, the move of a block.

Straight, on an arc of one of three planes, in a drilling cycle. A height of TOP is that of a tool that was taken away.
"""

from __future__ import annotations

import cmath
import contextlib
import copy
import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from kr270_milling.base.frames import Pose
from kr270_milling.path.cam.arcs import (
    ArcError,
    arc_points,
    centre_from_radius,
    curve_points,
    nurbs_points,
    row_points,
)
from kr270_milling.path.cam.contour import NEAR, Stroke, planned
from kr270_milling.path.cam.program_builder import Cycle, ProgramBuilder
from kr270_milling.path.kinematics import NO_ROTARY_AXES
from kr270_milling.path.toolpath import REACH, TOP
from kr270_milling.path.trajectory import LEVER, TOOL_DOWN, tool_along

INCH = 0.0254  #: [m]
MM = 0.001  #: [m]
AXES = {"X": 0, "Y": 1, "Z": 2}
CENTRES = ("I", "J", "K")
OF_ARCS = (*CENTRES, "R", "CR", "TURN")
CORNERS = (",R", ",C", "RND", "CHR", "CHF")  #: words that round or break the corner after a move
PLACES = ("X", "Y", "Z", "@", "^")  #: @ and ^: radius and angle about the origin (LinuxCNC)
MOVING = (*PLACES, *CENTRES, "R", "CR")
#: plane -> its two axes, so that a positive turn leads from the first to the second, and the axis across it
PLANES = {17: (0, 1, 2), 18: (2, 0, 1), 19: (1, 2, 0)}
NURBS = (5.2, 6.2)  #: rational B-splines: LinuxCNC with uniform knots, Fanuc with stated ones
CHORD = 2e-6  #: [m], arcs to chords
CLOSING = 10e-6  #: [m], rounding of a centre
FLAT = 1e4  #: [m], a radius beyond it cannot be meant
STEP = 1.5  #: [deg] of both axes: the shortest turn in between is within 0.01 deg of both
NO_FEED = "a cutting move without a feed"
NO_TIME = "G93 needs F in each line with a cutting move"
START = "start with G0 X Y Z"


class Machine:
    """Runs blocks: moves go to the program's path, what cannot be run to its refusals.

    Lengths inside are in [m], NaN where the program has not said where an axis is.
    """

    by_planes = False  #: the tool is along z of the coordinates in each cut

    def __init__(self, program: ProgramBuilder, feed: float):
        self.program = program
        self.unit = MM  #: unit of lengths in blocks
        self.first_unit = 0.0  #: that of the first move, as in the comments on tools
        self.position: list[float] = [math.nan] * 3
        self.mode: float | None = None  #: 0 to 3, 5 and 5.1: a curve of degree 3 and 2
        self.leaving: complex | None = None  #: last control point of the curve before, from its end
        self.nurbs: list[tuple[tuple[float, ...], float]] = []  #: points of a curve that is open, with their weights
        self.knots: list[float] = []  #: of G6.2
        self.order = 3
        self.incremental = False
        self.absolute_centre = False
        self.absolute: dict[str, bool] = {}  #: letters of this block that are absolute or not, whatever the mode
        self.plane = 17
        self.to_initial = True  #: G98
        self.cycle: Cycle | None = None
        self.feed_mode = 94  #: per minute; 95: per revolution, 93: inverse time
        self.feed: float | None = feed or None  #: [m/s], [m/rev] or [1/s]; at first what the cell says
        self.feed_word: float | None = None  #: number of the last F
        self.no_feed = NO_FEED  #: why there is none
        self.polar = False  #: X and Y are a radius and an angle (G16)
        self.pattern: list[complex] = []  #: holes of the block about its place [m]
        self.drilled = False  #: the block drilled a hole
        self.ended = False
        #: from coordinates of the program to those of the path: factor of x + i y, x + i y [m], z [m]; None: the same
        self.shift: tuple[complex, complex, float] | None = None
        #: from coordinates of the program to those before the shift, where a plane is tilted: its z is the tool axis
        self.tilt: Pose | None = None
        self.along_plane: tuple[float, ...] = TOOL_DOWN  #: orientation of a tool along z of the plane
        self.kinematics = NO_ROTARY_AXES
        self.angles = [0.0, 0.0]  #: of its rotary axes [deg], NaN where a plane has turned them
        self.follows_tip = False  #: coordinates are those of the tip, whatever the angles are (G43.4, TRAORI, M128)
        #: from the linear axes to the tip on the workpiece, while the control does not follow the tip; None: the same
        self.swung: Pose | None = None
        self.turned_from: list[float] | None = None  #: angles before this block, which turns the tool
        self.aim: tuple[float, ...] | None = None  #: orientation at the end of this block, which states the tool axis
        self.side = 0  #: 1: the tool is to the left of the contour, -1: to the right
        self.radius = 0.0  #: [m], by which it is; NaN: that of the tool
        self.beside = 0j  #: [m], of the tool from ``position``
        #: of a program that looks ahead: the moves of its first run, or what is planned for those of the second one
        self.contour: list[Stroke | None] | Iterator[list[Stroke] | str | None] | None = None

    def on_path(self, point) -> tuple[float, ...]:
        """Return the place of a point on the path; an axis without a value keeps none, of a tilted tool no axis."""
        if self.skew and not all(map(math.isfinite, point)):
            return (math.nan,) * 3
        if self.tilt is not None:
            point = self.tilt.apply(np.array(point)).tolist()
        if self.shift is not None:
            turn, xy, height = self.shift
            x, y, z = point
            if turn != 1:
                turned = complex(x, y) * turn
                x, y = turned.real, turned.imag
            point = x + xy.real, y + xy.imag, z + height
        if self.swung is not None:
            point = self.swung.apply(np.array(point)).tolist()
        return tuple(point)

    @property
    def skew(self) -> bool:
        """Return whether the axes of the program are not those of the path."""
        return self.tilt is not None or self.swung is not None

    def set_shift(self, shift: tuple[complex, complex, float] | None) -> None:
        """Give the moves that follow other coordinates; the tool stays where it is."""
        self.ends_contour("other coordinates")
        swung, self.swung = self.swung, None  # which comes after the shift
        place = self.on_path(self.position)
        self.shift, self.swung = shift, swung
        if shift is not None:
            turn, xy, height = shift
            x, y, z = place[0] - xy.real, place[1] - xy.imag, place[2] - height
            if turn != 1:
                turned = complex(x, y) / turn
                x, y = turned.real, turned.imag
            place = x, y, z
        self.position = list(place)

    def set_tilt(self, tilt: Pose | None) -> None:
        """Give the moves that follow the coordinates of a plane, None: those of the workpiece; the tool stays."""
        self.ends_contour("other coordinates")
        follows = self.follows_tip
        self.follow_tip(True)
        before, away = self.tilt or Pose(np.zeros(3), np.eye(3)), self.position[2] == TOP
        place = (tilt.inverse() @ before if tilt else before).apply(np.array(self.position))
        self.position = place.tolist() if all(map(math.isfinite, self.position)) else [math.nan] * 3
        if away:
            self.position[2] = TOP
        self.tilt, self.along_plane = tilt, TOOL_DOWN
        self.follow_tip(follows)
        try:
            if tilt is not None:
                self.along_plane = tool_along(np.round(tilt.rotation[:, 2], 12))
        except ValueError as fault:
            self.program.refuse("", str(fault), lost=True)

    def turn_to_plane(self) -> None:
        """Turn the tool along z of the plane, in place."""
        self.program.turn(self.along_plane)
        self.angles = [0.0, 0.0] if self.tilt is None else [math.nan, math.nan]

    def go(self, end) -> None:
        self.first_unit = self.first_unit or self.unit
        if self.turned_from is not None:
            self.turned_from = None
            self.program.quaternion = self._orientation(self.angles)
            self.swung = self._swung(self.angles)
        if self.aim is not None:
            self.program.quaternion, self.aim = self.aim, None
        self.program.rapid(end if self.shift is None and not self.skew else self.on_path(end))

    # --- rotary axes ---

    def take_angles(self, axes: dict, home: bool = False) -> None:
        """Take the words of the rotary axes out of a block: the tool turns along the move of this block.

        home: the axes go to zero, whatever way their values state.
        """
        new = [*self.angles]
        for k, letter in enumerate(self.kinematics.letters):
            if letter in axes:
                absolute = self.absolute.get(letter, not self.incremental)
                value = axes.pop(letter) + (0.0 if absolute else new[k])
                new[k] = 0.0 if home else value
        if new != self.angles:
            self.turned_from, self.angles = self.angles, new
        if self.turned_from is not None and self.side:
            self.program.refuse("G41", "the tool turns while G41 or G42 is active", "write G40 before it", lost=True)

    def take_axis(self, word: str, axis: list[float]) -> None:
        """Turn the tool along the move of this block to a stated axis of any length."""
        length = math.hypot(*axis)
        try:
            self.aim = tool_along([value / length for value in axis])
        except (ValueError, ZeroDivisionError) as fault:
            reason = "the tool axis has no length" if length == 0 else str(fault)
            self.program.refuse(word, reason, lost=True)
        if self.side:
            self.program.refuse("G41", "the tool turns while G41 or G42 is active", "write G40 before it", lost=True)

    def end_turn(self) -> None:
        """Turn in place where the block of ``take_angles`` or ``take_axis`` has no move."""
        if self.turned_from is None and self.aim is None:
            return
        known = all(map(math.isfinite, self.position))
        if self.mode in (None, 0) or not known:
            self.go(tuple(self.position))
        else:
            self._feed_to(tuple(self.position), [tuple(self.position)], 0.0)
        self.turned_from = self.aim = None

    def follow_tip(self, on: bool) -> None:
        """Count coordinates from now on at the tip, or at the linear axes; the tool stays where it is."""
        place, away = self.on_path(self.position), self.position[2] == TOP
        self.follows_tip = on
        before, self.swung = self.swung, self._swung(self.angles)
        if before is None and self.swung is None:
            return
        if not all(map(math.isfinite, place)):
            self.position = [math.nan, math.nan, TOP if away else math.nan]
            return
        self.position = (self.swung.inverse().apply(np.array(place)) if self.swung else np.array(place)).tolist()
        shift, self.shift = self.shift, None
        self.set_shift(shift)

    def _swung(self, angles: list[float]) -> Pose | None:
        off = self.follows_tip or self.tilt is not None or not any(angles) or not all(map(math.isfinite, angles))
        return None if off else self.kinematics.tip(angles)

    def _orientation(self, angles: list[float]) -> tuple[float, ...]:
        """Return the orientation of the tool at angles [deg]; that of the plane where the tool is along it."""
        if not all(map(math.isfinite, angles)):
            return self.program.quaternion
        axis = self.kinematics.tool_axis(angles)
        rounding = 1e-3  # of angles with two decimals of a degree
        if self.tilt is not None and math.dist(axis, self.tilt.rotation[:, 2]) < rounding:
            return self.along_plane
        try:
            return tool_along([round(v, 12) for v in axis])
        except ValueError as fault:
            self.program.refuse("".join(self.kinematics.letters), str(fault), derived=True)
            return self.program.quaternion

    def _feed_turning(self, start, ends: list, length: float) -> None:
        """Feed while the tool turns: by equal shares of angle and length, in steps of STEP.

        Under G93 the block takes the stated time. Else the feed is that of the tip, which a control has that follows
        the tip, or that of the linear axes, and of a turn alone deg a minute (LinuxCNC).
        """
        before, self.turned_from = self.turned_from or self.angles, None
        change = [b - a for a, b in zip(before, self.angles, strict=True)]
        most, degrees = max(map(abs, change)), math.hypot(*change)
        if not degrees <= 255 or most > 180:
            reason = "a rotary axis turns by more than 180 deg, or from an angle that is not known, in one feed move"
            self.program.refuse("".join(self.kinematics.letters), reason, "turn it in a rapid move", lost=True)
            return
        # a turn about one axis alone is a shortest turn; the linear axes follow each turn on a curve
        bend = math.sqrt(abs(change[0] * change[1])) if self.follows_tip else most
        lengths = [math.dist(a, b) for a, b in zip([start, *ends], ends, strict=False)]
        total, done, last = sum(lengths), 0.0, start
        places: list[tuple[float, ...]] = []
        turned = []
        self.swung = self._swung(before)
        first = self.on_path(start)
        for end, part in zip(ends, lengths, strict=True):
            share = part / total if total else 1.0 / len(ends)
            count = max(1, math.ceil(share * bend / STEP - 1e-9))
            for k in range(1, count + 1):
                angles = [a + (done + share * k / count) * d for a, d in zip(before, change, strict=True)]
                self.swung = self._swung(angles)
                places.append(self.on_path([a + (b - a) * k / count for a, b in zip(last, end, strict=True)]))
                turned.append(self._orientation(angles))
            done, last = done + share, end
        way = sum(math.dist(a, b) for a, b in zip([first, *places], places, strict=False))
        holder = LEVER * math.radians(degrees)
        feed = self._feed_rate(length or way or holder)
        if feed and not self.follows_tip:
            alone = way or holder if self.feed_mode == 93 else degrees * self.unit
            feed *= (way or holder) / (length or alone)
        if self.feed_mode == 93:
            self.feed, self.no_feed = None, NO_TIME
        if feed:
            self.program.cut(first, places, feed, 0.0, turned)
        else:
            self.program.refuse("F", self.no_feed if feed is None else "zero feed on a cutting move", derived=True)

    # --- what moves no tool through material ---

    def set_mode(self, mode: float | None) -> None:
        """G0 to G3, G5, G5.1, G5.2, G6.2, which end a cycle; G5.3 ends the curve of G5.2."""
        if mode != self.mode:
            self.leaving = None
        if self.nurbs and mode != self.mode:
            if (self.mode, mode) == (5.2, 5.3):
                inside = len(self.nurbs) - self.order + 1
                self._nurbs([0.0] * self.order + [float(k) for k in range(1, inside)] + [float(inside)] * self.order)
            else:
                self.program.refuse(f"G{self.mode:g}", f"a curve of G{self.mode:g} without its end", lost=True)
                self.nurbs, self.knots = [], []
        self.mode = mode if mode is None or mode in (5.1, *NURBS) else int(mode)
        self.mode = None if mode == 5.3 else self.mode
        self.cycle = None

    def set_feed_mode(self, mode: int) -> None:
        """A feed of one kind means nothing as another."""
        if mode != self.feed_mode:
            self.feed_mode = mode
            self.feed, self.no_feed = None, NO_FEED

    def set_feed(self, value: float, unit: float) -> None:
        """The number of a feed, lengths in ``unit`` [m]."""
        most = 1e10  # a number above any feed that a CAM writes for "as fast as possible"
        length = {MM: "mm", INCH: "inches"}.get(unit, "tenths of an inch")  # of Heidenhain
        time = {93: "moves a minute (G93)", 94: "a minute", 95: "a revolution (G95)"}[self.feed_mode]
        self.program.feed_units[time if self.feed_mode == 93 else f"{length} {time}"] = None
        if 0 <= value <= most:
            self.feed = {94: value * unit / 60, 95: value * unit, 93: value / 60}[self.feed_mode]
            self.feed_word = value
        else:
            word = f"F{value:g}"
            self.program.refuse(word, f"the feed {word} must lie between 0 and {most:g} per minute")

    def home(self, axes: list[str], feeds: bool = False) -> None:
        """The tool leaves the workpiece: up to the top height first, then X and Y are unknown.

        feeds: the move cuts on its way to a place of the machine.
        """
        self.ends_contour("a move home")
        if feeds and axes and "Z" not in axes and self.position[2] <= 0.0:
            reason = "a cut to a place of the machine, which is not known"
            self.program.refuse(axes[0], reason, "let the CAM output coordinates of the workpiece", lost=True)
        program = self.program
        if not {"X", "Y"}.isdisjoint(axes) and self.position[2] != TOP and len(program) and not program.away:
            program.sideways += [(" ".join(axes), self.on_path(self.position)[2], program.line)] * program.active
        if "Z" in axes:
            self.position[2] = TOP
            self.go(self.tip)
            self.beside = 0j
            self.program.away |= self.skew
        for axis in axes:
            if axis != "Z":
                self.position[AXES[axis]] = math.nan
                self.program.away = True

    def change_tool(self, tool: str) -> None:
        """The tool of the moves that follow, if it is another one."""
        if tool not in ("", self.program.tool):
            self.ends_contour("a change of the tool")
            self.position, self.beside = list(self.tip), 0j  # the control reads the place of the tool: LinuxCNC
            self.program.change_tool(tool)

    # --- blocks ---

    def move(self, axes: dict[str, float], mode: float | None = None, cycle: float | None = None) -> None:
        """Move as a block says and take the words that this needs out of ``axes``.

        mode: 0 to 3 where the block says G0 to G3; cycle: 73 to 89 where it begins or, 80, ends a cycle.
        """
        if mode is not None:
            self.set_mode(mode)
        self.drilled = False
        if mode is not None and cycle not in (None, 80):
            self.program.refuse(f"G{cycle:g}", f"G{cycle:g} contradicts G{mode:g} in the same line", lost=True)
            axes.clear()
            return
        if cycle == 80:
            self.cycle = cycle = None
        if cycle is not None or (self.cycle is not None and (self.pattern or not axes.keys().isdisjoint(PLACES))):
            self._drill(cycle, axes)
        elif self.mode in NURBS and axes:
            self._control_point(axes)
        elif not axes.keys().isdisjoint(MOVING):
            self._move(axes)

    def _move(self, axes: dict) -> None:
        if self.mode is None:
            word = next(letter for letter in axes if letter in MOVING)
            self.program.refuse(word, f"the word {word} without G0, G1, G2 or G3", derived=True)
        start, end = tuple(self.position), self._end(axes)
        arc = {letter: axes.pop(letter) for letter in OF_ARCS if letter in axes}
        self.position = list(end)
        if self.contour is None and not self.side:
            self._plain(start, end, arc, axes)
        else:
            self._contoured(start, end, arc, axes)

    def _plain(self, start, end, arc: dict, axes: dict) -> None:
        if self.mode == 0:
            self._surplus(arc)
            self.go(end)
        elif self.mode is not None:
            self._cut(start, end, arc, axes)

    # --- contours ---

    def look_ahead(self, run: Callable[[Any], None]) -> None:
        """Plan the moves by a first run of the program; the radius of a tool is that of its comment."""
        scout = copy.deepcopy(self)
        strokes = scout.contour = []
        run(scout)
        tools = scout.program.described_tools(scout.first_unit or scout.unit)
        radii = {tool.name: 0.0 if tool.wear else tool.diameter / 2 or math.nan for tool in tools}
        for k, stroke in enumerate(strokes):
            if stroke is not None and math.isnan(stroke.radius):
                strokes[k] = stroke._replace(radius=radii.get(stroke.tool, math.nan))
                if stroke.side and stroke.tool not in self.program.beside:
                    self.program.beside[stroke.tool] = max(0.0, radii.get(stroke.tool, 0.0))
        for stroke in strokes:
            if stroke is not None and stroke.side and stroke.radius:
                self.program.silent[f"moves {1e3 * stroke.radius:g} mm beside the contour"] += 1
        if any(stroke is not None and (stroke.side or stroke.corner) for stroke in strokes):
            self.contour = iter(planned(strokes))

    @property
    def tip(self) -> tuple[float, ...]:
        """Return the place of the tool in coordinates of the program."""
        place, height = self._seen(self.position)
        return self._unseen(place + self.beside, height)

    def _seen(self, point) -> tuple[complex, float]:
        """Return a point in the two axes of the plane, and its height across the plane."""
        first, second, across = PLANES[self.plane]
        return complex(point[first], point[second]), point[across]

    def _unseen(self, place: complex, height: float) -> tuple[float, ...]:
        """Return the point of a place in the plane and a height across it."""
        row = place.real, place.imag, height
        return tuple(row[PLANES[self.plane].index(axis)] for axis in range(3))

    def ends_contour(self, what: str) -> None:
        """Refuse what may not occur while the tool is beside the contour; the next move is the first of another one."""
        if self.side:
            self.program.refuse("G41", f"{what} while G41 or G42 is active", "write G40 before it", derived=True)
        if isinstance(self.contour, list):
            self.contour.append(None)
        elif self.contour is not None:
            next(self.contour)

    def _contoured(self, start, end, arc: dict, axes: dict) -> None:
        """Record a move in the first run; make what is planned for it in the second one."""
        first = isinstance(self.contour, list)
        stroke = self._stroke(start, end, dict(arc), dict(axes) if first else axes)
        for letter in CORNERS:
            axes.pop(letter, None)
        result: list[Stroke] | str | None = None
        if isinstance(self.contour, list):
            self.contour.append(stroke)
        elif self.contour is not None:
            result = next(self.contour)
        if isinstance(result, str):
            self.program.refuse(f"G{self.mode}", result, lost=True)
        elif stroke is None or result is None:
            self._plain(start, end, arc, axes)
            if not first and self.side:
                reason = "G41 and G42 take straight moves and arcs in the plane from a known place"
                self.program.refuse("G41", reason, derived=True)
        else:
            mode, height = self.mode, self._seen(start)[1]
            timed = self.feed_mode == 93 and mode != 0
            if timed:  # the tool beside the contour has the speed of the stated move: LinuxCNC
                self.feed, self.feed_mode = self._feed_rate(math.hypot(stroke.way, stroke.z - height)), 94
            try:
                for part in result:
                    height = self._run_stroke(part, height)
            except ArcError as error:
                self.program.refuse(f"G{mode}", str(error), derived=True)
            self.mode = mode
            if timed:
                self.feed, self.feed_mode, self.no_feed = None, 93, NO_TIME
            self.beside = result[-1].end - stroke.end

    def _stroke(self, start, end, arc: dict, axes: dict) -> Stroke | None:
        """Return a move in the plane; None for another one, and for one that cannot be run."""
        corner = next(((letter, axes[letter] * self.unit) for letter in CORNERS if letter in axes), None)
        known = all(map(math.isfinite, (*start, *end))) and start[2] != TOP
        if self.mode not in (0, 1, 2, 3) or not known:
            return None
        side = -self.side if self.radius < 0 else self.side  # a negative radius is on the other side
        (first, _), (last, height) = self._seen(start), self._seen(end)
        stroke = Stroke(first, last, height, self.mode == 0, side=side, corner=corner)
        stroke = stroke._replace(radius=abs(self.radius), tool=self.program.tool)
        if self.mode in (0, 1):
            return None if any(arc.values()) else stroke
        try:
            centre, turns = self._centre(start, end, arc, axes)
        except ArcError:
            return None
        places = [(place.real, place.imag) for place in (first, last)]
        if _misses(places[0], places[1], centre, self._closing(places[0], centre)):
            return None
        return stroke._replace(centre=complex(*centre), sense=1 if self.mode == 3 else -1, turns=turns)

    def _closing(self, start, centre) -> float:
        """[m], by how much the ends of an arc may differ in their distance from its centre, by the rule of LinuxCNC:
        by rounding to 0.01 mm or 0.001 in in all numbers, or by 0.1 % of the radius, but at most by 100 roundings."""
        return float(self._closing_of(math.dist(start[:2], centre)))

    def _closing_of(self, radius):
        rounding = 2.0 * math.sqrt(2.0) * (10e-6 if self.unit == MM else 25.4e-6)
        return np.clip(1.001e-3 * radius, rounding, 100.0 * rounding)

    def _run_stroke(self, stroke: Stroke, height: float) -> float:
        """Make a move that is planned, from a height; return that of its end."""
        z = height if math.isnan(stroke.z) else stroke.z
        start, end = self._unseen(stroke.start, height), self._unseen(stroke.end, z)
        self.mode = 0 if stroke.rapid else {0: 1, 1: 3, -1: 2}[stroke.sense]
        if stroke.rapid:
            self.go(end)
        elif stroke.centre is None:
            self._feed_to(start, [end], math.dist(start, end))
        else:
            self._feed_to(start, *self._chords(start, end, (stroke.centre.real, stroke.centre.imag), stroke.turns))
        return z

    def _end(self, axes: dict) -> tuple[float, ...]:
        """Return the end point of the block; take the words of lengths out of ``axes``."""
        end = list(self.position)
        if self.polar or not axes.keys().isdisjoint("@^"):
            self._polar(axes)
        for letter, axis in AXES.items():
            value = axes.pop(letter, None)
            if value is None:
                continue
            end[axis] = value * self.unit
            if not self.absolute.get(letter, not self.incremental):
                end[axis] += self.position[axis]
                if not math.isfinite(end[axis]):
                    reason = "a G91 move before an absolute position is known"
                    self.program.refuse(letter, reason, START, derived=True)
            if not abs(end[axis]) <= REACH and math.isfinite(end[axis]):
                word = f"{letter}{value:g}"
                self.program.refuse(word, f"{word} lies more than {REACH:g} m away; wrong unit?", lost=True)
                end[axis] = math.nan
        return tuple(end)

    def _polar(self, axes: dict) -> None:
        """Replace radius and angle about the origin, of which the one that is missing stays, by X and Y."""
        words = {letter: axes.pop(axis) for letter, axis in zip("@^", "XY", strict=True) if self.polar and axis in axes}
        words |= {letter: axes.pop(letter) for letter in "@^" if letter in axes}
        place = complex(*self.position[:2]) / self.unit
        if not words:
            return
        word = "G16" if self.polar else "@"
        if not axes.keys().isdisjoint("XY") or self.plane != 17 or (self.polar and self.incremental):
            self.program.refuse(word, "a radius and an angle with X, Y, G18 or G19, or G16 with G91", lost=True)
        elif len(words) < 2 and not abs(place) > 0:
            self.program.refuse(word, "a radius or an angle alone at the origin", lost=True)
        else:
            radius, angle = words.get("@", abs(place)), math.radians(words.get("^", math.degrees(cmath.phase(place))))
            if self.incremental:  # the radius and the angle grow
                radius = abs(place) + words.get("@", 0.0)
                angle = cmath.phase(place) + math.radians(words.get("^", 0.0))
            end = cmath.rect(radius, angle) - (place if self.incremental else 0.0)
            axes["X"], axes["Y"] = end.real, end.imag

    def _surplus(self, arc: dict) -> None:
        letter = next((letter for letter, value in arc.items() if value), "")
        if letter:
            reason = f"the word {letter} belongs to G2 or G3, not to G{self.mode}"
            self.program.refuse(letter, reason, derived=True)

    def _cut(self, start, end, arc: dict, axes: dict) -> None:
        straight = self.mode == 1
        if straight and arc:
            self._surplus(arc)
        known = not any(map(math.isnan, start))
        if not known and straight and self._approach(start, end):
            self.go(end)
        elif not known or (not straight and start[2] == TOP):
            reason = f"G{self.mode} before X, Y and Z are known"
            self.program.refuse(f"G{self.mode}", reason, START, derived=True)
        elif any(map(math.isnan, end)):
            return
        elif straight:
            self._feed_to(start, [end], math.dist(start, end))
        else:
            try:
                shape = self._arc if self.mode in (2, 3) else self._curve
                points, length, curvature = shape(start, end, arc, axes)
            except ArcError as error:
                self.program.refuse(f"G{self.mode}", str(error), derived=True)
            else:
                self._feed_to(start, points, length, curvature)

    def _approach(self, start, end) -> bool:
        """Return whether a G1 from an unknown place stays above the part: posts may feed where others go rapidly."""
        if all(map(math.isfinite, end)):
            return self.program.last is None or start[2] == TOP
        return end[2] == start[2] or end[2] > 0 or (math.isnan(end[2]) and self.program.last is None)

    def _feed_to(self, start, ends: list, length: float, curvature: float = 0.0) -> None:
        if self.turned_from is not None:
            self._feed_turning(start, ends, length)
            return
        known = self.follows_tip or (self.kinematics.letters and all(map(math.isfinite, self.angles)))
        free = known and self.tilt is None and self.cycle is None
        if self.by_planes and not free and self.program.quaternion != self.along_plane:
            reason = "the tool is not along z of the coordinates of this cut"
            advice = "turn it before: G53.1, PLANE with MOVE or TURN, CYCLE800 with DIR, A0 B0 C0 after their end"
            self.program.refuse(f"G{self.mode:g}", reason, advice, derived=True)
            self.program.lost = True
            return
        curvature = 0.0 if self.skew else curvature
        feed = self._feed_rate(length if math.isfinite(length) else 0.0)
        if self.feed_mode == 93:
            self.feed, self.no_feed = None, NO_TIME
        if feed:
            if self.shift is not None or self.skew:
                start, ends = self.on_path(start), [self.on_path(end) for end in ends]
            turned = () if self.aim is None else (self.aim,)
            self.aim = None
            if turned and len(ends) > 1:
                self.program.refuse("G2", "an arc along which the tool turns", "let the CAM output lines", lost=True)
                return
            self.program.cut(start, ends, feed, curvature, turned)
        elif (length or self.aim) and feed == 0:
            self.program.refuse("F", "zero feed on a cutting move", derived=True)
        elif length:
            advice = "give path.feed_rate_m_per_min in the cell" if self.no_feed == NO_FEED else ""
            self.program.refuse("F", self.no_feed, advice, derived=True)

    def _feed_rate(self, length: float) -> float | None:
        """[m/s] over a move of ``length`` [m]; None where no feed was given."""
        speed = self.program.spindle_speed
        if self.feed is None or self.feed_mode == 94:
            return self.feed
        if self.feed_mode == 95:
            return self.feed * abs(speed) / (2 * math.pi) if speed else None
        return self.feed * length

    # --- arcs ---

    def _centre(self, start, end, arc: dict, axes: dict) -> tuple[tuple[float, float], int]:
        """Return the centre of an arc in its plane [m] and its full turns; raise ArcError."""
        plane = PLANES[self.plane]
        first, second, across = (CENTRES[axis] for axis in plane)
        from_point, to_point = ([point[axis] for axis in plane] for point in (start, end))
        far = next((letter for letter in arc if letter != "TURN" and not abs(arc[letter]) * self.unit <= FLAT), None)
        if far:
            raise ArcError(f"{far}{arc[far]:g} is more than {FLAT / 1e3:g} km; wrong unit?")
        if arc.get(across) and not (self.absolute_centre and abs(arc[across] * self.unit - start[plane[2]]) < CLOSING):
            raise ArcError(f"{across} does not belong to an arc of G{self.plane}")
        if "R" in arc and "CR" in arc:
            raise ArcError("an arc is given by R or by CR=, not by both")
        radius = arc.get("R", arc.get("CR"))
        centres = [letter for letter in (first, second) if letter in arc]
        if radius is not None and centres:
            raise ArcError(f"an arc is given by {' and '.join(centres)} or by R, not by both")
        if radius is None and not centres:
            raise ArcError(f"G{self.mode} without {first}, {second} or R")
        clockwise = self.mode == 2
        if radius is not None:
            centre = centre_from_radius(from_point, to_point, radius * self.unit, clockwise, CLOSING)
        else:
            stated = [arc.get(letter, 0.0) * self.unit for letter in (first, second)]
            absolute = [self.absolute.get(letter, self.absolute_centre) for letter in (first, second)]
            if self.absolute_centre and len(centres) == 1 and not self.absolute.keys() & centres:
                raise ArcError(f"an absolute centre (G90.1) needs {first} and {second}")
            centre = tuple(stated[n] if absolute[n] else from_point[n] + stated[n] for n in (0, 1))
            closing = self._closing(from_point, centre)
            if _misses(from_point, to_point, centre, closing) and not _misses(from_point, to_point, stated, closing):
                advice = "write G90.1 first or post incremental centres"
                raise ArcError(f"the arc closes with an absolute centre only; {advice}")
        turns = arc["TURN"] if "TURN" in arc else axes.pop("P", 1.0) - 1
        if turns != int(turns):
            raise ArcError(f"a helix of {turns:g} turns is not meant")
        return centre, int(turns)

    def _arc(self, start, end, arc: dict, axes: dict) -> tuple[list, float, float]:
        """Points along an arc, its length [m], its curvature in the xy plane [1/m]."""
        return self._chords(start, end, *self._centre(start, end, arc, axes))

    def _chords(self, start, end, centre: tuple[float, float], turns: int) -> tuple[list, float, float]:
        """Points along an arc about a centre in its plane, as ``_arc``."""
        plane = PLANES[self.plane]
        from_point, to_point = ([point[axis] for axis in plane] for point in (start, end))
        closing = self._closing(from_point, centre)
        points, curvature, swept = arc_points(from_point, to_point, centre, self.mode == 2, closing, CHORD, turns)
        length = math.hypot(swept, to_point[2] - from_point[2])
        x, y, z = map(plane.index, (0, 1, 2))
        ends = [(point[x], point[y], point[z]) for point in points]
        return ends, length, curvature if self.plane == 17 else 0.0

    def centre_of(self, start, end, words, clockwise: bool) -> tuple[float, float] | None:
        """Return the centre [m] in the plane of an arc by the texts of I, J, K, R; None where ``_centre`` decides."""
        first, second, across = PLANES[self.plane]
        one, other, radius = words[first], words[second], words[3]
        stated = one is not None or other is not None
        if self.absolute_centre or words[across] is not None or stated == (radius is not None):
            return None
        if stated:
            return start[first] + float(one or 0.0) * self.unit, start[second] + float(other or 0.0) * self.unit
        from_point, to_point = ((point[first], point[second]) for point in (start, end))
        with contextlib.suppress(ArcError):
            return centre_from_radius(from_point, to_point, float(radius) * self.unit, clockwise, CLOSING)
        return None

    def row_of_arcs(self, ends: list, centres: dict[int, tuple[float, float, bool]]) -> tuple[np.ndarray, ...]:
        """Return what ``row_points`` does for blocks to the ends, arcs about those centres in the plane, clockwise."""
        plane = list(PLANES[self.plane])
        rows, arcs = np.array([tuple(self.position), *ends])[:, plane], np.full((len(ends), 3), np.nan)
        arcs[list(centres)] = list(centres.values())
        points, numbers, curvature = row_points(
            rows[:-1], rows[1:], arcs[:, :2], arcs[:, 2] == 1, self._closing_of, CHORD
        )
        return points[:, np.argsort(plane)], numbers, curvature * (self.plane == 17)

    def _curve(self, start, end, arc: dict, axes: dict) -> tuple[list, float, float]:
        """Points along a curve of G5 or G5.1 (LinuxCNC), its length [m], and 0."""
        word, cubic = f"G{self.mode:g}", self.mode == 5
        offsets = {letter: arc[letter] for letter in "IJ" if letter in arc}
        offsets |= {letter: axes.pop(letter) for letter in "PQ" if cubic and letter in axes}
        if self.plane != 17 or end[2] != start[2]:
            raise ArcError(f"{word} lies in the xy plane")
        if not cubic and (not offsets or arc.keys() - {"I", "J"}):
            raise ArcError(f"{word} takes X, Y, I and J")
        if cubic and ("P" not in offsets or "Q" not in offsets or ("I" in arc) != ("J" in arc)):
            raise ArcError(f"{word} takes X, Y, I, J, P and Q")
        a, b = complex(*start[:2]), complex(*end[:2])
        first = complex(offsets.get("I", 0.0), offsets.get("J", 0.0)) * self.unit
        if cubic and "I" not in offsets:
            if self.leaving is None:
                raise ArcError(f"{word} without I and J, which only a curve after a curve leaves out")
            first = -self.leaving
        control = [a, a + first, b]
        if cubic:
            self.leaving = complex(offsets["P"], offsets["Q"]) * self.unit
            control = [a, a + first, b + self.leaving, b]
        points, length = curve_points(control, CHORD)
        return [(point.real, point.imag, start[2]) for point in points[:-1]] + [end], length, 0.0

    def _control_point(self, axes: dict) -> None:
        """A point of G5.2 with weight P and, first, order L, or of G6.2 with weight R, knot K and, first, order P."""
        word, uniform = f"G{self.mode:g}", self.mode == 5.2
        placed = not axes.keys().isdisjoint("XYZ")
        if uniform and not self.nurbs:  # the curve begins where the tool is
            self.nurbs = [(tuple(self.position), 1.0 if placed else axes.pop("P", 1.0))]
            self.order = 3
        order, knot = (
            axes.pop("L" if uniform else "P", None) if not uniform or "L" in axes else None,
            axes.pop("K", None),
        )
        weight = axes.pop("P" if uniform else "R", 1.0)
        if not uniform:
            axes.pop("Q", None)  # the way of interpolation
        start = tuple(self.position)
        if placed:
            self.nurbs.append((self._end(axes), weight))
        if order is not None:
            self.order = int(order)
        across = PLANES[self.plane][2]
        if (
            self.incremental or self.side or self.polar or not all(map(math.isfinite, start)) or start[2] == TOP
            or not 2 <= self.order <= 30 or self.nurbs[-1:] and self.nurbs[-1][0][across] != start[across]
            or (not uniform and (knot is None or not math.dist(self.nurbs[0][0], start) < CLOSING))
        ):  # fmt: skip
            reason = (
                f"{word} needs absolute points in the plane, weights, the order and the knots, and starts at the tool"
            )
            self.program.refuse(word, reason, lost=True)
            self.nurbs, self.knots = [], []
        elif not uniform:
            self.knots.append(knot)
            if len(self.nurbs) >= self.order and len(self.knots) == len(self.nurbs) + self.order:
                self._nurbs(self.knots)

    def _nurbs(self, knots: list[float]) -> None:
        """Cut along the curve that is open."""
        first, second, across = PLANES[self.plane]
        start = tuple(self.position)
        try:
            points, length = nurbs_points(
                [complex(place[first], place[second]) for place, _ in self.nurbs],
                [weight for _, weight in self.nurbs], knots, CHORD,
            )  # fmt: skip
        except ArcError as error:
            self.program.refuse(f"G{self.mode:g}", str(error), lost=True)
        else:
            ends = []
            for point in points:
                place = [start[across]] * 3
                place[first], place[second] = point.real, point.imag
                ends.append(tuple(place))
            self.position = list(ends[-1])
            self._feed_to(start, ends, length)
        self.nurbs, self.knots = [], []

    # --- cycles ---

    def _drill(self, kind: float | None, axes: dict) -> None:
        """Drill the holes of a block along the axis of the plane: one hole, or several in a row with G91 and L or K."""
        self.drilled = True
        self.ends_contour("a drilling cycle")
        if not axes and not self.pattern:
            self.program.refuse(f"G{kind:g}", "a drilling cycle without X, Y, Z or R", lost=True)
            return
        across = PLANES[self.plane][2]
        if self.shift is not None and self.shift[0] != 1 and across != 2:
            self.program.refuse(f"G{self.plane}", "a drilling cycle across a plane that is turned", lost=True)
            axes.clear()
            return
        floor, level, peck = (axes.pop(letter, None) for letter in ("XYZ"[across], "R", "Q"))
        repeats = axes.pop("L" if "L" in axes else "K", 1.0)
        cycle = self.cycle = self.cycle or Cycle(0, self.position[across], self.position[across])
        if kind is not None:
            cycle.kind = int(kind)
        if cycle.kind == 76 and not axes.keys().isdisjoint("IJ"):
            reason = "G76 with I or J is a thread, or shifts the tool at the bottom of a bore"
            self.program.refuse("G76", reason, "leave threads out; write Q for fine boring", lost=True)
            axes.clear()
            return
        modes, before = (self.incremental, self.unit), cycle.modes
        if modes != before and before and (level is None or floor is None):
            self.program.doubt("cycle heights", "R or Z of a cycle from before G90, G91, G20 or G21 keeps its height")
        elif self.incremental and before and level is not None and kind is None:
            self.program.doubt("cycle heights", "R of a further hole with G91 counts from the height before the cycle")
        cycle.modes = modes
        if level is not None:
            cycle.retract = level * self.unit + (cycle.initial if self.incremental else 0.0)
        if floor is not None:
            cycle.bottom = floor * self.unit + (cycle.retract if self.incremental else 0.0)
        if peck is not None:
            cycle.peck = abs(peck) * self.unit
        # holes that one block drills in a row
        if not 0 <= repeats <= 1000 or repeats != int(repeats) or (repeats > 1 and not self.incremental):
            self.program.refuse("L", f"a hole is not drilled {repeats:g} times at one place", lost=True)
            axes.clear()
            return
        place = {axis: axes.pop(axis) for axis in PLACES if axis in axes}
        if not repeats:  # the cycle is defined and drills nothing here
            self.program.count("L0", 1 + len(place))
            for axis in place.keys() & AXES.keys():  # controls differ in whether the tool goes there
                self.position[AXES[axis]] = math.nan
        for _ in range(int(repeats)):
            x, y, z = self._end(dict(place))
            for hole in self.pattern or [0j]:
                if not self._hole((x + hole.real, y + hole.imag, z), cycle, across):
                    return

    def _hole(self, place: tuple[float, ...], cycle: Cycle, across: int) -> bool:
        word = f"G{cycle.kind}"
        beside = [value for axis, value in enumerate(place) if axis != across]
        if not all(map(math.isfinite, (*beside, cycle.retract, cycle.bottom))):
            reason = "a drilling cycle whose X, Y, Z and R are not all known"
            self.program.refuse(word, reason, START, derived=True)
            return False
        if not max(abs(cycle.bottom), abs(cycle.retract)) <= REACH or cycle.bottom > cycle.retract:
            self.program.refuse(word, "the cycle does not lead from R down to Z within reach")
            return False
        if cycle.kind in (73, 83) and not cycle.peck:  # LinuxCNC refuses it, other controls drill in one stroke
            self.program.refuse(word, f"{word} without Q, the depth of a peck", "write Q, or G81 for one stroke")
            return False
        try:
            strokes = cycle.strokes()
        except ValueError as error:
            self.program.refuse(word, str(error))
            return False

        def at(point, height: float) -> tuple[float, ...]:
            return (*point[:across], height, *point[across + 1 :])

        height = max(self.position[across], cycle.retract)
        if self.position[across] < cycle.retract - NEAR and math.dist(at(self.tip, 0.0), at(place, 0.0)) > NEAR:
            self.program.doubt("cycle heights", "R is above the tool, which rises here before it moves to the hole")
        self.go(at(self.tip, height))
        self.beside = 0j
        self.go(at(place, height))
        last = at(place, cycle.retract)
        self.go(last)
        self.program.drilling = across == 2
        for depth, rapid in strokes:
            end = at(place, depth)
            if rapid:
                self.go(end)
            else:
                self._feed_to(last, [end], math.dist(last, end))
            last = end
        self.program.drilling = False
        back = max(cycle.initial, cycle.retract) if self.to_initial and not math.isnan(cycle.initial) else cycle.retract
        self.go(at(place, back))
        self.position = list(at(place, back))
        return True


def _misses(start, end, centre, closing: float) -> bool:
    return abs(math.dist(start[:2], centre) - math.dist(end[:2], centre)) > closing
