"""One door for all tool path files, by the end of their names; and the reader of points in a CSV table."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from kr270_milling.base.errors import InputError
from kr270_milling.base.frames import quaternion_from_rotation, rotation_from_abc
from kr270_milling.base.record import UNITS
from kr270_milling.base.table import read_table
from kr270_milling.trajectory.apt.reader import read_apt
from kr270_milling.trajectory.gcode.reader import read_gcode
from kr270_milling.trajectory.toolpath import REACH, PathBuilder, Toolpath

__all__ = ["SUFFIXES", "read_points", "read_toolpath"]

LENGTHS, FEEDS = ("m", "mm", "um"), ("mm_per_min", "m_per_min", "mm_per_s", "m_per_s")
UNITS_OF = dict.fromkeys("xyz", LENGTHS) | dict.fromkeys("abc", ("deg",)) | {"feed": FEEDS}
COLUMNS = {f"{name}_{unit}": (name, UNITS[unit]) for name, units in UNITS_OF.items() for unit in units}
EXAMPLE = "x_mm,y_mm,z_mm,feed_mm_per_min or x_mm,y_mm,z_mm,a_deg,b_deg,c_deg,feed_mm_per_min"


def read_points(path) -> Toolpath:
    """Read a CSV of points; a, b, c are KUKA angles of tool0 in the workpiece frame; the feed leads to its point."""
    table = read_table(path, COLUMNS, whole=True)
    names, scales = zip(*(COLUMNS[name] for name in table.names), strict=True)
    if sorted(names) not in (sorted({"x", "y", "z", "feed"}), sorted(UNITS_OF)):
        raise InputError(path, f"the header must be {EXAMPLE}", 1)
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
        builder.move(point, values["feed"], len(builder) == 0, number)
    return builder.build()


GCODE = (".nc", ".gcode", ".ngc", ".tap", ".cnc", ".mpf", ".spf", ".ncc", ".eia", ".iso", ".txt")
APT = (".apt", ".cl", ".cls", ".aptsource", ".ncl")
SUFFIXES: dict[str, Callable[..., Toolpath]] = (
    dict.fromkeys(GCODE, read_gcode) | dict.fromkeys(APT, read_apt) | {".csv": read_points}
)


def read_toolpath(path, tool: str = "", feed: float = 0.0) -> Toolpath:
    """Read G-code, APT/CL or a CSV of points; raises InputError with the line number.

    tool: "T1", of a program with several; feed [m/s]: for a program that names none, 0 for none.
    """
    reader = SUFFIXES.get(Path(path).suffix.lower())
    if reader is None:
        raise InputError(path, f"is no tool path by its name; known are {', '.join(SUFFIXES)}")
    if reader is read_points:
        if tool:
            raise InputError(path, f"a CSV of points has no tools, so {tool} cannot be chosen")
        return reader(path)
    return reader(path, tool=tool, feed=feed)
