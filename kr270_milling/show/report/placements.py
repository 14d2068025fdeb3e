"""The page of a map of placements."""

from __future__ import annotations

from pathlib import Path

from kr270_milling.base.column import columns_of, table_of
from kr270_milling.show.report.study_page import figure_of, write_page
from kr270_milling.studies.maps.placements import MAPPED, PlacementRow, Summary

__all__ = ["write_map"]

NOTE = (
    "each field shows the z, the turns and the branch with the least error there; the stars are the best placements, "
    "and a field is empty if the path there is out of reach or beyond the joint limits"
)


def write_map(folder, summary: Summary) -> Path:
    """Write heat maps over x and y, with the best placements."""
    best = [[row[name] for row in summary.best] for name in ("x_mm", "y_mm")]
    star = {"symbol": "star", "size": 11, "color": "red"}
    figures = []
    for title, values in zip(MAPPED.values(), summary.maps.values(), strict=True):
        figure = figure_of(title, "x [mm]", "y [mm]")
        figure.add_heatmap(x=summary.x, y=summary.y, z=values, colorscale="Viridis", colorbar={"thickness": 12})
        figure.add_scatter(x=best[0], y=best[1], mode="markers", name="best placements", marker=star, showlegend=False)
        figures.append(figure)
    best_rows = table_of("Best", columns_of(PlacementRow), summary.best)
    return write_page(Path(folder) / "map.html", "Where to clamp the part", [NOTE], [best_rows], figures)
