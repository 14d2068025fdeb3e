"""One door for all tool path files, by the end of their names."""

from __future__ import annotations

from pathlib import Path

from kr270_milling.base.errors import InputError
from kr270_milling.trajectory.apt import read_apt
from kr270_milling.trajectory.gcode import read_gcode
from kr270_milling.trajectory.points import read_points
from kr270_milling.trajectory.toolpath import Toolpath

__all__ = ["read_toolpath", "SUFFIXES"]

SUFFIXES = {".nc": read_gcode, ".gcode": read_gcode, ".ngc": read_gcode, ".tap": read_gcode, ".apt": read_apt,
            ".cl": read_apt, ".csv": read_points}  # fmt: skip


def read_toolpath(path) -> Toolpath:
    """Read G-code, APT/CL or a CSV of points; raises InputError with the line number."""
    reader = SUFFIXES.get(Path(path).suffix.lower())
    if reader is None:
        raise InputError(path, f"is no tool path by its name; known are {', '.join(SUFFIXES)}")
    return reader(path)
