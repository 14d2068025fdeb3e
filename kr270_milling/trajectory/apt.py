"""APT/CL in: GOTO/, FROM/, RAPID, FEDRAT/, SPINDL/, UNITS/, PARTNO, $$ comments, FINI.

Words that move nothing (CUTTER, COOLNT, LOADTL, ...) are read over; CIRCLE, CUTCOM, MSYS and all others are refused
with their line. Without UNITS/ the unit is mm. A comment or PPRINT of one word, as ``$$ circle``, names the feature
that follows. A tool axis i, j, k points from the tip to the spindle; the tool turns about no more than it must.
"""

from __future__ import annotations

import math
import re

from scipy.spatial.transform import Rotation

from kr270_milling.base.errors import InputError
from kr270_milling.trajectory.files import ends_in_mid_line, read_lines, short
from kr270_milling.trajectory.path_builder import PathBuilder
from kr270_milling.trajectory.toolpath import REACH, Toolpath
from kr270_milling.trajectory.trajectory import TOOL_DOWN

__all__ = ["read_apt"]

#: words without effect on the path
SILENT = {"PARTNO", "REMARK", "MACHIN", "CUTTER", "LOADTL", "TLDATA", "TOOLNO", "COOLNT", "MULTAX", "DISPLY", "PAINT",
          "PPRINT", "INTOL", "OUTTOL", "END-OF-PATH"}  # fmt: skip
LENGTHS = {"MM": 1e-3, "INCHES": 0.0254, "INCH": 0.0254, "IN": 0.0254}
FEEDS = {"MMPM": 1e-3 / 60, "IPM": 0.0254 / 60}
WORD = re.compile(r"[A-Z][A-Z0-9-]*")
FEATURE = re.compile(r"[A-Za-z][\w-]{0,39}")


def read_apt(path) -> Toolpath:
    """Read an APT source or CL text file."""
    lines = read_lines(path)
    reader = _Reader(path)
    held, first = "", 0
    body = lines if lines[-1].strip() else lines[:-1]
    for number, line in enumerate(body, 1):
        code, comment, note = line.partition("$$")
        if comment and not code.strip() and FEATURE.fullmatch(note.strip()):
            reader.path.name_feature(note.strip())
        first = first if held else number
        held += code.strip()
        if held.endswith("$") and not comment:  # the statement goes on in the next line
            held = held[:-1]
            continue
        if held:
            reader.read(held, first)
        held = ""
        if reader.ended:
            break
    else:
        if held:
            raise InputError(path, "the file ends in a statement that is continued with $", len(body))
        ends_in_mid_line(path, lines)
    return reader.path.build(len(lines))


class _Reader:
    def __init__(self, source):
        self.source = source
        self.path = PathBuilder(source)
        self.unit = LENGTHS["MM"]
        self.feed: float | None = None
        self.rapid, self.ended = False, False
        self.speed = 0.0

    def refuse(self, reason: str, number: int):
        raise InputError(self.source, reason, number)

    def read(self, statement: str, number: int) -> None:
        head, slash, tail = statement.partition("/")
        word = head.split()[0].upper() if head.split() else ""
        if word in SILENT:
            name = (tail or head.partition(" ")[2]).strip()
            if word == "PPRINT" and FEATURE.fullmatch(name):
                self.path.name_feature(name)
            return
        word = head.strip().upper()
        values = [v.strip().upper() for v in tail.split(",")] if slash else []
        actions = {"GOTO": self._goto, "FROM": self._goto, "FEDRAT": self._feed, "SPINDL": self._spindle,
                   "UNITS": self._units}  # fmt: skip
        if word in actions:
            actions[word](values, number)
        elif word == "RAPID":
            self.rapid = True
        elif word == "FINI":
            self.ended = True
        elif WORD.fullmatch(word):
            self.refuse(f"{short(word)} is not supported", number)
        else:
            self.refuse(f"{short(statement)!r} is no APT statement", number)

    def _number(self, text: str, number: int) -> float:
        try:
            value = float(text) if text.isascii() and "_" not in text else math.nan
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            self.refuse(f"{short(text)!r} is not a finite number", number)
        return value

    def _goto(self, values: list[str], number: int) -> None:
        numbers = [self._number(v, number) for v in values]
        if len(numbers) not in (3, 6):
            self.refuse(f"GOTO/ needs x, y, z or x, y, z, i, j, k, not {len(numbers)} numbers", number)
        x, y, z = (v * self.unit for v in numbers[:3])
        if not max(abs(x), abs(y), abs(z)) <= REACH:
            self.refuse(f"the point lies more than {REACH:g} m away; wrong unit?", number)
        if len(numbers) == 6:
            self.path.quaternion = self._tool_axis(numbers[3:], number)
        starting = len(self.path) == 0
        if not (self.feed or self.rapid or starting):
            self.refuse(
                "a cutting move without FEDRAT/" if self.feed is None else "zero feed on a cutting move", number
            )
        self.path.move((x, y, z), self.feed or 0.0, self.rapid or starting, number)
        self.rapid = False  # RAPID holds for one move

    def _tool_axis(self, axis: list[float], number: int) -> tuple[float, float, float, float]:
        length = math.hypot(*axis)
        if not abs(length - 1) < 1e-3:
            self.refuse(f"the tool axis has the length {length:g} instead of 1", number)
        i, j, k = (v / length for v in axis)
        if k < -0.999:
            self.refuse("the tool comes from below", number)
        turn = Rotation.from_quat([-j, i, 0.0, 1 + k])  # the shortest from z to the axis
        return tuple((turn * Rotation.from_quat(TOOL_DOWN)).as_quat(canonical=True).tolist())

    def _feed(self, values: list[str], number: int) -> None:
        units = [v for v in values if v in FEEDS]
        rest = [v for v in values if v not in FEEDS]
        if len(rest) != 1 or len(units) > 1:
            self.refuse("FEDRAT/ needs one number and, if any, MMPM or IPM", number)
        feed = self._number(rest[0], number) * (FEEDS[units[0]] if units else self.unit / 60)
        if not 0 <= feed <= REACH:
            self.refuse(f"the feed {short(rest[0])} must lie between 0 and {REACH:g} m/s", number)
        self.feed, self.rapid = feed, False

    def _spindle(self, values: list[str], number: int) -> None:
        for value in values:
            if value in ("ON", "RPM", "CLW"):
                continue
            if value == "OFF":
                self.path.spindle_speed = 0.0
                return
            if WORD.fullmatch(value):
                self.refuse(f"SPINDL/{short(value)} is not supported (ON, OFF, a number, RPM, CLW are)", number)
            self.speed = self._number(value, number) * 2 * math.pi / 60
            if not 0 <= self.speed <= 1e6:
                self.refuse(f"the spindle speed {short(value)} is out of range", number)
        self.path.spindle_speed = self.speed

    def _units(self, values: list[str], number: int) -> None:
        if len(values) != 1 or values[0] not in LENGTHS:
            self.refuse(f"UNITS/ needs MM or INCHES, not {short(','.join(values))!r}", number)
        self.unit = LENGTHS[values[0]]
