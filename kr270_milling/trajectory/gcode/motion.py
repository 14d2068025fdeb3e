"""Where the tool stands and how a block moves it: straight, on an arc of one of three planes, in a drilling cycle.

A height of TOP is that of a tool that was taken away.
"""

from __future__ import annotations

import math

import numpy as np

from kr270_milling.trajectory.arcs import ArcError, centre_from_radius, flatten
from kr270_milling.trajectory.gcode.cycles import Cycle, strokes
from kr270_milling.trajectory.gcode.feed import Feed
from kr270_milling.trajectory.summary import Observed, Refusals
from kr270_milling.trajectory.toolpath import REACH, TOP, PathBuilder

__all__ = ["CHORD", "Motion"]

AXES = {"X": 0, "Y": 1, "Z": 2}
CENTRES = ("I", "J", "K")
#: plane -> its two axes, so that a positive turn leads from the first to the second, and the axis across it
PLANES = {17: (0, 1, 2), 18: (2, 0, 1), 19: (1, 2, 0)}
CHORD = 2e-6  #: [m], arcs to chords
CLOSING = 10e-6  #: [m], centre of an arc to both ends, or 0.1 % of its radius
FLAT = 1e4  #: [m], a radius beyond it cannot be meant
REPEATS = 1000  #: holes that one block drills in a row
START = "start with G0 X Y Z"


