"""Slots of a leaning tool: each with one collision whose depth is a closed form, and beside it, sound.

The stock is 16 x 140 x 15 mm, its top at z = 0; the slot is 4 mm deep along x. The tip is at z. The circle of the
radius r at the height h of an axis with the sine s and the cosine c of its tilt meets what is below z_1 if
h < (z_1 - z + r s) / c.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from kr270_milling.base.parameter_file import find_file
from kr270_milling.cell.cell import Cell
from kr270_milling.cell.cell_file import read_cell
from kr270_milling.physics.cutting import Tool
from kr270_milling.physics.cutting.profile import outline

DEPTH, AWAY, OVER = 4.0, 40.0, 2.0  # [mm], of the slot; of the start along the axis; of a collision
SHAPES = {"ball": 0.0, "flat": 0.0, "bull_nose": 1.0}  # corner radius [mm]
TILTS = [(0, 15), (15, 0), (20, 30), (10, -45), (30, 20), (30, 0), (5, 5), (0, 60)]  # [deg] lead along x, lean to y
RADIUS = 12.0  # [mm] of shank and holder
SOUND = "R:away R:start F:end R:over"


@dataclass(frozen=True)
class Collision:
    """One row of the table: kind, value [mm] (None: any), settings that collide and settings that do not."""

    kind: str
    value: float | None
    settings: tuple[str, ...] = ()
    sound: tuple[str, ...] = ()
    moves: str = SOUND  #: that collide
    words: str = ""


class Slot:
    """A slot of a tool of 10 mm of a shape, tilted by lead and lean [deg]."""

    def __init__(self, shape: str, tilt):
        self.shape, (lead, lean) = shape, np.radians(tilt)
        self.axis = np.array([math.sin(lead), math.cos(lead) * math.sin(lean), math.cos(lead) * math.cos(lean)])
        self.s, self.c = math.hypot(*self.axis[:2]), self.axis[2]
        tool = Tool(diameter=10e-3, teeth=2, type=shape, corner_radius=1e-3 * SHAPES[shape])
        self.z = -DEPTH - 1e3 * min(h * self.c - r * self.s for r, h in outline(tool))

    def height(self, radius: float, level: float = 0.0) -> float:
        """Return the height on the axis up to which a circle meets what is below a level [mm]."""
        return (level - self.z + radius * self.s) / self.c

    def program(self, moves: str = SOUND) -> str:
        """APT; moves: rapid (R) or feed (F) to the places of the slot."""
        x, up = 13.0 + 20.0 * self.s, AWAY * self.axis
        start, middle, end = (np.array([k * x, 0.0, self.z]) for k in (-1, 0, 1))
        places = {
            "start": start,
            "middle": middle,
            "end": end,
            "away": start + up,
            "high": middle + up,
            "over": end + up,
        }
        lines = ["UNITS/MM", "MULTAX/ON", "SPINDL/8000,RPM,CLW"]
        for word in moves.split():
            lines.append("RAPID" if word[0] == "R" else "FEDRAT/900,MMPM")
            lines.append("GOTO/" + ",".join(f"{value:.6f}" for value in [*places[word[2:]], *self.axis]))
        return "\n".join([*lines, "FINI", ""])

    def cell(self, directory, settings: tuple[str, ...] = (), moves: str = SOUND) -> Cell:
        """The cell of a program."""
        file = directory / "slot.apt"
        file.write_text(self.program(moves))
        tool = f"tool.type={self.shape}", f"tool.corner_radius_mm={SHAPES[self.shape]}", "tool.diameter_mm=10"
        stock = "stock.min_mm=[-8,-70,-15]", "stock.max_mm=[8,70,0]"
        return read_cell(find_file("test_piece.yaml"), [*tool, *stock, "tool.teeth=2", f"path.file={file}", *settings])

    def collisions(self) -> dict[str, Collision]:
        """The table of one tool and tilt."""
        free, cutter, near = self.height(RADIUS), self.height(5.0), 0.3
        slim, wide = f"tool.shank_diameter_mm={2 * (RADIUS - 3)}", f"tool.shank_diameter_mm={2 * RADIUS}"
        stick, flutes = "tool.stick_out_mm={:.9f}".format, "tool.flute_length_mm={:.9f}".format

        def nose(over: float) -> tuple[str, str]:
            """A spindle nose 3 mm above the holder, whose circle is ``over`` deep in the top."""
            radius = ((free + near + 3.0 + over) * self.c + self.z) / self.s
            return stick(free + near), f"tool.holder_mm=[{RADIUS},0,{RADIUS},3,{radius},3]"

        def box(over: float) -> tuple[str, ...]:
            """A clamp below the lowest point of the holder, where the tool is in the middle of the slot."""
            e = np.array([*self.axis[:2] / self.s * self.c, -self.s])
            x, y, z = (free + 1.0) * self.axis + RADIUS * e + [0.0, 0.0, self.z + over]
            return slim, stick(free + 1.0), f"workpiece.fixtures_mm=[{x - 1},{y - 1},{z - 3},{x + 1},{y + 1},{z}]"

        below, end = "workpiece.table_z_mm={}".format, "R:high F:middle F:end R:over"
        rows = {
            "holder": Collision("tool body", OVER, (slim, stick(free - OVER)), (slim, stick(free + near))),
            "shank": Collision("tool body", OVER, (wide, flutes(free - OVER)), (wide, flutes(free + near))),
            "flutes": Collision("depth of cut", cutter, (flutes(cutter - OVER),), (flutes(cutter + near),)),
            "table": Collision("below the stock", OVER, (below(OVER - DEPTH),), (below(-DEPTH - 0.01),)),
            "rapid": Collision("rapid in material", None, moves="R:away R:start F:middle R:end R:over"),
            "plunge": Collision("plunge", None, ("tool.centre_cutting=false",), ("tool.centre_cutting=false",), end),
        }
        if self.s > 0.3:  # else its circle is larger than the stock
            rows["spindle nose"] = Collision("tool body", OVER, nose(OVER), nose(-near))
        if self.axis[1]:  # else the slot leads the cutter through the clamp
            rows["clamp"] = Collision("in the fixture", OVER, box(OVER), box(-near), words="holder")
        return rows
