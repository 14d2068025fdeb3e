"""YAML ``program``: how the robot programs are written."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from kr270_milling.base.errors import ParameterError
from kr270_milling.base.record import Record, parameter

__all__ = ["Program"]

TEMPLATES = ("spindle_on", "spindle_off", "coolant_on", "coolant_off")


@dataclass(frozen=True, eq=False)
class Program(Record):
    """Names, motions and the machine's own commands of the robot programs."""

    name: str = parameter("MILLING", text="module name, to which _ORG_001 and the like are added")
    motion: str = parameter("SPLINE", choices=("SPLINE", "LIN"), text="SPL segments in SPLINE blocks, or LIN")
    line_limit: int = parameter(1400, low=100, high=100000, text="most lines of a .src or .dat file")
    blend_distance: float = parameter(1e-3, unit="mm", low=0.0, high=100.0, text="$APO.CDIS of LIN motions")
    point_spacing: float = parameter(1e-5, unit="mm", above=0.0, high=10.0, text="closer points are left out")
    approach_speed_percent: int = parameter(10, low=1, high=100, text="axis speed of the PTP motions")
    approach_feed: float = parameter(0.05, unit="m_per_min", above=0.0, high=60.0, text="down to the first point")
    safe_height: float = parameter(
        0.05, unit="mm", low=0.0, high=2000.0, text="of approach and retract above the stock's top"
    )
    home: str = parameter("XHOME", text="axis position before and after: that of $CONFIG.DAT, or home_deg")
    home_angles: np.ndarray = parameter(
        [], unit="deg", low=-720.0, high=720.0, text="axis position that is declared as ``home``; empty: not declared"
    )
    spindle_on: tuple[str, ...] = parameter((), text="KRL lines, for example $OUT[1]=TRUE")
    spindle_off: tuple[str, ...] = parameter((), text="KRL lines")
    coolant_on: tuple[str, ...] = parameter((), text="KRL lines")
    coolant_off: tuple[str, ...] = parameter((), text="KRL lines")
    spindle_run_up: float = parameter(3.0, unit="s", low=0.0, high=600.0, text="dwell after the spindle is started")
    tool_number: int = parameter(0, low=0, high=64, text="$TOOL=TOOL_DATA[n]; 0: by value")
    base_number: int = parameter(0, low=0, high=64, text="$BASE=BASE_DATA[n]; 0: by value")
    set_load: bool = parameter(False, text="whether the program sets $LOAD, or a comment says what to set")

    def check(self) -> None:
        if not re.fullmatch(r"[A-Z][A-Z0-9_]{0,15}", self.name):  # with _ORG_001 the 24 characters of a KRL name
            allowed = "1 to 16 characters of A-Z, 0-9 and _, the first a letter"
            raise ParameterError("name", self.name, allowed)
        if not re.fullmatch(r"[A-Z$][A-Z0-9_$]{0,23}", self.home):
            raise ParameterError("home", self.home, "the name of an axis position, A-Z, 0-9, _ and $")
        if self.home_angles.size not in (0, 6):
            raise ParameterError("home_angles_deg", np.degrees(self.home_angles).tolist(), "empty or six angles")
        for key in TEMPLATES:
            for line in getattr(self, key):
                if not re.fullmatch(r"[ -~]{1,200}", line):
                    raise ParameterError(key, line, "lines of 1 to 200 printable ASCII characters")
