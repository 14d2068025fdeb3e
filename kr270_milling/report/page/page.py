"""One self-contained HTML page out of plain values: template, style, scripts and data are all inside."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from pathlib import Path

import jinja2
from markupsafe import Markup

from kr270_milling import __version__
from kr270_milling.base.record import flatten
from kr270_milling.cell.cell import Cell
from kr270_milling.cell.jobs import ScoredPass
from kr270_milling.decision.part import PartAssessment
from kr270_milling.report.assumptions import assumptions
from kr270_milling.report.decision_block import DecisionBlock, ReportTable
from kr270_milling.report.page import tables
from kr270_milling.report.page.first_screen import asked, finding_rows, tiles
from kr270_milling.report.paper import PAPER
from kr270_milling.report.payload import to_json
from kr270_milling.report.symbols import SYMBOLS

__all__ = ["SCRIPTS", "plotly_script", "render", "script_text"]

HERE = Path(__file__).parent
#: in the order in which the page runs them
SCRIPTS = ("base.js", "place.js", "maps.js", "series.js", "source.js", "part.js", "robot.js", "charts.js", "start.js")


@functools.cache
def plotly_script() -> Markup:
    """plotly.min.js as the plotly package ships it."""
    import plotly

    text = (Path(plotly.__file__).parent / "package_data" / "plotly.min.js").read_text(encoding="utf-8")
    return Markup(text.replace("</script", "<\\/script"))


def script_text(names: Sequence[str] = SCRIPTS) -> Markup:
    """Our own scripts, one after the other."""
    return Markup("\n".join((HERE / name).read_text(encoding="utf-8") for name in names))


def render(
    cell: Cell, passes: Sequence[ScoredPass], parts: Sequence[PartAssessment], data: dict, *, decision: DecisionBlock,
    more: Sequence[ReportTable], title: str, source: str, command: str, date: str, paper: bool,
) -> str:  # fmt: skip
    """The whole HTML text, every text from outside escaped; data: what the scripts draw."""
    text = (HERE / "report.html").read_text(encoding="utf-8")
    strict = jinja2.StrictUndefined
    return jinja2.Template(text, autoescape=True, undefined=strict, trim_blocks=True, lstrip_blocks=True).render(
        title=title,
        version=__version__,
        paper=paper,
        paper_source=PAPER,
        asked=asked(cell, passes),
        tiles=tiles(decision, passes, parts if cell.path.file else ()),
        findings=finding_rows(decision),
        scores=tables.part_scores(parts) if cell.path.file else tables.line_scores(passes, paper),
        features=tables.feature_table(parts) if cell.path.file else None,
        more=[tables.typographic(t) for t in more if t.rows],
        run=tables.run_rows(cell, source, command, date),
        inputs=tables.input_rows(cell, data["robot"].joints[0]),
        details=tables.detail_rows(cell, passes),
        warning=tables.warning(cell, passes),
        assumptions=assumptions(cell, paper),
        configuration=[(key, tables.shown(value, key)) for key, value in flatten(cell).items()],
        symbols=SYMBOLS,
        charts=data["charts"],
        has_source=bool(data["linked"].source),
        names=[p.name for p in passes],
        style=Markup((HERE / "report.css").read_text(encoding="utf-8")),
        plotly=plotly_script(),
        scripts=script_text(),
        data=Markup(to_json(data)),
    )  # fmt: skip
