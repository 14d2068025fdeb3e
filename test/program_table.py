"""Programs with the answer that ``check`` must give about their rapid moves, as rows of a table.

All programs start with the top of the stock at z = 0. Volumes are closed forms, with the radius R of the cutter, the
length l of the rapid move and the depth d.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from kr270_milling.base.record import find_file

__all__ = ["DIAMETERS_MM", "ISSUE", "Row", "dangerous", "random_sound", "sound", "with_rapid_cut"]

DIAMETERS_MM = (2.0, 6.0, 20.0, 50.0)
TUTORIAL = find_file("paper.yaml").parent.parent / "kr270_milling" / "guide" / "tutorial.md"


@dataclass(frozen=True)
class Row:
    """One program and the expected answer; a volume of 0 is a sound program."""

    name: str
    program: str
    volume_mm3: float = 0.0  #: that rapid moves remove
    lines: tuple[int, ...] = ()  #: of the program, of the rapid moves in material
    depth_mm: float = 0.0  #: of the deepest rapid move
    diameter_mm: float = 20.0

    @property
    def settings(self) -> tuple[str, ...]:
        """The tool, and a stock of 8 by 6 diameters with the origin in the middle of its top."""
        x, y = 4.0 * self.diameter_mm, 3.0 * self.diameter_mm
        return (
            f"tool.diameter_mm={self.diameter_mm}",
            f"stock.min_mm=[{-x},{-y},-25]",
            f"stock.max_mm=[{x},{y},0]",
            "timing.rapid_feed_m_per_min=6",
        )


def _program(*lines: str) -> str:
    """The lines after two lines of settings; the first of the lines has number 3."""
    return "\n".join(("G21 G90 G17", "S8000 M3", *lines, "M30", ""))


def dangerous(diameter: float) -> list[Row]:
    """Rapid moves through material by a cutter of a diameter [mm]."""
    r, pi = diameter / 2.0, math.pi
    below = ("G0 X0 Y0 Z5", "G1 Z-1 F1200")  # lines 3 and 4
    turn = [2.0 * pi * k / 48 for k in range(1, 97)]
    helix = [
        f"G0 X{0.5 * r * math.cos(a):.5f} Y{0.5 * r * math.sin(a):.5f} Z{-min(a / (2.0 * pi), 1.0):.5f}" for a in turn
    ]
    chords = [f"G0 X{x:.6f}" for x in np.linspace(0.0, r, 101)[1:]]
    rows = [
        Row("slot", _program(f"G0 X{-11 * r} Y0 Z5", "G0 Z-1", f"G1 X{-2 * r} F1200", f"G0 X{2 * r}", "G0 Z5"),
            2.0 * r * 4.0 * r, (6,), 1.0),
        Row("slot in short chords", _program(*below, *chords, "G0 Z5"), 2.0 * r * r, (), 1.0),
        Row("corner", _program(*below, f"G0 X{3 * r}", f"G0 Y{2 * r}", "G0 Z5"),
            2.0 * r * 5.0 * r - r**2 + pi * r**2 / 4.0, (5, 6), 1.0),
        Row("diagonal", _program(*below, f"G0 X{2 * r} Y{2 * r}", "G0 Z5"),
            2.0 * r * 2.0 * math.sqrt(2) * r, (5,), 1.0),
        Row("helix", _program(f"G0 X{0.5 * r} Y0 Z5", "G1 Z0 F1200", *helix, "G0 Z5"), pi * (1.5 * r) ** 2, (), 1.0),
        Row("vertical", _program("G0 X0 Y0 Z5", "G0 Z-0.5", f"G1 X{r} F1200", "G0 Z5"), pi * r**2 / 2.0, (4,), 0.5),
        Row("start in material", _program("G0 X0 Y0 Z-0.5", f"G1 X{r} F1200", "G0 Z5"), pi * r**2 / 2.0, (3,), 0.5),
        Row("too low above the stock", _program(*below, "G0 Z-0.1", f"G0 X{4 * r}", "G0 Z5"),
            0.1 * 2.0 * r * 4.0 * r, (6,), 0.1),
        Row("wall, 0.1 mm deep",
            _program(f"G0 X{-11 * r} Y0 Z5", "G0 Z-1", f"G1 X{11 * r} F1200", "Y0.1", f"G0 X{-11 * r}", "G0 Z5"),
            0.1 * 16.0 * r, (7,), 1.0),
    ]  # fmt: skip
    return [replace(row, name=f"{row.name}, {diameter:g} mm", diameter_mm=diameter) for row in rows]


def sound(diameter: float) -> list[Row]:
    """Rapid moves that touch no material, with a cutter of a diameter [mm]."""
    r = diameter / 2.0
    slot = (f"G0 X{-11 * r} Y0 Z5", "G0 Z-1", f"G1 X{2 * r} F1200")
    rows = [
        Row("retract from a slot", _program(*slot, "G0 Z5")),
        Row("back through the slot", _program(*slot, f"G0 X{-11 * r}", "G0 Z5")),
        Row("along a wall", _program(*slot, f"G1 X{11 * r}", f"G1 Y{r}", f"G1 X{-11 * r}", f"G0 X{11 * r}", "G0 Z5")),
        Row("along a diagonal wall",
            _program("G0 X0 Y0 Z5", "G1 Z-1 F1200", f"G1 X{2 * r} Y{3 * r}", "G0 X0 Y0", "G0 Z5")),
        Row("just above the stock", _program(*slot, "G0 Z0.005", f"G0 X{-3 * r} Y{-3 * r}", "G0 Z5")),
        Row("across a pocket", _program("G0 X0 Y0 Z5", "G1 Z-1 F1200", f"G1 X{r}", f"G1 Y{r}", "G1 X0", "G1 Y0",
                                        f"G0 X{r} Y{r}", "G0 Z5")),
        Row("round an arc and back", _program("G0 X0 Y0 Z5", "G1 Z-1 F1200", f"G2 X{4 * r} Y0 I{2 * r} J0",
                                              f"G3 X0 Y0 I{-2 * r} J0", "G0 Z5")),
        Row("up a steep ramp",
            _program("G0 X0 Y0 Z5", "G1 Z0 F1200", f"G1 X{r} Z{-r}", f"G0 X{r / 2} Z{-r / 2}", "G0 Z5")),
        Row("down again into a hole", _program("G0 X0 Y0 Z5", "G1 Z-1 F600", "G0 Z2", "G0 Z-0.9", "G1 Z-2", "G0 Z5")),
    ]  # fmt: skip
    return [replace(row, name=f"{row.name}, {diameter:g} mm", diameter_mm=diameter) for row in rows]


def random_sound(seed: int) -> Row:
    """A program that cuts two or three features, each with rapid moves that touch no material."""
    draw = np.random.default_rng(seed)
    diameter = float(draw.choice(DIAMETERS_MM))
    r, lines = diameter / 2.0, [f"G0 X{-6 * diameter} Y0 Z5"]
    for _ in range(draw.integers(2, 4)):
        (x, y), (to_x, to_y) = (draw.uniform((-5 * r, -4 * r), (5 * r, 4 * r)) for _ in range(2))
        x, y, to_x, to_y = (round(float(v), 3) for v in (x, y, to_x, to_y))
        z = round(-float(draw.uniform(0.2, 1.5)), 3)
        start, end = f"X{x} Y{y}", f"X{to_x} Y{to_y}"
        lines += [f"G0 {start}", "G0 Z0.05", f"G1 Z{z} F600", f"G1 {end} F1200"]
        lines += {
            0: [],
            1: [f"G0 {start}"],
            2: [f"G1 {start} Z{z - 0.1:.3f}", f"G0 {end} Z{z:.3f}"],
            3: [f"G0 Z{z / 2:.3f}", f"G0 X{(x + to_x) / 2:.4f} Y{(y + to_y) / 2:.4f}"],
            4: [f"G1 Z{z - 0.2:.3f}", f"G0 Z{z:.3f}", f"G0 {start}"],
        }[int(draw.integers(5))]
        lines.append(f"G0 Z{round(float(draw.uniform(0.01, 5.0)), 3)}")
    return Row(f"random {seed}", _program(*lines, "G0 Z5"), diameter_mm=diameter)


def with_rapid_cut(row: Row) -> Row:
    """The same program with the first plunge into the uncut stock as a rapid move."""
    depth = re.search(r"G1 Z(-[\d.]+) F600", row.program)
    if depth is None:
        raise ValueError(f"{row.name} has no plunge")
    text = row.program.replace(depth[0], f"G0 Z{depth[1]}", 1)
    line = text[: text.index(f"G0 Z{depth[1]}")].count("\n") + 1
    volume = math.pi * (row.diameter_mm / 2.0) ** 2 * -float(depth[1])
    return replace(row, program=text, lines=(line,), depth_mm=-float(depth[1]), volume_mm3=volume)


def _issue() -> Iterator[tuple[str, str, str, int]]:
    """Name, parameter file, program and line of the first rapid move in material."""
    piece = find_file("test_piece.nc").read_text()
    pocket = TUTORIAL.read_text().split("cat > pocket.nc <<'EOF'\n")[1].split("EOF\n")[0]
    block = piece[: piece.index("N420")].count("\n") + 1
    yield "slot", "test_piece.yaml", _program(
        "G0 X-65 Y0 Z5", "G0 Z-1", "G1 X-30 F1200", "G0 X30", "G1 X45", "G0 Z5"
    ), 6  # fmt: skip
    yield "N420 of the test piece", "test_piece.yaml", piece.replace("N420 G1", "N420 G0"), block
    yield "diagonal", "test_piece.yaml", _program(
        "G0 X-65 Y-65 Z5", "G0 Z-1", "G0 X-28.28 Y-28.28", "G0 X28.28 Y28.28", "G0 Z5", "G1 Z4 F1200"
    ), 5  # fmt: skip
    side = pocket.replace("G1 Y10 F4000\nG1 X-10\n", "G0 Y10\nG1 X-10 F4000\n")
    yield "pocket of the tutorial", "pocket", side, side[: side.index("G0 Y10")].count("\n") + 1
    yield "vertical", "test_piece.yaml", _program("G0 X0 Y0 Z5", "G0 Z-0.5", "G1 X10 F1200", "G0 Z5"), 4


#: the five programs that version 0.2.0 released
ISSUE = tuple(_issue())
