"""The page of a map of placements."""

from __future__ import annotations

from pathlib import Path

from kr270_milling.base.column import columns, fixed, table_of
from kr270_milling.cell.paths import CellPath
from kr270_milling.physics.robot import Arm
from kr270_milling.show.report.decision_block import cut_text
from kr270_milling.show.report.study_page import COLOURS, figure_of, write_page
from kr270_milling.studies.maps.placements import MAPPED, PlacementRow, Summary

__all__ = ["gain_text", "write_map"]

NOTE = (
    "each field shows the z, the turns and the branch with the least error there; in an empty field the path is out of "
    "reach or beyond the joint limits"
)
TABLE_NOTE = (
    "x, y, z: origin of the workpiece on base_link. Error: the largest static one across the feed on the path. After "
    "compensation: one standard deviation of what the uncertainty of the cell leaves. Gain: against the present place."
)


def gain_text(summary: Summary, present: dict) -> str:
    """State the error of the present placement and of the best placement in a sentence."""
    if not summary.best:
        return "no placement is feasible"
    best = summary.best[0]
    there = f"the best placement, {_place(best)}, has {best['error_max_um']:.1f} um"
    if not present["feasible"]:
        return f"where the part is, {_place(present)}, the path is out of reach or beyond the limits; {there}"
    now = f"where the part is, {_place(present)}, the error is {present['error_max_um']:.1f} um before compensation"
    gain = _gain(best, present)
    return f"{now}; {there}, {abs(gain):.0f} % {'less' if gain >= 0.0 else 'more'}"


def _place(row: dict) -> str:
    keys = {"part": "turn_deg", "tool": "tool_turn_deg"}
    turns = "".join(f", {name} turned by {row[key]:.4g} deg" for name, key in keys.items() if row[key])
    return f"x {row['x_mm']:.0f}, y {row['y_mm']:.0f}, z {row['z_mm']:.0f} mm{turns}"


def _gain(row: dict, present: dict) -> float:
    """Return the gain [%] of the error before compensation."""
    return 100.0 * (1.0 - row["error_max_um"] / present["error_max_um"])


def write_map(
    folder, arm: Arm, path: CellPath, name: str, summary: Summary, present: dict, *, self_contained: bool = False
) -> Path:
    """Write heat maps over x and y with the best placements and the present one; returns the path of the page.

    name: of the cell file; present: row of `present_row`; self_contained: as of ``write_page``.
    """
    star = dict(symbol="star", size=14, color=COLOURS[1], line=dict(color="white", width=1))
    diamond = dict(symbol="diamond", size=12, color="white", line=dict(color="black", width=2))
    marks = {"best placements": (summary.best, star), "the part now": ([present], diamond)}
    figures = []
    for title, values in zip(MAPPED.values(), summary.maps.values(), strict=True):
        figure = figure_of(title, "x [mm]", "y [mm]")
        figure.add_heatmap(x=summary.x, y=summary.y, z=values, colorscale="Cividis")
        for mark, (rows, marker) in marks.items():
            across, up = ([row[key] for row in rows] for key in ("x_mm", "y_mm"))
            figure.add_scatter(x=across, y=up, mode="markers", name=mark, marker=marker)
        figures.append(figure)
    rows = [{"place": "now"} | present, *({"place": f"best\u00a0{n}"} | row for n, row in enumerate(summary.best, 1))]
    known = present["feasible"]
    for row in rows:
        row["gain"] = _gain(row, present) if known and row["feasible"] else float("nan")
    shown = [(column.heading(short=not column.title), column.key, column.text) for column in columns(PlacementRow)]
    table = table_of(
        "Placements", [("", "place", str), *shown, ("gain [%]", "gain", lambda v: fixed(v, 1))], rows, TABLE_NOTE
    )
    sentences = [f"{name}: {arm.name} mills {cut_text(path)}", gain_text(summary, present), NOTE]
    title = f"Where to clamp {path.path.file_name or 'the part'}"
    return write_page(Path(folder) / "map.html", title, sentences, [table], figures, self_contained=self_contained)
