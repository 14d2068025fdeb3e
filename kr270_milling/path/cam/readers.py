"""The readers of all tool path files, by the end of their names; and the reader of points in a CSV table."""

from __future__ import annotations

import functools
import importlib
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from kr270_milling.base.errors import InputError, RecordingError
from kr270_milling.base.extensions import registered
from kr270_milling.base.frames import quaternion_from_rotation, rotation_from_abc
from kr270_milling.base.parameter_file import find_file
from kr270_milling.base.record import UNITS
from kr270_milling.base.table import read_table
from kr270_milling.path.cam.gcode import ENDINGS
from kr270_milling.path.kinematics import NO_ROTARY_AXES, Kinematics
from kr270_milling.path.source_program import ProgramError, SourceProgram
from kr270_milling.path.timing import TimedPath
from kr270_milling.path.toolpath import REACH, PathBuilder, Toolpath
from kr270_milling.path.trajectory import tool_along

LENGTHS, FEEDS = ("m", "mm", "um"), ("mm_per_min", "m_per_min", "mm_per_s", "m_per_s")
UNITS_OF = dict.fromkeys("xyz", LENGTHS) | dict.fromkeys("abc", ("deg",)) | {"feed": FEEDS}
COLUMNS = {f"{name}_{unit}": (name, UNITS[unit]) for name, units in UNITS_OF.items() for unit in units}
COLUMNS |= {name: (name, 1.0) for name in "ijk"}


def read_points(path) -> Toolpath:
    """Read a CSV of points; the feed leads to its point.

    a, b, c are KUKA angles of tcp in the workpiece frame; i, j, k are the tool axis from tip to holder, ``tool_along``.
    """
    headers = [f"x_mm,y_mm,z_mm,{turn}feed_mm_per_min" for turn in ("", "a_deg,b_deg,c_deg,", "i,j,k,")]
    table = read_table(path, COLUMNS, whole=True)
    names, scales = zip(*(COLUMNS[name] for name in table.names), strict=True)
    if sorted(names) not in [sorted(COLUMNS[name][0] for name in header.split(",")) for header in headers]:
        raise InputError(path, f"the header must be {' or '.join(headers)}", 1)
    builder = PathBuilder(path)
    for number, row in zip(table.lines, (table.numbers(table.names) * scales).tolist(), strict=True):
        values = dict(zip(names, row, strict=True))
        point = values["x"], values["y"], values["z"]
        if not max(map(abs, point)) <= REACH:
            raise InputError(path, f"the point lies more than {REACH:g} m away; wrong unit?", number)
        if not 0 < values["feed"] <= REACH:
            raise InputError(path, "zero feed" if values["feed"] == 0 else "the feed is out of range", number)
        if "a" in values:
            rotation = rotation_from_abc([values["a"], values["b"], values["c"]])
            builder.quaternion = tuple(quaternion_from_rotation(rotation).tolist())
        elif "i" in values:
            try:
                builder.quaternion = tool_along([values["i"], values["j"], values["k"]])
            except ValueError as fault:
                raise InputError(path, str(fault), number) from None
        builder.move(point, values["feed"], len(builder) == 0, number)
    _, length, _, time = next(name for name in table.names if name.startswith("feed")).split("_")
    unit = f"{length} a {'second' if time == 's' else 'minute'}"
    return builder.build(SourceProgram(feed_units=(unit,)))


@dataclass(frozen=True)
class PathReader:
    """The function that reads one kind of file; its module is imported when a file of that kind is read."""

    module: str
    function: str
    options: tuple[str, ...] = ()  #: keywords of the function, named as the keys of ``path``

    @property
    def recorded(self) -> bool:
        """Return whether the file is a recording: a topic of several, and no program."""
        return "topic" in self.options

    def read(self, path, **options) -> Toolpath | TimedPath:
        try:
            function = getattr(importlib.import_module(self.module), self.function)
        except (ImportError, AttributeError, SyntaxError) as error:
            raise InputError(path, f"its reader {self.module}:{self.function} cannot be imported ({error})") from None
        try:
            return function(path, **options)
        except UnicodeDecodeError:
            raise InputError(path, "is not UTF-8 text") from None


