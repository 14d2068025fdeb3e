"""Reports: one self-contained interactive HTML page; every series as CSV."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from kr270_milling.base.errors import InputError
from kr270_milling.base.files import write_files
from kr270_milling.cell.cell import Cell
from kr270_milling.cell.jobs import ScoredPass
from kr270_milling.decision.part import PartAssessment, assess_all
from kr270_milling.report.charts_compare import comparison_charts
from kr270_milling.report.charts_pass import pass_charts
from kr270_milling.report.charts_setup import setup_charts
from kr270_milling.report.decision_block import DecisionBlock, ReportTable, decision_block, judged
from kr270_milling.report.linked import linked
from kr270_milling.report.page.page import render
from kr270_milling.report.robot_model import robot_model
from kr270_milling.report.series import inside, write_series
from kr270_milling.report.surface_map import part_surface

__all__ = ["DecisionBlock", "ReportTable", "decision_block", "write_report", "write_series"]


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
    decision: DecisionBlock | None = None,
    tables: Sequence[ReportTable] = (),
    program: str | None = None,
) -> Path:
    """Write ``report.html`` into the directory, which is made if need be; returns its path.

    passes: the original one first; source: the cell file; command: how this was called; date: as it shall be printed;
    paper: set the paper's own results and figure numbers beside ours; parts: the assessments of the passes, if they
    are known already; decision: what was decided, for the first screen (default: what follows from the passes);
    tables: further ones, after the scores; program: text of the tool path file, where a recording carries it.
    The file appears whole or not at all. Raises InputError where it cannot be written.
    """
    if not passes:
        raise InputError(title, "a report needs at least one pass")
    place = inside(directory)
    parts = parts or assess_all(cell, passes)
    decision = decision or judged(cell, passes, parts)
    text = render(
        cell, passes, parts, _data(cell, passes, parts, paper, program), title=title, source=source, command=command,
        date=date, paper=paper, decision=decision, more=tables,
    )  # fmt: skip
    write_files({place / "report.html": (text,)})
    return place / "report.html"


def _data(cell: Cell, passes, parts, paper: bool, program: str | None) -> dict:
    """What the page's scripts draw."""
    charts = setup_charts(cell)
    if not cell.path.file:
        charts += [*pass_charts(cell, passes[0]), *comparison_charts(cell, passes, parts)]
    sizes = [t.whole.max_normal for t in parts] if cell.path.file else [p.scores.max_deviation for p in passes]
    best = min(range(len(passes)), key=lambda k: sizes[k])
    return {
        "linked": linked(cell, passes, parts, program),
        "surface": part_surface(parts),
        "robot": robot_model(cell, passes[best]),
        "charts": charts,
        "paper": paper,
        "best": best,
        "tolerance_um": [1e6 * allowed for allowed in cell.part.of()],
        "stock_mm": [*(cell.stock.min * 1e3), *(cell.stock.max * 1e3)],
        "engaged_s": cell.full_engagement,
        "part": bool(cell.path.file),
    }
