"""One door for all tool path files, by the end of their names."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from kr270_milling.base.errors import InputError
from kr270_milling.trajectory.apt import read_apt
from kr270_milling.trajectory.gcode import read_gcode
from kr270_milling.trajectory.points import read_points
from kr270_milling.trajectory.toolpath import Toolpath

__all__ = ["read_toolpath", "SUFFIXES"]


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
