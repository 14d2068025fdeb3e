"""A small cell that mills short tool paths quickly: shipped arm and posture, coarse grid."""

from pathlib import Path

from kr270_milling.cell.cell import Cell
from kr270_milling.cell.cell_file import read_cell

CONFIG = Path(__file__).parents[2] / "config"
RADIUS = 5e-3  # [m] of the cutter here
SETTINGS = [  # one level of the stock is 0.1 um
    "tool.diameter_mm=10", "tool.teeth=2", "tool.spindle_speed_rpm=6000", "stock.min_mm=[-20,-15,-6.5535]",
    "stock.max_mm=[20,15,0]", "stock.grid_step_um=50", "stock.floor_tolerance_um=0.2", "exchange.period_ms=0.5",
    "exchange.micro_step_deg=3", "dynamics.follow_pose=false",
]  # fmt: skip
RIGID = "arm.joint_compliance_urad_per_n_m=[1e-9, 1e-9, 1e-9, 1e-9, 1e-9, 1e-9]"

HEAD = "G21 G90 S6000 M3\n"
#: a straight side, an outer corner rolled round, a second side 1 mm deep, then an arc on a higher level
POCKET = (
    HEAD + "(side)\nG0 X-28 Y8 Z2\nG0 Z-1\nG1 X8 F3000\nG2 X13 Y3 I0 J-5\nG1 Y-22\nG0 Z2\n"
    "(ring)\nG0 X-28 Y2\nG0 Z-0.5\nG1 X-8\nG2 X-8 Y2 I0 J-6\nG1 Y25\nG0 Z2\nM5\nM30\n"
)
#: one slot along x
SLOT = HEAD + "(slot)\nG0 X-28 Y0 Z2\nG0 Z-1\nG1 X28 F3000\nG0 Z2\nM5\nM30\n"


def small_cell(folder, program: str, *assignments: str) -> Cell:
    """The cell with this G-code, written into a folder."""
    path = Path(folder) / "path.nc"
    path.write_text(program)
    return read_cell(CONFIG / "test_piece.yaml", [*SETTINGS, f"path.file={path}", *assignments])
