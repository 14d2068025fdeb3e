"""The modal state that APT statements change."""

from __future__ import annotations

import math

from scipy.spatial.transform import Rotation

from kr270_milling.trajectory.apt_words import FEEDS, LENGTHS
from kr270_milling.trajectory.arcs import ArcError, flatten
from kr270_milling.trajectory.files import short
from kr270_milling.trajectory.path_builder import PathBuilder
from kr270_milling.trajectory.recorder import TOP, Recorder
from kr270_milling.trajectory.refusals import Refusals
from kr270_milling.trajectory.source_program import ProgramTool
from kr270_milling.trajectory.summary import Observed
from kr270_milling.trajectory.toolpath import REACH
from kr270_milling.trajectory.trajectory import TOOL_DOWN

__all__ = ["Machine"]

CHORD = 2e-6  #: [m], arcs to chords
CLOSING = 10e-6  #: [m], centre of an arc to both ends, or 0.1 % of its radius
AXES5 = "the tool stands along z; post a 3-axis path"


class StatementError(ValueError):
    """A statement with values that it cannot have."""


class Machine:
    """Runs statements that move or set something."""

    def __init__(self, path: PathBuilder, refusals: Refusals, seen: Observed, feed: float):
        self.path = path
        self.refusals = refusals
        self.seen = seen
        self.recorder = Recorder(path)
        self.unit = LENGTHS["MM"]
        self.feed: float | None = feed or None  #: [m/s], or [m/rev]
        self.per_turn = False
        self.speed = 0.0
        self.rapid = False
        self.ended = False
        self.tool = ""
        self.numbered = False  #: whether LOADTL names the tools
        self.position: tuple[float, float, float] | None = None
        self.circle: tuple[list[float], int] | None = None  #: its numbers and line, until the GOTO of its end
        self.system: list[str] | None = None
        self.actions = {"GOTO": self._goto, "FROM": self._from, "GODLTA": self._delta, "CIRCLE": self._circle,
                        "RAPID": self._rapid, "FEDRAT": self._feed, "FEED": self._feed, "SPINDL": self._spindle,
                        "UNITS": self._units, "FINI": self._end, "END": self._end, "GOHOME": self._home,
                        "LOADTL": self._load, "LOAD": self._load, "TOOLNO": self._load, "CUTTER": self._cutter,
                        "TLDATA": self._cutter, "MULTAX": self._axes, "CUTCOM": self._compensation,
                        "MSYS": self._system}  # fmt: skip

    def run(self, word: str, values: list[str], number: int) -> None:
        """One statement."""
        try:
            if self.circle is not None and word in ("CIRCLE", "RAPID", "FROM", "GODLTA", "FINI"):
                raise StatementError("a CIRCLE/ without the GOTO/ of its end")
            self.actions[word](values, number)
        except StatementError as error:
            self.circle = None
            self.refusals.add(number, word, str(error))

    def finish(self) -> None:
        """At the end of the file."""
        if self.circle is not None:
            self.refusals.add(self.circle[1], "CIRCLE", "a CIRCLE/ without the GOTO/ of its end")

    # --- moves ---

    def _goto(self, values: list[str], number: int) -> None:
        numbers = [_number(v) for v in values]
        points = len(numbers) > 6 or (len(numbers) == 6 and abs(math.hypot(*numbers[3:]) - 1) > 1e-3)
        if self.circle is not None and points and len(numbers) % 3 == 0:
            numbers = numbers[-3:]  # Creo lists points of the arc, the last one is its end
        if len(numbers) not in (3, 6):
            raise StatementError(f"GOTO/ needs x, y, z or x, y, z, i, j, k, not {len(numbers)} numbers")
        point = tuple(v * self.unit for v in numbers[:3])
        if not max(map(abs, point)) <= REACH:
            raise StatementError(f"the point lies more than {REACH:g} m away; wrong unit?")
        if len(numbers) == 6:
            self.path.quaternion = _tool_axis(numbers[3:])
        self._move(point, number)

    def _move(self, point: tuple, number: int) -> None:
        start, self.position = self.position, point
        circle, self.circle = self.circle, None
        if self.rapid or start is None:
            self.rapid = False  # RAPID holds for one move
            self.recorder.rapid(point, number)
            return
        feed = self._rate()
        if not feed:
            raise StatementError("a cutting move without FEDRAT/" if feed is None else "zero feed on a cutting move")
        ends, curvature = self._arc(start, point, circle[0]) if circle else ([point], 0.0)
        self.recorder.cut(start, ends, feed, number, curvature)
        self.seen.cuts[self.tool] += 1
        self.seen.offsets.setdefault((self.tool, ""), number)

    def _rate(self) -> float | None:
        """[m/s]"""
        if self.feed is None or not self.per_turn:
            return self.feed
        return self.feed * abs(self.path.spindle_speed) / (2 * math.pi) or None

    def _arc(self, start, end, circle: list[float]) -> tuple[list, float]:
        """Ends of the chords of an arc; k = 1 is counterclockwise, by the right-hand rule, and in NX clockwise.

        Seven numbers: PTC Creo help, "CL output for circular interpolation". NX adds tolerance and tool and names the
        axis "assuming a clockwise direction": NX documentation, CLSF manager; its programs confirm it.
        """
        centre = tuple(v * self.unit for v in circle[:2])
        clockwise = (circle[5] < 0) == (len(circle) == 7)
        closing = max(CLOSING, min(0.5e-3, 1e-3 * math.dist(start[:2], centre)))
        try:
            points, curvature = flatten(start, end, centre, clockwise, closing, CHORD)
        except ArcError as error:
            raise StatementError(str(error)) from None
        return list(map(tuple, points.tolist())), curvature

    def _circle(self, values: list[str], number: int) -> None:
        if "TIMES" in values:
            raise StatementError("CIRCLE/ of several turns; let the CAM output each turn, or GOTO moves")
        numbers = [_number(v) for v in values]
        if len(numbers) not in (7, 11):
            raise StatementError("CIRCLE/ needs x, y, z, i, j, k, r, and in NX four numbers more")
        if abs(abs(numbers[5]) - 1) > 1e-6:
            raise StatementError("CIRCLE/ about an axis that is not z; let the CAM output GOTO moves")
        if self.position is None:
            raise StatementError("CIRCLE/ before a first GOTO/")
        self.circle = numbers, number

    def _from(self, values: list[str], number: int) -> None:
        self.rapid = True
        self._goto(values, number)

    def _delta(self, values: list[str], number: int) -> None:
        numbers = [_number(v) * self.unit for v in values]
        if len(numbers) == 1:
            numbers = [0.0, 0.0, *numbers]
        if len(numbers) != 3 or self.position is None:
            raise StatementError("GODLTA/ needs dx, dy, dz after a first GOTO/")
        self._move(tuple(p + d for p, d in zip(self.position, numbers, strict=True)), number)

    def _home(self, values: list[str], number: int) -> None:
        self.seen.silent["GOHOME"] += 1
        if self.position is not None:
            self.position = (*self.position[:2], TOP)
            self.recorder.rapid(self.position, number)

    def _rapid(self, values: list[str], number: int) -> None:
        self.rapid = True

    def _end(self, values: list[str], number: int) -> None:
        self.ended = True

    # --- settings ---

    def _feed(self, values: list[str], number: int) -> None:
        units = [v for v in values if v in FEEDS]
        rest = [v for v in values if v not in FEEDS]
        if len(rest) != 1 or len(units) > 1:
            raise StatementError("FEDRAT/ needs one number and, if any, MMPM, IPM, MMPR or IPR")
        length, per_turn = FEEDS[units[0]] if units else (None, False)
        feed = _number(rest[0]) * (length or self.unit) / (1 if per_turn else 60)
        if not 0 <= feed <= REACH:
            raise StatementError(f"the feed {short(rest[0])} must lie between 0 and {REACH:g} m/s")
        self.feed = feed
        self.per_turn = per_turn
        self.rapid = False

    def _spindle(self, values: list[str], number: int) -> None:
        sense = 1
        for value in values:
            if value in ("ON", "RPM", "CLW", "LOW", "MEDIUM", "HIGH", "AUTO", "RANGE"):
                continue
            if value == "OFF":
                self.path.spindle_speed = 0.0
                return
            if value == "CCLW":
                sense = -1
                continue
            if value[:1].isalpha():
                raise StatementError(f"SPINDL/{short(value)} is not supported (ON, OFF, a number, RPM, CLW, CCLW are)")
            self.speed = _number(value) * 2 * math.pi / 60
            if not 0 <= self.speed <= 1e6:
                raise StatementError(f"the spindle speed {short(value)} is out of range")
        self.path.spindle_speed = sense * self.speed

    def _units(self, values: list[str], number: int) -> None:
        if len(values) != 1 or values[0] not in LENGTHS:
            raise StatementError(f"UNITS/ needs MM or INCHES, not {short(','.join(values))!r}")
        self.unit = self.seen.unit = LENGTHS[values[0]]

    def _load(self, values: list[str], number: int) -> None:
        """LOADTL/1, TOOLNO/1,..., LOAD/TOOL,1"""
        name = next((value for value in values if value.lstrip("+").isdigit()), "")
        if name:
            self.numbered = True
            self.change_tool(f"T{int(name)}", number)

    def change_tool(self, name: str, number: int) -> None:
        """The tool of the moves that follow."""
        if name == self.tool:
            return
        if self.tool or len(self.path):
            self.recorder.away = True
        self.tool = self.refusals.tool = name
        self.seen.tools.setdefault(name, number)
        self.recorder.active = self.seen.selected in ("", name)

    def _cutter(self, values: list[str], number: int) -> None:
        """CUTTER/d, r, ... and TLDATA/MILL, d, ... say the diameter."""
        self.seen.silent["CUTTER"] += 1
        sizes = [value for value in values if not value[:1].isalpha()]
        if sizes and 0 < _number(sizes[0]) * self.unit <= 0.2:
            self.seen.known[self.tool] = ProgramTool(self.tool, diameter=_number(sizes[0]) * self.unit)

    def _axes(self, values: list[str], number: int) -> None:
        """MULTAX/ON only lets axes be written; a tilted one is refused where the path is checked."""
        self.seen.silent["MULTAX"] += 1

    def _compensation(self, values: list[str], number: int) -> None:
        if values and values[0] not in ("OFF", "ADJUST", "ON"):
            self.refusals.add(number, "CUTCOM", advice="let the CAM output the path of the tool's centre")
        else:
            self.seen.silent["CUTCOM"] += 1

    def _system(self, values: list[str], number: int) -> None:
        """MSYS/: the coordinates are counted from one system of the machine, whichever it is."""
        if values != self.system and (self.system is not None or self.position is not None):
            raise StatementError("a second MSYS/; let the CAM output coordinates of one system")
        self.system = values
        self.seen.silent["MSYS"] += 1


def _number(text: str) -> float:
    try:
        value = float(text) if text.isascii() and "_" not in text else math.nan
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise StatementError(f"{short(text)!r} is not a finite number")
    return value


def _tool_axis(axis: list[float]) -> tuple[float, float, float, float]:
    length = math.hypot(*axis)
    if not abs(length - 1) < 1e-3:
        raise StatementError(f"the tool axis has the length {length:g} instead of 1")
    i, j, k = (v / length for v in axis)
    if k < -0.999:
        raise StatementError(f"the tool comes from below; {AXES5}")
    turn = Rotation.from_quat([-j, i, 0.0, 1 + k])  # the shortest from z to the axis
    return tuple((turn * Rotation.from_quat(TOOL_DOWN)).as_quat(canonical=True).tolist())
