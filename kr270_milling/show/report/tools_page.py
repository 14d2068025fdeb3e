"""The report of a program with several tools: the decision, a row for each tool, and the page of each behind a tab."""

from __future__ import annotations

from collections.abc import Sequence

from kr270_milling.decide.tools import DecisionOnTools
from kr270_milling.show.report.decision_block import TONES
from kr270_milling.show.report.page import page
from kr270_milling.show.report.tables import micro

__all__ = ["tools_page"]

PLOTLY = "/* plotly.js, from the page of all tools */"  #: in the page of a tool, which the page around it fills in


def tools_page(title: str, decision: DecisionOnTools, names: Sequence[str], pages: Sequence[str]) -> str:
    """Return a page for all tools; pages: the report of each tool as text, without plotly."""
    tools = dict(decision.tools)
    rows = [(name, tools[name].level, TONES[tools[name].level], micro(tools[name].sentence)) for name in names]
    return page.page_text(
        "tools",
        ("tools",),
        title=title,
        level=decision.level,
        tone=TONES[decision.level],
        sentence=micro(decision.sentence),
        rows=rows,
        first=decision.worst[0],
        data=page.to_json(
            {
                "mark": PLOTLY,
                "pages": dict(
                    zip(names, (text.replace(page.plotly_script(), PLOTLY, 1) for text in pages), strict=True)
                ),
            }
        ),
    )
