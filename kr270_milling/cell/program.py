"""YAML ``program``: how the robot programs are written."""

from __future__ import annotations

import re
from dataclasses import dataclass

from kr270_milling.base.errors import ParameterError
from kr270_milling.base.record import Record, parameter

__all__ = ["Program"]


@dataclass(frozen=True, eq=False)
class Program(Record):
    """How the robot programs are written."""

    name: str = parameter("MILLING", text="module name, to which _ORG_001 and the like are added")
    motion: str = parameter("SPLINE", choices=("SPLINE", "LIN"), text="SPL segments in SPLINE blocks, or LIN")
    line_limit: int = parameter(1400, low=100, high=100000, text="most lines of a .src or .dat file")
    blend_distance: float = parameter(1e-3, unit="mm", low=0.0, high=100.0, text="$APO.CDIS of LIN motions")
    point_spacing: float = parameter(1e-5, unit="mm", above=0.0, high=10.0, text="closer points are left out")
    approach_speed_percent: int = parameter(10, low=1, high=100, text="axis speed of the PTP to the first point")

    def check(self) -> None:
        if not re.fullmatch(r"[A-Z][A-Z0-9_]{0,15}", self.name):  # with _ORG_001 the 24 characters of a KRL name
            allowed = "1 to 16 characters of A-Z, 0-9 and _, the first a letter"
            raise ParameterError("name", self.name, allowed)
