"""The stage of one tool in a program with several tools: what the other tools remove, before and after."""

from __future__ import annotations

import functools
import math
import re
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from kr270_milling.base.errors import MillingError
from kr270_milling.cell.paths import UPRIGHT
from kr270_milling.path.toolpath import Toolpath
from kr270_milling.physics.cutting import AL7075_T6, CutModel, Cutting, EngagementCut, Stock, Tool


@dataclass(frozen=True, eq=False)
class Removal:
    """Material that a tool removes: all material above its profile along its path; workpiece frame."""

    tool: str  #: name in the program
    radius: float  #: [m], of the longest tooth
    programmed: np.ndarray  #: tool tip along the programmed path [m], (n, 3)
    actual: np.ndarray  #: tool tip in the simulated pass [m], (m, 3); the programmed path where no pass was simulated
    spring_back: float = 0.0  #: [m], largest deflection while the tool cuts
    cutter: Tool | None = None  #: its profile; None: a flat end
    few: np.ndarray | None = None  #: places of ``actual`` for quick passes, as far apart as programmed ones; None: all

    @property
    def quick(self) -> Removal:
        """The removal for the many passes of simulated robots, which sweep it on another stock each."""
        return self if self.few is None else replace(self, actual=self.few)


@dataclass(frozen=True)
class Stage:
    """The tool of a cell in a program with several tools."""

    tool: str  #: name in the program
    number: int  #: in the order of the program, from 1
    count: int  #: number of tools
    earlier: tuple[Removal, ...] = ()  #: in the order of the program
    later: tuple[Removal, ...] = ()
    same_tip: bool = False  #: the mount of an earlier tool has the same tip

    @property
    def suffix(self) -> str:
        """Suffix of file and program names: ``_T2``; ``_N2`` where the tool has no short number."""
        return f"_{self.tool}" if re.fullmatch(r"T[0-9]{1,2}", self.tool) else f"_N{self.number}"

    def __str__(self) -> str:
        return f"tool {self.tool}, {self.number} of {self.count}"


def places_apart(radius: float) -> float:
    """Distance of two places of a path along which a tool removes material [m]; radius: of the tool [m]."""
    places_per_radius = 50  # between two places R / 20000 stays at the side
    farthest = 1e-4  # [m]: on an arc of 1 mm the chord misses 1.3 um
    return min(radius / places_per_radius, farthest)


def removal_along(name: str, tool: Tool, path: Toolpath) -> Removal:
    """Return what a tool removes on its programmed path."""
    tilt = path.cutting_tilt
    if tilt > UPRIGHT:
        reason = f"tool {name} is tilted by {math.degrees(tilt):.4g} deg, but several tools must be upright"
        raise MillingError(f"{reason}: split the program at the change of the tool")
    radius, length = float(tool.radii.max()), path.length
    most_places = 1_000_000
    count = 2 + min(most_places, int(length / places_apart(radius)))
    distance = np.union1d(np.linspace(0.0, length, count), np.cumsum(path.block_length))
    position = path.position_at(distance)
    if tool.type == "program" and path.program.current and path.program.current.kind == "drill":
        point = math.radians(59.0)  # half the angle of a twist drill of type N, DIN 1836
        tool = tool.replace(type="tapered", taper=point)
    return Removal(name, radius, position, position, cutter=tool)


@functools.lru_cache(maxsize=6)
def cleared(removals: tuple[Removal, ...], stock: Stock, actual: bool) -> CutModel:
    """Return ``swept``; the next pass on the same stock takes the same map."""
    return swept(removals, stock, actual)


def swept(removals: tuple[Removal, ...], stock: Stock, actual: bool) -> CutModel:
    """Return the stock after other tools, on the grid of ``stock``; actual: along their passes, else as programmed.

    Raises MillingError.
    """
    cut = _still(removals[0], stock)
    for removal in removals:
        each = _still(removal, stock)
        each.continue_from(cut)
        tip = removal.actual if actual else removal.programmed
        each.along(tip, np.zeros(len(tip), np.int64))  # the spindle does not turn: no force is computed
        cut = each
    return cut


def _still(removal: Removal, stock: Stock) -> EngagementCut:
    """A fresh workpiece, and the tool without its teeth."""
    tool = Tool(diameter=2.0 * removal.radius, teeth=1)
    if removal.cutter is not None and not removal.cutter.has_flat_end:
        tool = removal.cutter
    law: dict[str, Any] = {"linear_edge": AL7075_T6}  # of no effect: the spindle does not turn
    return EngagementCut(tool, Cutting(law="linear_edge", **law), stock, math.radians(1.0))
