"""What a map is for: the best placements as cells ready to run, and a picture."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from kr270_milling.base.files import write_files
from kr270_milling.base.parameter_file import shipped_directories
from kr270_milling.cell.cell import Cell
from kr270_milling.studies.placements import Course, moved_cell

__all__ = ["best_rows", "write_cells", "write_picture"]


def best_rows(table, count: int) -> list[dict]:
    """The feasible rows of the smallest largest error, one for each placement of the workpiece."""
    feasible = np.flatnonzero(table["feasible"].to_numpy())
    order = feasible[np.argsort(table["error_max_um"].to_numpy()[feasible], kind="stable")]
    found, seen = [], set()
    for index in order.tolist():
        row = {name: table[name][index].as_py() for name in table.column_names}
        place = tuple(row[name] for name in ("x_mm", "y_mm", "z_mm", "turn_deg"))
        if place not in seen:
            seen.add(place)
            found.append(row)
        if len(found) == count:
            break
    return found


def write_cells(folder, source: Path, cell: Cell, course: Course, rows: list[dict]) -> list[Path]:
    """A parameter file for each row, which includes ``source`` and moves workpiece, mount and posture."""
    posture = "start_joints_deg" if cell.start_joints.size else "posture_hint_deg"
    written = []
    for number, row in enumerate(rows, 1):
        moved = moved_cell(cell, course, row)
        error = f"{row['error_max_um']:.1f} um before, {row['compensated_max_um']:.1f} um after compensation"
        lines = [
            f"# Placement {number} of the map: largest static error across the feed {error} (predicted, one sigma)",
            "/**:",
            "  ros__parameters:",
            f"    includes: [{_included(source, Path(folder))!r}]",
            f"    {posture}: {moved['posture_hint_deg']}",
            "    workpiece:",
            f"      xyz_mm: {moved['workpiece']['xyz_mm']}",
            f"      abc_deg: {moved['workpiece']['abc_deg']}",
            *(["      at_start_joints: false"] if cell.workpiece.at_start_joints else []),
            "    mount:",
            f"      abc_deg: {moved['mount']['abc_deg']}",
        ]
        written.append(Path(folder) / f"best_{number}.yaml")
        write_files({written[-1]: (line + "\n" for line in lines)})
    return written


def _included(source: Path, folder: Path) -> str:
    """A shipped file by its name, any other as seen from the folder of the new file."""
    if any(source.parent.samefile(place) for place in shipped_directories()):
        return source.name
    return os.path.relpath(source, folder.resolve())


def write_picture(folder, table) -> Path:
    """Heat maps over x and y: the least of the largest errors there, before and after compensation."""
    from plotly.subplots import make_subplots

    feasible = table["feasible"].to_numpy()
    x, y = (table[name].to_numpy()[feasible] for name in ("x_mm", "y_mm"))
    figure = make_subplots(cols=2, subplot_titles=["before compensation [um]", "after, one sigma [um]"])
    columns, rows = np.unique(x), np.unique(y)
    for number, name in enumerate(("error_max_um", "compensated_max_um"), 1):
        least = np.full((len(rows), len(columns)), np.nan)
        values = table[name].to_numpy()[feasible]
        places = np.searchsorted(rows, y), np.searchsorted(columns, x)
        np.fmin.at(least, places, values)
        figure.add_heatmap(x=columns, y=rows, z=least, colorscale="Viridis", col=number, row=1,
                           colorbar={"x": 0.45 if number == 1 else 1.0})  # fmt: skip
        figure.update_xaxes(title="x [mm]", row=1, col=number)
        figure.update_yaxes(title="y [mm]", row=1, col=number)
    figure.update_layout(title="Where to clamp the part: least largest error; white: out of reach or limits")
    path = Path(folder) / "map.html"
    figure.write_html(path, include_plotlyjs=True)
    return path
