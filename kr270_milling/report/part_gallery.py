"""Pictures and tables of the report of a part: what a tool path cell shows instead of the paper's figures."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from kr270_milling.cell.cell import Cell
from kr270_milling.cell.jobs import ScoredPass
from kr270_milling.decision.part import PartAssessment
from kr270_milling.report import figures_setup, part_figures
from kr270_milling.report.gallery import Picture
from kr270_milling.report.style import svg_text
from kr270_milling.robot import forward

__all__ = ["feature_table", "part_gallery", "part_verdict"]

#: column of the before/after table, key of FeatureRow, factor, digits
COLUMNS = (
    ("largest deviation to the side [µm]", "max_normal", 1e6, 1),
    ("mean [µm]", "mean_normal", 1e6, 1),
    ("95 % [µm]", "quantile_normal", 1e6, 1),
    ("largest wall error [µm]", "max_wall", 1e6, 1),
    ("largest floor error [µm]", "max_floor", 1e6, 1),
    ("largest force [N]", "max_force", 1.0, 1),
    ("largest power [W]", "max_power", 1.0, 0),
)


def part_gallery(cell: Cell, passes: Sequence[ScoredPass], parts: Sequence[PartAssessment]) -> list[Picture]:
    """All pictures in the order of the report; parts: the assessments of the passes, the original one first."""
    shown = [0] if len(parts) == 1 else [0, len(parts) - 1]
    some = [parts[k] for k in shown]
    actual = [passes[k].result.actual for k in shown]
    frames = forward(cell.arm, cell.mount, cell.joints(cell.target())[0])
    rows = (
        (
            "tool_path", "The tool path and the stock", part_figures.tool_path(cell.timed_path.toolpath, cell.stock),
            "Path of the tool tip in the workpiece frame: seen from above, and its height over its length.",
        ),
        (
            "arm_posture", "The arm at the start",
            figures_setup.arm_posture(frames, cell.workpiece.pose, cell.stock),
            "Node points of the stiffness model, joined; orange: spindle and tool; brown: the stock.",
        ),
        (
            "deviation_map", "Deviation to the side of the path",
            part_figures.deviation_maps(some, actual, cell.stock),
            "Tool centre minus target, across the path and horizontal, where the tool cuts. What is cut away later "
            "does not stay on the part.",
        ),
        (
            "surface_map", "Errors of the surfaces that remain", part_figures.surface_maps(some, cell.stock),
            "Predicted part minus the part of a rigid arm: floors as areas, walls as lines. Grey: not machined, or too "
            f"near to a wall. Floors are told to {some[0].surface.floor_resolution * 1e6:.1f} µm; walls come from the "
            "passages of the teeth, one value per tooth. The tool is taken as upright: the arm's tilt is not shown.",
        ),
        (
            "deviation_along_path", "Deviation along the path", part_figures.along_path(parts),
            "Only where the tool cuts. Above: horizontal and across the path, positive to its left. Below: in height.",
        ),
        (
            "loads", "Force, torque and power", part_figures.loads(parts[0]),
            f"Pass '{parts[0].name}': means over exchange periods of {cell.clock.period * 1e3:g} ms, so the peaks "
            "within a tooth's engagement are lower here.",
        ),
    )  # fmt: skip
    return [Picture(name, title, "", caption, svg_text(figure)) for name, title, figure, caption in rows]


def feature_table(parts: Sequence[PartAssessment]) -> dict:
    """Head and rows of the table of features, for each feature one row a pass."""
    names = [row.name for row in (*parts[0].rows, parts[0].whole)]
    rows = []
    for name in names:
        for part in parts:
            row = next((r for r in (*part.rows, part.whole) if r.name == name), None)
            if row is None:
                continue
            values = [_number(getattr(row, key) * factor, digits) for _, key, factor, digits in COLUMNS]
            rows.append((name, part.name, values))
    return {"head": [title for title, *_ in COLUMNS], "rows": rows}


def _number(value: float, digits: int) -> str:
    return f"{value:.{digits}f}" if np.isfinite(value) else "–"


def part_verdict(parts: Sequence[PartAssessment]) -> str:
    """Largest errors of the part before and after, in one sentence."""

    def said(part: PartAssessment) -> str:
        whole = part.whole
        return f"walls {_number(whole.max_wall * 1e6, 1)} µm, floors {_number(whole.max_floor * 1e6, 1)} µm"

    first = f"Largest error predicted on the part, not compensated: {said(parts[0])}"
    return first + (f"; after '{parts[-1].name}': {said(parts[-1])}." if len(parts) > 1 else ".")
