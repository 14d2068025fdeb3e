"""A small tool path in the paper's cell: a corner with a stop, an arc, an exit; some 1.5 s of milling."""

import tempfile
from pathlib import Path

import numpy as np

from kr270_milling.base.parameter_file import find_file
from kr270_milling.cell.cell import Cell
from kr270_milling.cell.cell_file import read_cell
from kr270_milling.cell.jobs import simulate
from kr270_milling.cell.models import cut_of
from kr270_milling.path.controller_motion import controller_motion
from kr270_milling.path.timing import TimedPath
from kr270_milling.path.trajectory import Trajectory

GCODE = """\
G21 G90 S8000 M3
(entry)
G0 X-14 Y0 Z2
G0 Z-0.5
(leg)
G1 X12 F4000
G1 Y10
(arc)
G2 X20 Y18 I8 J0
G1 X26
G0 Z2
M5
M30
"""
SET = (
    "stock.min_mm=[0,-14,-10]", "stock.max_mm=[40,40,0]", "stock.grid_step_um=50", "timing.controller_step_ms=12",
)  # fmt: skip
#: the corner alone: 0.5 s of milling
CORNER = "G21 G90 S8000 M3\nG0 X-14 Y0 Z2\nG0 Z-0.5\nG1 X4 F4000\nG1 Y6\nG0 Z2\nM5\nM30\n"
#: a slot of a tool that leans by 18 deg, as a program with tool axes
LEANING = "G21 S8000 M3\nG43.5 H1\nG0 X-9 Y8 Z30 J1 K3\nG0 Z-1\nG1 X9 F600\nM30\n"


def small_part(directory, gcode: str | bytes = GCODE, *more: str) -> Cell:
    """The cell with the G-code written to ``directory``; more: further ``key=value``."""
    return read_cell(find_file("paper.yaml"), assignments(directory, gcode, *more))


def assignments(directory, gcode: str | bytes = GCODE, *more: str) -> list[str]:
    path = Path(directory, "part.nc")
    path.write_bytes(gcode if isinstance(gcode, bytes) else gcode.encode())
    return [f"path.file={path}", *SET, *more]


def compile_cut(detail: str, *more: str, gcode: str = GCODE) -> Cell:
    """Compile the pass, the cut along a path and a single step; returns the cell."""
    with tempfile.TemporaryDirectory() as directory:
        cell = small_part(directory, gcode, f"cutting.detail={detail}", *more)
        simulate(cell)
    places = np.zeros((2, 3))
    cut_of(cell).along(places, np.array([0, 1]))
    cut_of(cell).sweep(*places, 0, 1)
    return cell


def swayed(target: Trajectory, size: float = 50e-6) -> Trajectory:
    """The target with a smooth correction of a size [m], at rest where the target rests."""
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(target.position, axis=0), axis=1))])[:, None]
    shift = size * np.sin(way / [0.011, 0.007, 0.013] + [1.0, 2.0, 3.0])
    return controller_motion(target.with_position(target.position + shift, target.velocity), target)


def path_error(timed: TimedPath, time_ns) -> np.ndarray:
    """Distance [m] of the trajectory from its tool path at times [ns], (m,): what the controller step costs."""
    on_path, tangent, _ = timed.toolpath.on_path(timed.distance_at(time_ns))
    error = timed.trajectory.sample(time_ns) - on_path
    return np.linalg.norm(error - np.sum(error * tangent, axis=-1, keepdims=True) * tangent, axis=-1)
