"""The page of a sweep."""

from __future__ import annotations

from pathlib import Path

from kr270_milling.base.column import TextTable, fixed
from kr270_milling.show.report.study_page import points, write_page
from kr270_milling.studies.maps.sweep import SweepSummary

__all__ = ["sweep_tables", "write_sweep"]

SHOWN = {"static_deviation_um": "static [um]", "max_deviation_um": "max [um]", "max_power_w": "power [W]"}


def sweep_tables(summary: SweepSummary) -> list[TextTable]:
    """The rows with the least and with the largest deviation."""
    head = ["row", *summary.keys, *SHOWN.values()]
    both = (("Least deviation", summary.best), ("Largest deviation", summary.worst))
    return [
        TextTable(
            title,
            head,
            [
                [str(row["index"]), *(_text(row[key]) for key in summary.keys), *(fixed(row[key]) for key in SHOWN)]
                for row in rows
            ],
        )
        for title, rows in both
        if rows
    ]


def write_sweep(folder, summary: SweepSummary, sentences: list[str], self_contained: bool = False) -> Path:
    """Write the largest deviation of the rows over each varied key, and the tables; returns the path.

    The page of the folder ``sweep`` is ``sweep.html`` beside it: Arrow reads every file of the folder as rows.
    """
    up = [row["max_deviation_um"] for row in summary.shown]
    figures = [
        points("Largest deviation", key, "largest deviation [um]", {"rows": ([row[key] for row in summary.shown], up)})
        for key in summary.keys
    ]
    place = Path(folder).resolve()
    page = place.with_name(f"{place.name}.html")
    title = "Sweep of " + ", ".join(summary.keys)
    return write_page(page, title, sentences, sweep_tables(summary), figures, self_contained=self_contained)


def _text(value: float | str) -> str:
    return value if isinstance(value, str) else f"{value:.6g}"
