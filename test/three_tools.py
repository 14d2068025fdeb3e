"""A CAM program with three tools for a plate of 60 x 30 mm: facing, a pocket with a helical ramp, a finished wall."""

from __future__ import annotations

from pathlib import Path

from kr270_milling.cell.cell import Cell, read_cells

CONFIG = Path(__file__).parent.parent / "config"
PLATE = """\
%
O1001 (BRACKET)
(T1 D=40. CR=0. - ZMIN=-0.5 - FACE MILL)
(T2 D=10. CR=0. - ZMIN=-3. - FLAT END MILL 3 FLUTES)
(T3 D=6. CR=0. - ZMIN=-3. - FLAT END MILL 3 FLUTES)
G90 G94 G17 G21
(FACE1)
T1 M6
S3000 M3
G54
G0 X-55 Y0
Z15
Z-0.5
(LEAD IN)
G1 X55 F1500
G0 Z15
M5
(POCKET2)
T2 M6
S8000 M3
G54
G0 X0 Y0
Z15
Z2
(HELICAL RAMP)
G1 Z0 F1200
X2
G3 X2 Y0 Z-1.5 I-2 J0
G3 X2 Y0 Z-3 I-2 J0
G3 X2 Y0 I-2 J0
G1 X6.7 F2000
G3 X6.7 Y0 I-6.7 J0
G0 Z15
M5
(CONTOUR3)
T3 M6
S9000 M3
G54
G0 X8 Y0
Z15
Z-2
G1 Z-3 F500
X9 F1500
G3 X9 Y0 I-9 J0
G1 X8
G0 Z15
M5
M30
%
"""
#: a plate whose height maps have no level at half of a millimetre; a coarse and quick model
STOCK = ("stock.min_mm=[-30,-15,-9]", "stock.max_mm=[30,15,0]")
QUICK = (
    *STOCK, "stock.grid_step_um=50", "exchange.period_ms=0.5", "exchange.micro_step_deg=3", "tool.spindle_speed_rpm=0",
    "dynamics.follow_pose=false", "stock.floor_tolerance_um=0.2",
)  # fmt: skip
RIGID = "arm.joint_compliance_urad_per_n_m=[1e-9, 1e-9, 1e-9, 1e-9, 1e-9, 1e-9]"


def tool_cells(folder, program: str, tools: dict[str, dict], *more: str) -> tuple[Cell, ...]:
    """The cells of a program, written into a folder, with ``tools`` in the shipped cell of the test piece."""
    path = Path(folder) / "part.nc"
    path.write_text(program)
    return read_cells(CONFIG / "test_piece.yaml", [*QUICK, f"path.file={path}", f"tools={tools}", *more])