GCODE = PathReader("kr270_milling.path.cam.gcode.reader", "read_gcode", ("tool", "feed", "offsets", "machine"))
APT = PathReader("kr270_milling.path.cam.apt", "read_apt", ("tool", "feed"))
#: the reader of each kind of file, by the end of the name; ``cell.sections`` adds recordings, which are above this room
READERS: dict[str, PathReader] = {
    **dict.fromkeys(ENDINGS, GCODE),
    **dict.fromkeys((".apt", ".cl", ".cls", ".aptsource", ".ncl"), APT),
    ".h": PathReader("kr270_milling.path.cam.heidenhain", "read_heidenhain", ("tool", "feed", "machine")),
    ".src": PathReader("kr270_milling.path.cam.krl", "read_krl_program", ("tool", "feed")),
    ".csv": PathReader("kr270_milling.path.cam.readers", "read_points"),
}


@functools.cache
def _plugged() -> dict[str, PathReader]:
    """Return the readers of other packages, each imported when a file of its kind is read; raises ConfigError."""
    return {point.name.lower(): PathReader(point.module, point.attr) for point in registered("readers", READERS)}


def readers() -> dict[str, PathReader]:
    """Return READERS and the readers of other packages; raises ConfigError."""
    return READERS | _plugged()


def known_reader(path) -> PathReader | None:
    """Return the reader of a file by its name, None for an unknown kind; Creo numbers its versions: op010.ncl.1."""
    known, suffixes = readers(), [suffix.lower() for suffix in Path(path).suffixes]
    while len(suffixes) > 1 and suffixes[-1] not in known and suffixes[-1][1:].isdigit():
        suffixes.pop()
    return known.get(suffixes[-1]) if suffixes else None


def reader_of(path) -> PathReader:
    """Return the reader of a file by its name; raise InputError for an unknown kind."""
    reader = known_reader(path)
    if reader is None:
        raise InputError(path, f"is no tool path by its name; known are {', '.join(readers())}")
    return reader


def find_tool_path(name: str, beside: Path = Path()) -> Path:
    """Return a tool path file: beside another file, a shipped one, or the file in the directory of a recording.

    Raises ConfigError, RecordingError.
    """
    if not os.path.isdir(beside / name):
        return find_file(name, beside)
    files = sorted(path for path in (beside / name).iterdir() if path.suffix == ".mcap")
    if len(files) != 1:
        raise RecordingError(beside / name, f"holds {len(files)} MCAP files where a recording has one")
    return files[0]


def read_path_file(
    path,
    tool: str = "",
    topic: str = "",
    feed: float = 0.0,
    offsets: Sequence[float] = (),
    machine: Kinematics = NO_ROTARY_AXES,
) -> Toolpath | TimedPath:
    """Read a program, a CSV of points or a recording; raise InputError with the line number, or RecordingError.

    tool: "T1", of a program with several; topic: of a recording with several paths; feed [m/s]: for a file without
    feed, 0 for none; offsets [m]: x, y, z of the work offsets G54, G55 ... of G-code in the workpiece frame; machine:
    for A, B, C of G-code and Heidenhain.
    """
    reader = reader_of(path)
    if len(offsets) and "offsets" not in reader.options:
        raise InputError(path, f"a {Path(path).suffix} file has no work offsets G54 to G59.3")
    if tool and "tool" not in reader.options:
        raise InputError(path, f"a {Path(path).suffix} file has no tools, so {tool} cannot be chosen")
    options = {"tool": tool, "topic": topic, "feed": feed, "offsets": offsets, "machine": machine}
    return reader.read(path, **{name: options[name] for name in reader.options})


def read_toolpath(path, tool: str = "", feed: float = 0.0, machine: Kinematics = NO_ROTARY_AXES) -> Toolpath:
    """Read the tool path of a CAM program or of a CSV of points, as ``read_path_file``."""
    recorded = reader_of(path).recorded
    toolpath = None if recorded else read_path_file(path, tool, feed=feed, machine=machine)
    if not isinstance(toolpath, Toolpath):
        raise InputError(path, "is a recording, not a program")
    return toolpath


def read_toolpaths(path, tool: str = "", machine: Kinematics = NO_ROTARY_AXES) -> list[Toolpath]:
    """Read the tool paths of all tools that a CAM program cuts with, in its order, or of one.

    Raises as ``read_toolpath``.
    """
    try:
        return [read_toolpath(path, tool, machine=machine)]
    except ProgramError as error:
        names = [known.name for known in error.program.tools if known.cuts]
        if tool or len(names) < 2 or not all(names):
            raise
    return [read_toolpath(path, name, machine=machine) for name in names]
