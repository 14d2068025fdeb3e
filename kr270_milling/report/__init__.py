"""Reports: one self-contained HTML page with tables and figures, the figures as SVG files, every series as CSV."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from kr270_milling.base.errors import InputError
from kr270_milling.cell.cell import Cell
from kr270_milling.cell.jobs import ScoredPass
from kr270_milling.decision.part import PartAssessment, assess_all
from kr270_milling.report.gallery import gallery
from kr270_milling.report.html import page
from kr270_milling.report.part_gallery import part_gallery
from kr270_milling.report.series import inside, write_series
from kr270_milling.trajectory.files import write_files

__all__ = ["write_report", "write_series"]


def write_report(
    directory,
    cell: Cell,
    passes: Sequence[ScoredPass],
    *,
    title: str,
    source: str,
    command: str,
    date: str,
    paper: bool = False,
    parts: Sequence[PartAssessment] = (),
) -> Path:
    """Write ``report.html`` and ``figures/*.svg`` into the directory, which is made if need be.

    passes: the original one first; source: the cell file; command: how this was called; date: as it shall be printed;
    paper: set the paper's own results and figure numbers beside ours; parts: the assessments of the passes of a tool
    path, if they are known already. Returns the path of report.html.
    Each file appears whole or not at all. Raises InputError where a file cannot be written.
    """
    if not passes:
        raise InputError(title, "a report needs at least one pass")
    place = inside(directory)
    if cell.path.file:
        parts = parts or assess_all(cell, passes)
    pictures = part_gallery(cell, passes, parts) if parts else gallery(cell, passes)
    about = dict(title=title, source=source, command=command, date=date, paper=paper)
    text = page(cell, passes, pictures, parts=parts, **about)
    figures = inside(directory, "figures")
    head = '<?xml version="1.0" encoding="utf-8"?>\n'
    write_files({figures / f"{p.name}.svg": (head, p.svg) for p in pictures})
    write_files({place / "report.html": (text,)})
    return place / "report.html"
