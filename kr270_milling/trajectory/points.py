"""Points from CSV: x, y, z[, a, b, c], feed, each column named with its unit in the header."""

from __future__ import annotations

import math

from kr270_milling.base.errors import InputError
from kr270_milling.base.frames import quaternion_from_rotation, rotation_from_abc
from kr270_milling.base.record import UNITS
from kr270_milling.trajectory.files import ends_in_mid_line, read_lines, short
from kr270_milling.trajectory.path_builder import PathBuilder
from kr270_milling.trajectory.toolpath import REACH, Toolpath

__all__ = ["read_points"]

COLUMNS = {"x": ("m", "mm", "um"), "y": ("m", "mm", "um"), "z": ("m", "mm", "um"), "a": ("deg",), "b": ("deg",),
           "c": ("deg",), "feed": ("mm_per_min", "m_per_min", "mm_per_s", "m_per_s")}  # fmt: skip
EXAMPLE = "x_mm,y_mm,z_mm,feed_mm_per_min or x_mm,y_mm,z_mm,a_deg,b_deg,c_deg,feed_mm_per_min"


def read_points(path) -> Toolpath:
    """Read a CSV of points; a, b, c are KUKA angles of tool0 in the workpiece frame; the feed leads to its point."""
    lines = read_lines(path)
    ends_in_mid_line(path, lines)
    names, scales = _header(path, lines[0])
    builder = PathBuilder(path)
    for number, line in enumerate(lines[1:], 2):
        if not line.strip():
            continue
        values = dict(zip(names, _row(path, number, line, scales), strict=True))
        point = values["x"], values["y"], values["z"]
        if not max(map(abs, point)) <= REACH:
            raise InputError(path, f"the point lies more than {REACH:g} m away; wrong unit?", number)
        if not 0 < values["feed"] <= REACH:
            raise InputError(path, "zero feed" if values["feed"] == 0 else "the feed is out of range", number)
        if "a" in values:
            rotation = rotation_from_abc([values["a"], values["b"], values["c"]])
            builder.quaternion = tuple(quaternion_from_rotation(rotation).tolist())
        builder.move(point, values["feed"], len(builder) == 0, number)
    return builder.build(len(lines))


def _header(path, line: str) -> tuple[list[str], list[float]]:
    names, scales = [], []
    for column in line.split(","):
        name, _, unit = column.strip().lower().partition("_")
        if unit not in COLUMNS.get(name, ()) or name in names:
            raise InputError(
                path, f"the header must name columns with units ({EXAMPLE}), not {short(column.strip())!r}", 1
            )
        names.append(name)
        scales.append(UNITS[unit])
    if set(names) not in ({"x", "y", "z", "feed"}, set(COLUMNS)):
        raise InputError(path, f"the header must be {EXAMPLE}", 1)
    return names, scales


def _row(path, number: int, line: str, scales: list[float]) -> list[float]:
    fields = line.split(",")
    if len(fields) != len(scales):
        raise InputError(path, f"has {len(fields)} values where the header has {len(scales)}", number)
    values = []
    for field, scale in zip(fields, scales, strict=True):
        try:
            value = float(field) * scale if "_" not in field else math.nan
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise InputError(path, f"{short(field.strip())!r} is not a finite number", number)
        values.append(value)
    return values
