"""Reports: one self-contained interactive HTML page; every series as CSV."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from kr270_milling.base.column import TextTable
from kr270_milling.base.errors import InputError, MillingError
from kr270_milling.base.files import write_files
from kr270_milling.base.record import flatten
from kr270_milling.cell.cell import Cell
from kr270_milling.cell.jobs import ScoredPass
from kr270_milling.cell.models import arm_of, path_of
from kr270_milling.decide.check import Checked, check
from kr270_milling.decide.decision import Decision, decided
from kr270_milling.decide.part import PartAssessment, assess_all
from kr270_milling.decide.part.assessment import Judgement, judge
from kr270_milling.show.report import page
from kr270_milling.show.report import tables as texts
from kr270_milling.show.report.linked import linked, part_surface, robot_model
from kr270_milling.show.report.series import write_series
from kr270_milling.show.report.straight_cut import charts_of
from kr270_milling.show.report.tables import assumptions, cut_text, finding_rows, limit_bars, tiles

__all__ = ["report_text", "write_report", "write_report_page", "write_series"]


def write_report(directory, cell: Cell, passes: Sequence[ScoredPass], **more) -> Path:
    """Write the page of ``report_text``; more: its other parameters. Returns the path."""
    return write_report_page(directory, report_text(cell, passes, **more))


def write_report_page(directory, text: str) -> Path:
    """Write ``report.html`` into the directory, which is made if need be; returns its path.

    The file appears whole or not at all. Raises InputError where it cannot be written.
    """
    path = Path(directory) / "report.html"
    write_files({path: (text,)})
    return path


def report_text(
    cell: Cell,
    passes: Sequence[ScoredPass],
    *,
    title: str,
    source: str,
    command: str,
    date: str,
    paper: bool = False,
    parts: Sequence[PartAssessment] = (),
    decision: Decision | None = None,
    checked: Checked | None = None,
    tables: Sequence[TextTable] = (),
    program: str | None = None,
) -> str:
    """Return the report as an HTML page.

    passes: the original one first; source: the cell file; command: how this was called; date: as it shall be printed;
    paper: set the paper's own results and figure numbers beside ours; parts: the assessments of the passes, if they
    are known already; decision, checked: for the first screen (default: what follows from the passes);
    tables: further ones, after the scores; program: text of the tool path file, where a recording carries it.
    """
    if not passes:
        raise InputError(title, "a report needs at least one pass")
    path, then = path_of(cell), "" if len(passes) == 1 else ", and what does compensation change"
    parts = parts or assess_all(cell, passes)
    judgements = [judge(cell, scored, part) for scored, part in zip(passes, parts, strict=True)]
    method = decision.method_text if decision else ""
    if decision is None:
        decision, checked = judged(cell, passes, judgements)
    names = [p.name for p in passes]
    if path.straight:
        best = int(np.argmin([p.scores.max_deviation for p in passes]))
    else:
        best = int(np.argmin([part.whole.max_normal for part in parts]))
    pictures, robot, charts = (
        linked(path, passes, parts, program),
        robot_model(arm_of(cell), cell.compensation, cell.stock, passes[best]),
        charts_of(cell, passes, parts),
    )
    data = {  # what the page's scripts draw
        "linked": pictures,
        "surface": part_surface(parts),
        "robot": robot,
        "charts": charts,
        "paper": paper,
        "best": best,
        "tolerance_um": [1e6 * allowed for allowed in cell.tolerances.of()],
        "stock_mm": [*(cell.stock.min * 1e3), *(cell.stock.max * 1e3)],
        "engaged_s": path.full_engagement,
        "part": not path.straight,
    }
    return page.page_text(
        "report",
        # in the order in which the page runs them
        ("base", "place", "maps", "series", "zoom", "source", "part", "robot", "charts", "start"),
        title=title,
        cell=cell,
        path=path,
        timed=path.timed,
        path_file=cell.path.file_name,
        speed_rpm=cell.tool.spindle_speed * 30 / np.pi,
        source=Path(source).name,
        command=command,
        date=date,
        paper=paper,
        paper_source=texts.PAPER,
        names=names,
        asked=f"How far off does {cell.arm.name} mill {cut_text(path)}{then}?",
        tiles=tiles(names, judgements, decision, checked, method, cell.stage.tool if cell.stage else ""),
        findings=finding_rows(checked),
        limits=limit_bars(decision),
        first_findings=4,  # rows that are shown at once; the others follow behind a switch
        first_tiles=3,  # before the findings: decision, as programmed, compensated
        scores=texts.line_scores(passes, paper) if path.straight else texts.part_scores(parts),
        features=None if path.straight else texts.feature_table(parts),
        more=[texts.typographic(t) for t in tables if t.rows],
        details=texts.details(passes),
        inputs=texts.input_rows(cell.arm, robot["joints"][0]),
        warning=texts.warning(cell, passes),
        assumptions=assumptions(cell, paper),
        configuration=[(key, texts.shown(value, key)) for key, value in flatten(cell).items()],
        charts=charts,
        has_source=bool(pictures["source"]),
        data=page.to_json(data),
    )


def judged(
    cell: Cell, passes: Sequence[ScoredPass], judgements: Sequence[Judgement]
) -> tuple[Decision | None, Checked | None]:
    """Decide on passes that come without a decision, as recordings do: the best of the others against the first.

    Returns None where the path cannot be checked any more.
    """
    best = min(range(len(passes)), key=lambda k: (k == 0 < len(passes) - 1, judgements[k].error))
    with contextlib.suppress(MillingError, OSError):  # the tool path of a recording may be nowhere else
        checked = check(cell, passes[best].reference, ran=passes[best])
        return decided(judgements[0], judgements[best], passes[best].name, checked), checked
    return None, None