class Motion:
    """The modal state of moving; lengths inside are in [m], NaN where the program has not said where an axis is."""

    def __init__(self, path: PathBuilder, refusals: Refusals, seen: Observed, feed: float, chord: float = CHORD):
        self.path = path
        self.refusals = refusals
        self.seen = seen
        self.chord = chord
        self.feed = Feed(feed)
        self.position: list[float] = [math.nan] * 3
        self.mode: int | None = None  #: 0 to 3
        self.incremental = False
        self.absolute_centre = False
        self.plane = 17
        self.to_initial = True  #: G98
        self.cycle: Cycle | None = None
        self.tool = ""
        self.named = False  #: whether a comment named the operation since the last cut

    # --- what moves no tool through material ---

    def set_mode(self, mode: float | None) -> None:
        """G0 to G3, which end a cycle, or G80, which keeps what was before it."""
        self.mode = None if mode is None else int(mode)
        self.cycle = None

    def home(self, axes: list[str], line: int) -> None:
        """The tool leaves the workpiece: up to the top height first, then X and Y are where nobody knows."""
        self.cycle = None
        if "Z" in axes:
            self.position[2] = TOP
            self.path.rapid(tuple(self.position), line)
        for axis in axes:
            if axis != "Z":
                self.position[AXES[axis]] = math.nan
                self.path.away = True

    def preset(self, lengths: dict[str, float]) -> None:
        """G92 before the first move says where the tool stands."""
        for axis, value in lengths.items():
            self.position[AXES[axis]] = value

    def change_tool(self, tool: str, wanted: bool) -> None:
        if self.tool or len(self.path):
            self.path.away = True
        self.tool = tool
        self.path.active = wanted
        self.cycle = None
        if not self.named:
            self.path.name_feature(tool)

    # --- blocks ---

    def run(self, groups: dict, axes: dict, unit: float, absolute: dict, line: int) -> None:
        """Move as a block says and take the words that this needs out of ``axes``."""
        kind = groups.get("cycle")
        if kind == 80:
            self.cycle = None
        if "motion" in groups:
            self.set_mode(groups["motion"])
        if kind not in (None, 80) or (self.cycle is not None and not axes.keys().isdisjoint("XYZ")):
            self._drill(kind, axes, unit, absolute, line)
        elif not axes.keys().isdisjoint(("X", "Y", "Z", "I", "J", "K", "R", "CR")):
            self._move(axes, unit, absolute, line)

    def _move(self, axes: dict, unit: float, absolute: dict, line: int) -> None:
        if self.mode is None:
            word = next(letter for letter in axes if letter in "XYZIJKRCR")
            self.refusals.add_derived(line, word, f"the word {word} without G0, G1, G2 or G3")
        start = tuple(self.position)
        end = self._end(axes, unit, absolute, line)
        arc = {letter: axes.pop(letter) for letter in (*CENTRES, "R", "CR", "TURN") if letter in axes}
        self.position = list(end)
        if self.mode is None:
            return
        if self.mode == 0:
            self._surplus(arc, line)
            self.path.rapid(end, line)
        else:
            self._cut(start, end, arc, axes, unit, absolute, line)

    def _end(self, axes: dict, unit: float, absolute: dict, line: int) -> tuple[float, ...]:
        """Where the block leads; words of lengths are taken out of ``axes``."""
        end = list(self.position)
        for letter, axis in AXES.items():
            value = axes.pop(letter, None)
            if value is None:
                continue
            end[axis] = value * unit
            if not absolute.get(letter, not self.incremental):
                end[axis] += self.position[axis]
                if not math.isfinite(end[axis]):
                    self.refusals.add_derived(line, letter, "a G91 move before an absolute position is known", START)
            if not abs(end[axis]) <= REACH and math.isfinite(end[axis]):
                reason = f"{letter}{value:g} lies more than {REACH:g} m away; wrong unit?"
                self.refusals.add(line, f"{letter}{value:g}", reason, lost=True)
                end[axis] = math.nan
        return tuple(end)

    def _surplus(self, arc: dict, line: int) -> None:
        for letter, value in arc.items():
            if value:
                reason = f"the word {letter} belongs to G2 or G3, not to G{self.mode}"
                self.refusals.add_derived(line, letter, reason)
                return

    def _cut(self, start, end, arc: dict, axes: dict, unit: float, absolute: dict, line: int) -> None:
        known = not any(map(math.isnan, start))
        if not known and self.mode == 1 and self._approach(start, end):
            self.path.rapid(end, line)
            return
        if not known or (self.mode is not None and self.mode > 1 and start[2] == TOP):
            self.refusals.add_derived(line, f"G{self.mode}", f"G{self.mode} before X, Y and Z are known", START)
            return
        if any(map(math.isnan, end)):
            return
        if self.mode == 1:
            self._surplus(arc, line)
            self._feed(start, [end], math.dist(start, end), line)
            return
        try:
            points, curvature, length = self._arc(start, end, arc, axes, unit, absolute)
        except ArcError as error:
            self.refusals.add_derived(line, f"G{self.mode}", str(error))
            return
        self._feed(start, points, length, line, curvature)

    def _approach(self, start, end) -> bool:
        """Whether a G1 from an unknown place stays above the part: posts may feed where others go rapidly."""
        if all(map(math.isfinite, end)):
            return self.path.last is None or start[2] == TOP
        return end[2] == start[2] or math.isnan(end[2]) or end[2] > 0

    def _feed(self, start, ends: list, length: float, line: int, curvature: float = 0.0) -> None:
        feed = self.feed.rate(length if math.isfinite(length) else 0.0, self.path.spindle_speed)
        if not feed:
            if length:
                reason = "zero feed on a cutting move" if feed == 0 else "a cutting move without a feed"
                advice = "" if feed == 0 else "give path.feed_rate_m_per_min in the cell"
                self.refusals.add_derived(line, "F", reason, advice)
            return
        self.path.cut(start, ends, feed, line, curvature)
        self.named = False
        self.seen.cuts[self.tool] += 1
        self.seen.offsets.setdefault((self.tool, self.seen.offset), line)

    def _arc(self, start, end, arc: dict, axes: dict, unit: float, absolute: dict) -> tuple[list, float, float]:
        """Points along an arc, its curvature in the xy plane [1/m], its length [m]."""
        first, second, across = PLANES[self.plane]
        radius = arc.get("R", arc.get("CR"))
        far = next((n for n, v in arc.items() if n != "TURN" and not abs(v) * unit <= FLAT), None)
        if far:
            raise ArcError(f"{far}{arc[far]:g} is more than {FLAT / 1e3:g} km; wrong unit?")
        centres = [letter for letter in (CENTRES[first], CENTRES[second]) if letter in arc]
        if arc.get(CENTRES[across]) and not self.absolute_centre:
            raise ArcError(f"{CENTRES[across]} does not belong to an arc of G{self.plane}")
        from_point, to_point = [[p[first], p[second], p[across]] for p in (start, end)]
        if radius is not None and centres:
            raise ArcError(f"an arc is given by {' and '.join(centres)} or by R, not by both")
        clockwise = self.mode == 2
        if radius is not None:
            centre = centre_from_radius(from_point, to_point, radius * unit, clockwise, CLOSING)
        elif centres:
            centre = (
                self._centre(CENTRES[first], start, arc, unit, absolute),
                self._centre(CENTRES[second], start, arc, unit, absolute),
            )
        else:
            raise ArcError(f"G{self.mode} without {CENTRES[first]}, {CENTRES[second]} or R")
        turns = int(arc.get("TURN", axes.pop("P", 1) - 1))
        closing = max(CLOSING, min(0.5e-3, 1e-3 * math.dist(from_point[:2], centre)))
        if radius is None:
            given = [arc.get(letter, 0.0) * unit for letter in (CENTRES[first], CENTRES[second])]
            _check_centre(from_point, to_point, centre, given, closing)
        points, curvature = flatten(from_point, to_point, centre, clockwise, closing, self.chord, turns)
        if not np.abs(points).max() <= REACH:
            raise ArcError(f"the arc leads more than {REACH:g} m away; wrong unit?")
        ends = points[:, np.argsort(PLANES[self.plane])]
        chords = np.linalg.norm(np.diff(points[:, :2], axis=0, prepend=[from_point[:2]]), axis=1)
        swept = 2 / abs(curvature) * np.arcsin(np.clip(abs(curvature) * chords / 2, 0, 1)).sum()
        length = math.hypot(swept, to_point[2] - from_point[2])
        return list(map(tuple, ends.tolist())), curvature if self.plane == 17 else 0.0, length

    def _centre(self, letter: str, start, arc: dict, unit: float, absolute: dict) -> float:
        value = arc.get(letter, 0.0) * unit
        if absolute.get(letter, self.absolute_centre):
            return value
        return start[CENTRES.index(letter)] + value

    # --- cycles ---

    def _drill(self, kind: float | None, axes: dict, unit: float, absolute: dict, line: int) -> None:
        """One block of a drilling cycle: a hole at its X, Y, or several in a row with G91 and L or K."""
        floor, level, peck = axes.pop("Z", None), axes.pop("R", None), axes.pop("Q", None)
        repeats = axes.pop("L", axes.pop("K", 1.0))
        for letter in ("P", "I", "J"):
            axes.pop(letter, None)
        if kind is not None:
            initial = self.cycle.initial if self.cycle is not None else self.position[2]
            retract, bottom = (initial, math.nan) if self.cycle is None else (self.cycle.retract, self.cycle.bottom)
            self.cycle = Cycle(int(kind), initial, retract, bottom, 0.0 if self.cycle is None else self.cycle.peck)
        cycle = self.cycle
        if cycle is None:
            return
        if level is not None:
            cycle.retract = level * unit + (cycle.initial if self.incremental else 0.0)
        if floor is not None:
            cycle.bottom = floor * unit + (cycle.retract if self.incremental else 0.0)
        if peck is not None:
            cycle.peck = abs(peck) * unit
        if not 0 <= repeats <= REPEATS or (repeats > 1 and not self.incremental):
            self.refusals.add(line, "L", f"a hole is not drilled {repeats:g} times at one place", lost=True)
            return
        move = {axis: axes.pop(axis) for axis in "XY" if axis in axes}
        for _ in range(int(repeats)):
            x, y, _ = self._end(dict(move), unit, absolute, line)
            if not self._hole(x, y, cycle, line):
                return

    def _hole(self, x: float, y: float, cycle: Cycle, line: int) -> bool:
        if not all(map(math.isfinite, (x, y, cycle.retract, cycle.bottom))):
            reason = "a drilling cycle whose X, Y, Z and R are not all known"
            self.refusals.add_derived(line, f"G{cycle.kind}", reason, START)
            return False
        if not max(abs(cycle.bottom), abs(cycle.retract)) <= REACH or cycle.bottom > cycle.retract:
            self.refusals.add(line, f"G{cycle.kind}", "the cycle does not lead from R down to Z within reach")
            return False
        height = max(self.position[2], cycle.retract)
        self.path.rapid((self.position[0], self.position[1], height), line)
        self.path.rapid((x, y, height), line)
        at = (x, y, cycle.retract)
        self.path.rapid(at, line)
        try:
            path = strokes(cycle)
        except ValueError as error:
            self.refusals.add(line, f"G{cycle.kind}", str(error))
            return False
        for z, rapid in path:
            if rapid:
                self.path.rapid((x, y, z), line)
            else:
                self._feed(at, [(x, y, z)], abs(z - at[2]), line)
            at = (x, y, z)
        back = max(cycle.initial, cycle.retract) if self.to_initial and not math.isnan(cycle.initial) else cycle.retract
        self.path.rapid((x, y, back), line)
        self.position = [x, y, back]
        return True


def _check_centre(start, end, centre, given: list[float], closing: float) -> None:
    """Say so where centres that are meant as absolute ones are read as incremental."""

    def misses(at) -> bool:
        return abs(math.dist(start[:2], at) - math.dist(end[:2], at)) > closing

    if misses(centre) and not misses(given):
        raise ArcError("the arc closes with an absolute centre only; write G90.1 first or post incremental centres")
