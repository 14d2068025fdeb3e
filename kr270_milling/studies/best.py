"""What a map is for: the best placements as cells ready to run, and a picture."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from kr270_milling.base.include import write_include
from kr270_milling.base.parameter_file import merge, override, shipped_directories
from kr270_milling.cell.cell import Cell
from kr270_milling.identification.outcome import figure_of, write_page
from kr270_milling.studies.placements import Course, moved_cell

__all__ = ["Summary", "write_cell", "write_cells", "write_picture"]

SHOWN = {"error_max_um": "error before compensation [um]", "compensated_max_um": "after it, one sigma [um]",
         "lowest_mode_hz": "lowest mode [Hz]", "singularity": "distance to a singularity"}  # fmt: skip


class Summary:
    """What is told of all rows, gathered chunk by chunk so that memory does not grow with them."""

    def __init__(self, x: np.ndarray, y: np.ndarray, count: int):
        self.x, self.y, self.count = np.unique(1e3 * x), np.unique(1e3 * y), count
        self.rows = self.feasible = 0
        self.best: list[dict] = []  #: the placements of the smallest largest error, the best branch of each
        #: of the row with the least error at each x and y, (y, x)
        self.maps = {name: np.full((len(self.y), len(self.x)), np.nan) for name in SHOWN}

    def add(self, table) -> None:
        """One chunk."""
        usable = np.flatnonzero(table["feasible"].to_numpy())
        error = table["error_max_um"].to_numpy()[usable]
        self.rows, self.feasible = self.rows + table.num_rows, self.feasible + len(usable)
        order = usable[np.argsort(error, kind="stable")]
        for index in order[: 8 * self.count].tolist():
            self._enter({name: table[name][index].as_py() for name in table.column_names})
        order = order[::-1]  # the least error of a place is entered last, and stays
        x, y = (np.searchsorted(axis, table[name].to_numpy()[order])
                for axis, name in ((self.x, "x_mm"), (self.y, "y_mm")))  # fmt: skip
        error = table["error_max_um"].to_numpy()[order]
        lower = ~(self.maps["error_max_um"][y, x] <= error)
        for name, shown in self.maps.items():
            shown[y[lower], x[lower]] = table[name].to_numpy()[order][lower]

    def _enter(self, row: dict) -> None:
        def place(one: dict) -> tuple:
            return tuple(one[name] for name in ("x_mm", "y_mm", "z_mm", "turn_deg"))

        rivals = [one for one in self.best if place(one) == place(row)]
        if rivals and rivals[0]["error_max_um"] <= row["error_max_um"]:
            return
        others = [one for one in self.best if place(one) != place(row)]
        self.best = sorted([*others, row], key=lambda one: one["error_max_um"])[: self.count]


def write_cells(folder, source: Path, settings, cell: Cell, course: Course, rows: list[dict]) -> list[Path]:
    """A parameter file for each row, which includes ``source`` and moves workpiece, mount and posture."""
    written = []
    for number, row in enumerate(rows, 1):
        note = (f"Placement {number} of the map: largest static error across the feed {row['error_max_um']:.1f} um "
                f"before, {row['compensated_max_um']:.1f} um after compensation (predicted, one sigma)")  # fmt: skip
        written.append(Path(folder) / f"best_{number}.yaml")
        write_cell(written[-1], source, settings, cell, moved_cell(cell, course, row), note)
    return written


def write_cell(path: Path, source: Path, settings, cell: Cell, changes: dict, note: str) -> None:
    """A parameter file that includes ``source``, with the ``key=value`` texts of the command line and the changes.

    changes: as of ``moved_cell``, its posture as ``posture_deg``.
    """
    sections = merge(override({}, settings)[0], {key: value for key, value in changes.items() if key != "posture_deg"})
    sections["start_joints_deg" if cell.start_joints.size else "posture_hint_deg"] = changes["posture_deg"]
    if not cell.workpiece.at_start_joints:
        sections["workpiece"].pop("at_start_joints", None)
    write_include(path, {"includes": [_included(source, path.parent)], **sections}, [note], digits=12)


def _included(source: Path, folder: Path) -> str:
    """A shipped file by its name, any other as seen from the folder of the new file."""
    if any(source.parent.samefile(place) for place in shipped_directories()):
        return source.name
    return os.path.relpath(source, folder.resolve())


def write_picture(folder, summary: Summary) -> Path:
    """Heat maps over x and y, with the best placements."""
    best = [[row[name] for row in summary.best] for name in ("x_mm", "y_mm")]
    star = {"symbol": "star", "size": 11, "color": "red"}
    figures = []
    for title, shown in zip(SHOWN.values(), summary.maps.values(), strict=True):
        figure = figure_of(title, "x [mm]", "y [mm]")
        figure.add_heatmap(x=summary.x, y=summary.y, z=shown, colorscale="Viridis", colorbar={"thickness": 12})
        figure.add_scatter(x=best[0], y=best[1], mode="markers", name="best placements", marker=star, showlegend=False)
        figures.append(figure)
    said = ["each field shows the z, the turns and the branch with the least error there; the stars are the best "
            "placements, and nothing is drawn where the path is out of reach or of the joints' limits"]  # fmt: skip
    names = ["x_mm", "y_mm", "z_mm", "turn_deg", "tool_turn_deg", "branch", *SHOWN]
    rows = [[f"{row[name]:.4g}" for name in names] for row in summary.best]
    return write_page(Path(folder) / "map.html", "Where to clamp the part", said, [("Best", names, rows)], figures)
