"""A long program as CAM systems write one: rows of short blocks over a wavy surface, with retracts and features.

``python long_program.py MINUTES FILE`` writes one and prints the options of its cell.
420 minutes: 66,000 points and 146 m of path.
"""

import math
import sys
from pathlib import Path

FEED = 348.0  #: [mm/min]
ROW = 300.0  #: [mm], length of a row
POINTS = 136  #: of a row
STEPOVER = 1.0  #: [mm]
ROWS = 20  #: of a feature
SAFE = 5.0  #: [mm]


def program(minutes: float) -> str:
    """G-code of that duration; a row of 300 mm takes 52 s."""
    rows = minutes * FEED / (ROW + STEPOVER)
    count = math.ceil(rows)
    lines = ["%", "O0001 (long part)", "G21 G90 G17", "S4000 M3"]
    for row in range(count):
        y = (row - 0.5 * (count - 1)) * STEPOVER
        points = POINTS if row < count - 1 else max(2, round(POINTS * (rows - row)))
        x = [ROW * (k / (POINTS - 1) - 0.5) * (-1) ** row for k in range(points)]
        depth = [-1.5 + 0.8 * math.sin(0.03 * one) * math.cos(0.02 * y) for one in x]
        if row % ROWS == 0:
            lines += [f"G0 Z{SAFE}", f"(surface {row // ROWS + 1})", f"G0 X{x[0]:.3f} Y{y:.3f}", "G0 Z0.5",
                      f"G1 Z{depth[0]:.3f} F{0.3 * FEED:g}"]  # fmt: skip
        lines += [f"G1 X{a:.3f} Y{y:.3f} Z{z:.3f} F{FEED:g}" for a, z in zip(x, depth, strict=True)]
    return "\n".join([*lines, f"G0 Z{SAFE}", "M5", "M30", "%", ""])


if __name__ == "__main__":
    minutes = float(sys.argv[1])
    half = 0.5 * minutes * FEED / ROW * STEPOVER + 10.0  # [mm] of a plate
    Path(sys.argv[2]).write_text(program(minutes))
    print(f"--set path.file={sys.argv[2]} --set tool.diameter_mm=10 --set tool.teeth=2", end=" ")
    print("--set tool.spindle_speed_rpm=4000", end=" ")
    print(f"--set stock.min_mm=[-160,{-half:.0f},-25] --set stock.max_mm=[160,{half:.0f},0]")
